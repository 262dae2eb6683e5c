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
pub mod schema;
mod tensors;
pub mod toml;

pub use aero::{AeroConfig, NetworkConfig, load_aero};
pub use controller::{ControllerSection, load_controller};
pub use mission::{MissionConfig, load_mission};
pub use robot::{RobotFile, RobotFiles, load_robot, robot_from_text};
pub use schema::Schema;
pub use toml::{from_value, load, resolve};

use flight_core::BuildError;
use std::path::Path;

/// Longest text file that is read \[bytes\].
const MAX_TEXT_LENGTH: u64 = 64 * 1024 * 1024;

/// Text of a regular file.
///
/// # Errors
/// [`BuildError`] naming the file, also for a device, a pipe, or more than 64 MiB.
pub fn read_text(path: &Path) -> Result<String, BuildError> {
    let unreadable = |source| BuildError::Unreadable { path: path.to_owned(), source };
    let metadata = std::fs::metadata(path).map_err(unreadable)?;
    if !metadata.is_file() || metadata.len() > MAX_TEXT_LENGTH {
        let expected = format!("a regular file of at most {MAX_TEXT_LENGTH} bytes");
        return Err(BuildError::malformed(path.display().to_string(), format!("expected {expected}")));
    }
    std::fs::read_to_string(path).map_err(unreadable)
}
