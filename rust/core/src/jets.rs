//! Jet engines: the identified model, the throttle loop that follows a thrust rate, and the thrust estimator.

pub mod ekf;
pub mod engine;

pub use ekf::{EkfConfig, ThrustEkf};
pub use engine::{EngineDynamics, EngineModel, ThrustRateController};
