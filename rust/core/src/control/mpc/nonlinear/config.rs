//! Configuration of the descent by nonlinear model predictive control.

use crate::error::{BuildError, Table};
use crate::jets::JetModel;
use serde::{Deserialize, Serialize};

const TABLE: Table = Table("controller.mpc.nonlinear_descent");

/// Greatest number of knots.
const KNOTS_MAX: usize = 64;

/// A descent by nonlinear model predictive control. Weights are those of squares, per second.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NonlinearConfig {
    /// Durations of the knots \[s\].
    pub knots: Vec<f64>,
    /// Velocity of the centre of mass, along x, y and z \[s²/m²\].
    #[schemars(inner(range(min = 0)))]
    pub velocity: [f64; 3],
    /// Speed beyond which the cost of the horizontal velocity grows linearly (pseudo-Huber) \[m/s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub linear_beyond: f64,
    /// Lean, of which `2 (1 − cos)` is the square \[1/rad²\].
    #[schemars(range(min = 0))]
    pub lean: f64,
    /// Angular velocity \[s²/rad²\].
    #[schemars(range(min = 0))]
    pub angular_velocity: f64,
    /// Joint positions about the posture of the first tick \[1/rad²\].
    #[schemars(range(min = 0))]
    pub posture: f64,
    /// Joint velocities \[s²/rad²\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_velocity: f64,
    /// Thrust rates \[s²/N²\].
    #[schemars(range(min = 0))]
    pub thrust_rate: f64,
    /// Distances below the least one, not per second \[1/m²\].
    #[schemars(range(min = 0))]
    pub clearance: f64,
    /// For how long the errors at the end of the last knot count \[s\].
    #[schemars(range(min = 0))]
    pub tail: f64,
}

impl NonlinearConfig {
    /// Checks the knots, and that there are engines to plan with; `time_step` is that of the ticks \[s\].
    ///
    /// # Errors
    /// [`BuildError`] naming the key.
    pub fn check(&self, jets: &[JetModel], time_step: f64) -> Result<(), BuildError> {
        let count = self.knots.len();
        if count == 0 || count > KNOTS_MAX {
            let expected = format!("1 to {KNOTS_MAX} durations");
            return Err(BuildError::bad_value(
                "length of controller.mpc.nonlinear_descent.knots",
                count,
                expected,
            ));
        }
        let expected = format!("at least a tick of {time_step} s");
        for duration in &self.knots {
            TABLE.check("knots", *duration, |x| x >= time_step * (1.0 - 1e-6), &expected)?;
        }
        if jets.iter().all(|jet| jet.engine.is_some()) {
            return Ok(());
        }
        let expected = "throttled: `mpc.nonlinear_descent` plans with engines";
        Err(BuildError::bad_value("controller.jet_dynamics", "ideal", expected))
    }
}
