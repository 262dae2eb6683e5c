//! Jet engines: the identified model, the throttle loop that follows a thrust rate, the thrust estimator, and what a
//! controller assumes of the thrust under its commands.

mod ekf;
mod engine;
mod model;
mod second_order;
mod shaft;

pub use ekf::ThrustEkf;
pub use engine::{EngineDynamics, EngineModel, RATE_GAIN, ThrustRateController};
pub use model::{JetDynamics, JetModel};
pub use second_order::{EngineCoefficients, SecondOrder};
pub use shaft::{Shaft, ShaftConfig};
