//! Jet engines: the identified model, the throttle loop that follows a thrust rate, and the thrust estimator.

pub mod ekf;
pub mod engine;

pub use ekf::{EkfConfig, ThrustEkf};
pub use engine::{EngineDynamics, EngineModel, ThrustRateController};

/// Thrust \[N\] after `dt` \[s\] at a thrust rate \[N/s\] (M31), not below the least one of the engine. A thrust that is
/// below it already is that of an engine that has stopped: it does not rise by itself, and never becomes negative.
#[must_use]
pub fn predict_thrust(thrust: f64, thrust_rate: f64, dt: f64, thrust_min: f64) -> f64 {
    (thrust + dt * thrust_rate).max(thrust.min(thrust_min).max(0.0))
}
