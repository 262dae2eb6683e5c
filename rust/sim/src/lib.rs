//! Closed-loop simulation of [`flight_core`]: the simulated robot and wind, logs, batches.
//!
//! ```text
//! ScenarioConfig ──► Scenario: Plant, Wind, Controller ──begin──► Flight ──step, step, …──► FlightResult
//! ```

#![forbid(unsafe_code)]
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::disallowed_methods))]

mod actuation;
#[cfg(feature = "threads")]
mod batch;
pub mod config;
pub mod disturbances;
mod flight;
pub mod foot_sensors;
pub mod fuel;
mod ground;
pub mod jets;
pub mod log;
pub mod measuring;
pub mod motors;
pub mod noise;
pub mod outcome;
mod plant;
pub mod quantity;
mod replay;
mod scenario;
pub mod sensors;
pub mod signals;
pub mod summary;
pub mod turbine;
mod turbulence;
mod warnings;
mod wind;
mod world;

/// Version of the numbers that flights have, by which results of other numbers are distinguished. It is raised where a
/// flight changes a bit: `tests/golden` refuses a change without it.
pub const NUMERICS: u32 = 1;

pub use actuation::{Actuation, ActuationConfig};
#[cfg(feature = "threads")]
pub use batch::{BatchError, fly_batch, with_each};
pub use config::{Backend, ScenarioConfig, SimulatorConfig, load_scenario, onboard, schemas};
pub use disturbances::Disturbances;
pub use flight::Flight;
pub use log::FlightLog;
pub use outcome::{FlightResult, Loss, LossReason, Outcome};
pub use plant::Plant;
pub use replay::replay;
pub use scenario::{NoResult, Scenario, load_flyable};
pub use sensors::{Sensors, SensorsConfig};
pub use signals::SIGNALS;
pub use summary::{FIGURES, Summary};
pub use wind::{Wind, WindConfig};
pub use world::{Seen, World};
