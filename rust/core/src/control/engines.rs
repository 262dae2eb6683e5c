//! Detection of engines that do not follow their commands, and of wrong thrust sensors.
//!
//! ```text
//! d ← e^{−Δt/τ} d + (T_k − T̂_k)              how far a thrust has left the commanded one, T̂ by M31
//! d̄ ← d after lags of τ_e and τ_n             the same, as late as the momentum is known
//! n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)       what the momentum says beside the observed wrench
//! ```
//!
//! Where `|d̄|` stays above its limit for a while, either the engine does not reach the thrust it is commanded or its
//! sensor is wrong. A wrong sensor puts a wrench of `−d` times the jet's column of `A_T` into the momentum that no thrust
//! explains; an engine puts none. The thrust that an engine stops at bounds what is commanded from then on, and an engine
//! whose bounds are close together is lost. Equations M105 and M106 of `docs/model.md`.

use super::config::MomentumGains;
use super::observer::residual_share;
use crate::error::{BuildError, Table};
use crate::robot::{Joint, JointKind};
use nalgebra::{Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Least lever arm about the centre of mass of a jet whose sensor can be judged \[m\]: a deviation of 10 N has a moment of
/// 0.1 N m there, as much as the residual's noise.
const LEAST_ARM: f64 = 0.01;

/// When an engine does not reach its thrust, and when it counts as lost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EnginesConfig {
    /// Time constant with which deviations of the thrust are forgotten \[s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub time_constant: f64,
    /// Greatest deviation of a thrust from the commanded one \[N\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub deviation_max: f64,
    /// How long it has to be exceeded \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub confirmation: f64,
    /// How the robot levels and descends when an engine is lost; without it the mission goes on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub descent: Option<DescentConfig>,
}

/// The law of a robot that has lost an engine: the attitude first, no place to hold, and fast joints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DescentConfig {
    /// An engine is lost whose least and greatest thrust are closer together than this share of the jet's greatest.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub range_share_min: f64,
    /// Gains in place of `controller.momentum`.
    pub momentum: MomentumGains,
    /// Greatest joint velocity, of revolute joints whose own is less \[deg/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub joint_velocity_max_deg: f64,
    /// Greatest rate of a joint torque, of revolute joints whose own is less \[N m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub torque_rate_max: f64,
}

impl DescentConfig {
    /// Greatest velocity of a joint on the way down \[rad/s, m/s\].
    #[must_use]
    pub fn velocity_max(&self, joint: &Joint) -> f64 {
        match joint.kind {
            JointKind::Revolute => joint.velocity_max.max(self.joint_velocity_max_deg.to_radians()),
            JointKind::Prismatic => joint.velocity_max,
        }
    }

    /// Greatest rate of its torque \[N m/s, N/s\].
    #[must_use]
    pub fn torque_rate_max(&self, joint: &Joint) -> f64 {
        match joint.kind {
            JointKind::Revolute => joint.torque_rate_max.max(self.torque_rate_max),
            JointKind::Prismatic => joint.torque_rate_max,
        }
    }
}

impl EnginesConfig {
    /// Refuses numbers that mean nothing.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let table = Table("controller.engines");
        table.positive("time_constant", self.time_constant)?;
        table.positive("deviation_max", self.deviation_max)?;
        table.non_negative("confirmation", self.confirmation)?;
        let Some(descent) = &self.descent else { return Ok(()) };
        table.positive("descent.range_share_min", descent.range_share_min)?;
        descent.momentum.check(Table("controller.engines.descent.momentum"))?;
        table.positive("descent.joint_velocity_max_deg", descent.joint_velocity_max_deg)?;
        table.positive("descent.torque_rate_max", descent.torque_rate_max)
    }
}

/// What is known of an engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EngineState {
    /// `d` \[N\].
    pub deviation: f64,
    /// `d` after the first lag and after both, `d̄` \[N\].
    late: [f64; 2],
    /// How long it has been too large \[s\].
    suspected: f64,
    /// Least and greatest thrust that it reaches, as far as that was found \[N\].
    pub range: (f64, f64),
}

impl Default for EngineState {
    fn default() -> Self {
        Self { deviation: 0.0, late: [0.0; 2], suspected: 0.0, range: (0.0, f64::INFINITY) }
    }
}

impl EngineState {
    /// Whether it does not reach every thrust.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.range != Self::default().range
    }

    /// Whether its thrust, of a jet that gives up to `thrust_max` \[N\], can change too little to fly with.
    #[must_use]
    pub fn is_lost(&self, descent: &DescentConfig, thrust_max: f64) -> bool {
        self.range.1 - self.range.0 < descent.range_share_min * thrust_max
    }

    /// Takes in the thrust of this tick \[N\] and by how much it is not the predicted one, after `dt` \[s\]; whether the
    /// sensor is wrong. If it is not, but the engine does not reach its thrust, its range is narrowed.
    ///
    /// `momentum_share` is the share of a change that the estimated momentum follows per tick, 1 where it is measured;
    /// `sensor_error` is what the momentum says of the sensor, [`sensor_error`]. Without it nothing is judged: lags and
    /// confirmation begin anew.
    pub fn update(
        &mut self,
        config: &EnginesConfig,
        dt: f64,
        (thrust, innovation): (f64, f64),
        momentum_share: f64,
        sensor_error: Option<f64>,
    ) -> bool {
        self.deviation = libm::exp(-dt / config.time_constant) * self.deviation + innovation;
        let Some(sensor_error) = sensor_error else {
            (self.late, self.suspected) = ([0.0; 2], 0.0);
            return false;
        };
        let [estimated, late] = &mut self.late;
        *estimated += momentum_share * (self.deviation - *estimated);
        *late += residual_share(dt) * (*estimated - *late);
        let late = *late;
        if late.abs() <= config.deviation_max {
            self.suspected = 0.0;
            return false;
        }
        self.suspected += dt;
        // Half a tick is for rounding.
        if self.suspected < config.confirmation + 0.5 * dt {
            return false;
        }
        if !self.is_limited() && sensor_error / late > 0.5 {
            return true;
        }
        let (least, greatest) = self.range;
        self.range = if late < 0.0 { (least.min(thrust), thrust) } else { (thrust, greatest.max(thrust)) };
        false
    }
}

/// By how much the sensor of a jet would have to be wrong to explain the residual `n` of the momentum \[N\]; `column` is
/// the jet's one of `A_T`.
///
/// Moments alone are compared: gyroscopes are less noisy than velocities, and forces of the air change more than their
/// moments. Of a jet through the centre of mass nothing is known: zero, for an engine that fails is the worse of both.
#[must_use]
pub fn sensor_error(column: &Vector6<f64>, residual: &Vector6<f64>) -> f64 {
    let moment = |wrench: &Vector6<f64>| Vector3::new(wrench[3], wrench[4], wrench[5]);
    let arm_squared = moment(column).norm_squared();
    if arm_squared < LEAST_ARM * LEAST_ARM {
        0.0
    } else {
        -moment(column).dot(&moment(residual)) / arm_squared
    }
}
