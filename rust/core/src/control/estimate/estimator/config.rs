//! Delays and time constants of the measurements.

use crate::error::{BuildError, check};
use crate::schema;
use serde::{Deserialize, Serialize};

/// Delay and time constant of each kind of measurement.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// Position of the base origin.
    pub base_position: FilterConfig,
    /// Rotation of the base.
    pub base_rotation: FilterConfig,
    /// Velocity of the base origin.
    pub base_linear_velocity: FilterConfig,
    /// Gyroscopes.
    pub base_angular_velocity: FilterConfig,
    /// Joint positions.
    pub joint_position: FilterConfig,
    /// Joint velocities.
    pub joint_velocity: FilterConfig,
    /// Thrusts.
    pub thrust: FilterConfig,
    /// Time constant \[s\] of an observer that estimates joint velocities, and joint accelerations that the model does
    /// not explain, from the joint positions alone. It replaces `joint_velocity` and the time constant of
    /// `joint_position`; joint velocities then need not be measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_observer: Option<f64>,
    /// Time constant \[s\] with which the bias of the gyroscopes is estimated from the measured rotation; without it they
    /// have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub gyro_bias: Option<f64>,
    /// Time from a tick until its command acts. State and set-point of the law are those of then.
    pub latency: LatencyConfig,
}

/// Time from a tick until its command acts. The model holds a torque for a semi-implicit step of a tick; one that a robot,
/// or a simulator of many substeps, holds for a tick acts on average half a tick later, which is part of its latency.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LatencyConfig {
    /// Time until its torques act \[s\].
    #[schemars(range(min = 0, max = 0.2))]
    pub torque: f64,
    /// Time until its thrust rates act, at least that of the torques \[s\].
    #[schemars(range(min = 0, max = 0.2))]
    pub thrust: f64,
}

impl LatencyConfig {
    /// Whole ticks of `time_step` \[s\] until torques act, and what is left until torques and thrust rates act, in ticks.
    #[must_use]
    pub fn in_ticks(&self, time_step: f64) -> (usize, [f64; 2]) {
        // Decimal fractions are not exact.
        let ticks = |time: f64| (time / time_step * 1e6).round() / 1e6;
        let (torque, thrust) = (ticks(self.torque), ticks(self.thrust));
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 0.2 s
        let whole = torque.floor() as usize;
        (whole, [torque - torque.floor(), thrust - torque.floor()])
    }
}

/// One kind of measurement.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilterConfig {
    /// Age of the measurement on arrival, rounded to ticks \[s\].
    #[schemars(range(min = 0, max = 0.2))]
    pub delay: f64,
    /// Time constant with which the estimate follows the measurement \[s\]; zero uses the measurement unchanged.
    #[schemars(range(min = 0))]
    pub time_constant: f64,
}

impl EstimatorConfig {
    /// Each kind of measurement with its key.
    pub(super) fn channels(&self) -> [(&'static str, &FilterConfig); 7] {
        [
            ("base_position", &self.base_position),
            ("base_rotation", &self.base_rotation),
            ("base_linear_velocity", &self.base_linear_velocity),
            ("base_angular_velocity", &self.base_angular_velocity),
            ("joint_position", &self.joint_position),
            ("joint_velocity", &self.joint_velocity),
            ("thrust", &self.thrust),
        ]
    }

    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        schema::check(self, "controller.estimator")?;
        let LatencyConfig { torque, thrust } = self.latency;
        let expected = format!("at least {torque}, the latency of the torques");
        check("controller.estimator.latency.thrust", thrust, |x| x >= torque, &expected).map(|_| ())
    }
}
