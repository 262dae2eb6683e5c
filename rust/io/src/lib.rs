//! Files of a flight: each `load_*` function converts paths and tables to the values from which
//! [`flight_core`] is built.
//!
//! ```text
//! robot.toml + URDF ──load_robot──► RobotModel        AeroConfig ──load_aero──► AeroModel
//! MissionConfig ──load_mission──► Mission             all of them ──load_controller──► Controller
//! ```
//!
//! [`toml`] reads TOML files with their base files; [`files`] reads the bytes of every file.

#![forbid(unsafe_code)]
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::disallowed_methods))]

mod aero;
mod card;
mod controller;
pub mod csv;
mod files;
pub mod mission;
pub mod network;
mod policy;
pub mod robot;
mod tensors;
pub mod toml;

pub use aero::{AeroConfig, load_aero};
pub use controller::{ControllerSection, OnboardConfig, load_controller};
pub use files::{decode, hold, read_bytes, read_text};
pub use flight_core::schema::Schema;
pub use mission::{MissionConfig, load_mission, read_recording};
pub use network::{NetworkConfig, read_network};
pub use policy::{PolicyConfig, load_policy, read_policy};
pub use robot::{LoadedRobot, RobotFile, RobotFiles, load_robot, read_urdf, robot_from_text};
pub use toml::{
    from_json, from_value, load, load_by, load_changed, path_keys, resolve, resolve_table, set_keys, typed,
};
