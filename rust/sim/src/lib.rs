//! Closed-loop simulation of [`flight_core`]: the simulated robot in its wind, its log, batches.
//!
//! ```text
//! FlightConfig ──► Flight: Plant, Wind, Controller ──run──► FlightResult: log, outcome, summary
//! ```

#![forbid(unsafe_code)]

pub mod batch;
pub mod config;
pub mod disturbances;
pub mod flight;
pub mod ground;
pub mod jets;
pub mod log;
pub mod noise;
pub mod plant;
pub mod turbulence;
pub mod wind;

pub use batch::{BatchError, fly_batch};
pub use config::{Engine, FlightConfig, SimulatorConfig, flight_from_value, load_flight, schemas};
pub use disturbances::Disturbances;
pub use flight::{Fall, FallReason, Flight, Interrupted};
pub use log::{FlightLog, FlightResult, Summary};
pub use plant::Plant;
pub use wind::{Wind, WindConfig};
