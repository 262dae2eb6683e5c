//! Closed-loop simulation of [`flight_core`]: the simulated robot and wind, logs, batches.
//!
//! ```text
//! ScenarioConfig ──► Scenario: Plant, Wind, Controller ──begin──► Flight ──step, step, …──► FlightResult
//! ```

#![forbid(unsafe_code)]
#![cfg_attr(not(test), warn(clippy::disallowed_methods))]

pub mod actuation;
#[cfg(feature = "threads")]
pub mod batch;
pub mod config;
pub mod disturbances;
pub mod flight;
pub mod fuel;
pub mod ground;
pub mod jets;
pub mod log;
pub mod measuring;
pub mod motors;
pub mod noise;
pub mod outcome;
pub mod plant;
pub mod replay;
pub mod scenario;
pub mod sensors;
pub mod signals;
pub mod summary;
pub mod turbine;
pub mod turbulence;
mod warnings;
pub mod wind;
pub mod world;

pub use actuation::{Actuation, ActuationConfig};
#[cfg(feature = "threads")]
pub use batch::{BatchError, fly_batch};
pub use config::{Engine, ScenarioConfig, SimulatorConfig, load_scenario, schemas};
pub use disturbances::Disturbances;
pub use flight::{Flight, Handed};
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
