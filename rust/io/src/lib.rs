//! Files of a flight: each `load_*` function turns paths and tables into the values that
//! [`flight_core`] is built from.
//!
//! ```text
//! robot.toml + URDF ──load_robot──► RobotModel        AeroConfig ──load_aero──► AeroModel
//! MissionConfig ──load_mission──► Mission             all of them ──load_controller──► Controller
//! ```
//!
//! [`toml`] reads the TOML files and what they build on.

#![forbid(unsafe_code)]

pub mod aero;
pub mod controller;
pub mod mission;
pub mod network;
pub mod robot;
mod tensors;
pub mod toml;

pub use aero::{AeroConfig, NetworkConfig, load_aero};
pub use controller::{ControllerSection, load_controller};
pub use mission::{MissionConfig, load_mission};
pub use robot::{RobotFiles, load_robot, robot_from_text};
pub use toml::resolve;

use flight_core::BuildError;
use std::path::Path;

/// Text of a file.
///
/// # Errors
/// [`BuildError::Unreadable`] naming the file.
pub fn read_text(path: &Path) -> Result<String, BuildError> {
    std::fs::read_to_string(path).map_err(|source| BuildError::Unreadable { path: path.to_owned(), source })
}
