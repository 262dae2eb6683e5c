//! The thrust of a jet under commanded thrust rates, as a controller assumes it.
//!
//! ```text
//! ideal          Ṫ = Ṫ*                                                     M31
//! second order   Ṫ moves towards Ṫ* as fast as the throttle's limits allow     M173
//! ```
//!
//! Channels, estimator and the monitor of the engines predict thrusts with it, and the plan has the engine among its states.

use super::EngineModel;
use serde::{Deserialize, Serialize};

/// How thrusts follow their commanded rates in the controller's model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JetDynamics {
    /// At once, as published.
    #[default]
    Ideal,
    /// As the robot's engines do, within the limits of their throttles.
    Throttled,
}

/// One jet of the controller's model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JetModel {
    /// Least thrust of the running engine \[N\].
    pub thrust_min: f64,
    /// Its engine; `None` for ideal dynamics.
    pub engine: Option<EngineModel>,
}

impl JetModel {
    /// Thrust \[N\] and thrust rate \[N/s\] after `dt` \[s\] under a commanded rate \[N/s\] (M31, M173).
    ///
    /// The thrust is not below the least one of the engine. A thrust that is below it already is that of an engine that has
    /// stopped: it does not rise by itself, and never becomes negative.
    #[must_use]
    pub fn advance(&self, thrust: f64, thrust_rate: f64, command: f64, dt: f64) -> (f64, f64) {
        let (rate, mean) = match &self.engine {
            None => (command, command),
            Some(engine) => {
                let rate = engine.nearest_rate(thrust, thrust_rate, command, dt);
                (rate, 0.5 * (thrust_rate + rate))
            }
        };
        ((thrust + dt * mean).max(thrust.min(self.thrust_min).max(0.0)), rate)
    }

    /// Throttle \[%\] that brings the thrust rate to a command within `dt` \[s; N/s\], as far as the engine can; zero for ideal
    /// dynamics, which have no throttle.
    #[must_use]
    pub fn throttle(&self, thrust: f64, thrust_rate: f64, command: f64, dt: f64) -> f64 {
        let Some(engine) = &self.engine else { return 0.0 };
        engine
            .throttle_for(thrust, thrust_rate, command, (command - thrust_rate) / dt)
            .unwrap_or_else(|| engine.steady_throttle(thrust))
    }
}
