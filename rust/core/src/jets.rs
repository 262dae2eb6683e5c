//! Jet engines: the identified model, the throttle loop that follows a thrust rate, the thrust estimator, and what a
//! controller assumes of the thrust under its commands.

pub mod ekf;
pub mod engine;
pub mod model;

pub use ekf::{EkfConfig, ThrustEkf};
pub use engine::{EngineCoefficients, EngineDynamics, EngineModel, RATE_GAIN, ThrustRateController};
pub use model::{JetDynamics, JetModel};
