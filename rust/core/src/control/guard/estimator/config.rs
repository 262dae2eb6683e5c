//! Delays and time constants of the measurements.

use crate::error::{BuildError, check};
use serde::{Deserialize, Serialize};

/// Greatest age of a measurement \[s\]: every tick of age costs one evaluation of the model.
const MAX_DELAY: f64 = 0.2;

/// Delay and time constant of each kind of measurement.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// Position of the base origin.
    pub base_position: ChannelConfig,
    /// Rotation of the base.
    pub base_rotation: ChannelConfig,
    /// Velocity of the base origin.
    pub base_linear_velocity: ChannelConfig,
    /// Gyroscopes.
    pub base_angular_velocity: ChannelConfig,
    /// Joint positions.
    pub joint_position: ChannelConfig,
    /// Joint velocities.
    pub joint_velocity: ChannelConfig,
    /// Thrusts.
    pub thrust: ChannelConfig,
    /// Time constant \[s\] of an observer that estimates joint velocities, and joint accelerations that the model does
    /// not explain, from the joint positions alone. It replaces `joint_velocity` and the time constant of
    /// `joint_position`; joint velocities then need not be measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub joint_observer: Option<f64>,
    /// Time constant \[s\] with which the bias of the gyroscopes is estimated from the measured rotation; without it they
    /// have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub gyro_bias: Option<f64>,
    /// Time from a tick until its command acts. State and set-point of the law are those of then.
    pub latency: LatencyConfig,
}

/// Time from a tick until its command acts. The model holds a torque for a semi-implicit step of a tick; one that a robot,
/// or a simulator of many substeps, holds for a tick acts on average half a tick later, which is part of its latency.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct LatencyConfig {
    /// Time until its torques act \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 0.2)))]
    pub torque: f64,
    /// Time until its thrust rates act, at least that of the torques \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 0.2)))]
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
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ChannelConfig {
    /// Age of the measurement on arrival, rounded to ticks \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 0.2)))]
    pub delay: f64,
    /// Time constant with which the estimate follows the measurement \[s\]; zero uses the measurement unchanged.
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub time_constant: f64,
}

impl EstimatorConfig {
    /// Each kind of measurement with its key.
    pub(super) fn channels(&self) -> [(&'static str, &ChannelConfig); 7] {
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
        for (key, channel) in self.channels() {
            let item = format!("controller.estimator.{key}.delay");
            check(&item, channel.delay, |x| (0.0..=MAX_DELAY).contains(&x), "seconds from 0 to 0.2")?;
            let item = format!("controller.estimator.{key}.time_constant");
            check(&item, channel.time_constant, |x| x >= 0.0, "seconds ≥ 0")?;
        }
        let LatencyConfig { torque, thrust } = self.latency;
        let is_delay = |x| (0.0..=MAX_DELAY).contains(&x);
        check("controller.estimator.latency.torque", torque, is_delay, "seconds from 0 to 0.2")?;
        let is_later = |x| (torque..=MAX_DELAY).contains(&x);
        let expected = format!("seconds from {torque}, the latency of the torques, to 0.2");
        check("controller.estimator.latency.thrust", thrust, is_later, &expected)?;
        for (key, time) in [("joint_observer", self.joint_observer), ("gyro_bias", self.gyro_bias)] {
            let item = format!("controller.estimator.{key}");
            check(&item, time.unwrap_or(1.0), |x| x > 0.0, "a positive number of seconds")?;
        }
        Ok(())
    }
}
