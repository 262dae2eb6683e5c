//! Jet engines: their identified model, the loop that makes them follow a thrust rate, the estimate of
//! their thrust.

pub mod ekf;
pub mod engine;

pub use ekf::{EkfConfig, ThrustEkf};
pub use engine::{EngineDynamics, EngineModel, ThrustRateController};
