//! Detection of engines that do not follow their commands, and of faulty thrust sensors.
//!
//! ```text
//! d ← e^{−Δt/τ} d + (T_k − T̂_k)              deviation of the thrust from the commanded one, T̂ by M31
//! d̄ ← d after lags of τ_e and τ_n             the deviation, delayed as the momentum is
//! n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)       residual of the momentum with respect to the observed wrench
//! ```
//!
//! If `|d̄|` stays above its limit for a confirmation time, either the engine does not reach its commanded thrust or
//! its sensor is wrong. A wrong sensor adds `−d` times the jet's column of `A_T` to the residual of the momentum; an
//! engine adds nothing. The thrust at which an engine stops becomes a bound on its commanded thrust, and an engine
//! whose bounds are close together is lost. Equations M105 and M106 of `docs/model.md`.

use super::observer::residual_share;
use crate::control::law::attitude::MomentumGains;
use crate::control::law::limits::Limits;
use crate::error::{BuildError, Table};
use crate::robot::{Joint, JointKind, RobotModel};
use nalgebra::{Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Least lever arm of a jet about the centre of mass for which its sensor can be judged \[m\]: with it, a deviation of
/// 10 N has a moment of 0.1 N m, as large as the noise of the residual.
const LEAST_ARM: f64 = 0.01;

/// When an engine counts as not reaching its thrust, and when as lost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EnginesConfig {
    /// Time constant with which deviations of the thrust decay \[s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub time_constant: f64,
    /// Greatest deviation of a thrust from the commanded one \[N\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub deviation_max: f64,
    /// Time for which `deviation_max` has to be exceeded \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub confirmation: f64,
    /// Levelling and descent after the loss of an engine; without it the mission continues.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub descent: Option<DescentConfig>,
}

/// Descent without an engine: attitude has priority, the position is not held, and joints are fast.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DescentConfig {
    /// An engine is lost if its least and greatest thrust differ by less than this fraction of the jet's greatest
    /// thrust.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub range_share_min: f64,
    /// Gains in place of `controller.momentum`.
    pub momentum: MomentumGains,
    /// Greatest joint velocity during the descent \[deg/s\], for revolute joints whose own limit is lower.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub joint_velocity_max_deg: f64,
    /// Greatest rate of a joint torque during the descent \[N m/s\], for revolute joints whose own limit is lower.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub torque_rate_max: f64,
}

impl DescentConfig {
    /// Greatest velocity of a joint during the descent \[rad/s, m/s\].
    #[must_use]
    pub fn velocity_max(&self, joint: &Joint) -> f64 {
        match joint.kind {
            JointKind::Revolute => joint.velocity_max.max(self.joint_velocity_max_deg.to_radians()),
            JointKind::Prismatic => joint.velocity_max,
        }
    }

    /// Greatest torque rate of a joint during the descent \[N m/s, N/s\].
    #[must_use]
    pub fn torque_rate_max(&self, joint: &Joint) -> f64 {
        match joint.kind {
            JointKind::Revolute => joint.torque_rate_max.max(self.torque_rate_max),
            JointKind::Prismatic => joint.torque_rate_max,
        }
    }
}

impl EnginesConfig {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let table = Table("controller.engines");
        table.check_positive("time_constant", self.time_constant)?;
        table.check_positive("deviation_max", self.deviation_max)?;
        table.check_non_negative("confirmation", self.confirmation)?;
        let Some(descent) = &self.descent else { return Ok(()) };
        table.check_positive("descent.range_share_min", descent.range_share_min)?;
        descent.momentum.check(Table("controller.engines.descent.momentum"))?;
        table.check_positive("descent.joint_velocity_max_deg", descent.joint_velocity_max_deg)?;
        table.check_positive("descent.torque_rate_max", descent.torque_rate_max)
    }
}

/// Monitor state of one engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EngineState {
    /// `d` \[N\].
    pub deviation: f64,
    /// `d` after the first lag and after both, `d̄` \[N\].
    late: [f64; 2],
    /// Time for which `|d̄|` has exceeded its limit \[s\].
    suspected: f64,
    /// Least and greatest thrust that the engine has been found to reach \[N\].
    pub range: (f64, f64),
}

impl Default for EngineState {
    fn default() -> Self {
        Self { deviation: 0.0, late: [0.0; 2], suspected: 0.0, range: (0.0, f64::INFINITY) }
    }
}

impl EngineState {
    /// Whether a limit of the engine's thrust has been found.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.range != Self::default().range
    }

    /// Whether the thrust range is too small for flight; `thrust_max` is the greatest thrust of the jet \[N\].
    #[must_use]
    pub fn is_lost(&self, descent: &DescentConfig, thrust_max: f64) -> bool {
        self.range.1 - self.range.0 < descent.range_share_min * thrust_max
    }

    /// Updates the monitor with the thrust of this tick \[N\] and its difference from the prediction (`innovation`),
    /// `dt` \[s\] after the last tick. Returns whether the sensor is wrong; if instead the engine does not reach its
    /// thrust, its range is narrowed.
    ///
    /// `momentum_share` is the fraction of a change that appears in the estimated momentum per tick, 1 where it is
    /// measured; `sensor_error` is the sensor error that the momentum indicates, see [`sensor_error`]. Without it
    /// nothing is judged, and lags and confirmation time restart.
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
        // Half a tick absorbs rounding.
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

/// Monitors of all engines of a robot, and the limits of the law that follow from them.
#[derive(Debug, Clone)]
pub struct Engines {
    config: EnginesConfig,
    /// Fraction of a change that appears in the estimated momentum per tick, 1 where it is measured.
    momentum_share: f64,
    usual: Limits,
    /// Limits after the loss of an engine.
    descending: Option<(DescentConfig, Limits)>,
}

impl Engines {
    /// Monitors of the engines of `robot`, for a law with these limits while all engines work.
    #[must_use]
    pub fn new(config: &EnginesConfig, usual: &Limits, robot: &RobotModel, momentum_share: f64) -> Self {
        let joints = robot.joints.iter();
        let descending = |descent: DescentConfig| Limits {
            gains: descent.momentum,
            holds_position: false,
            joint_velocity: joints.clone().map(|joint| descent.velocity_max(joint)).collect(),
            torque_rate: joints.map(|joint| descent.torque_rate_max(joint)).collect(),
            ..usual.clone()
        };
        let descending = config.descent.map(|descent| (descent, descending(descent)));
        Self { config: *config, momentum_share, usual: usual.clone(), descending }
    }

    /// State before the first tick.
    #[must_use]
    pub fn start(&self) -> Vec<EngineState> {
        vec![EngineState::default(); self.usual.thrust.len()]
    }

    /// Processes the thrust \[N\] of a jet and its innovation, as [`EngineState::update`].
    pub fn update(
        &self,
        engine: &mut EngineState,
        dt: f64,
        measured: (f64, f64),
        sensor_error: Option<f64>,
    ) -> bool {
        engine.update(&self.config, dt, measured, self.momentum_share, sensor_error)
    }

    /// Writes the limits of the law: of a limited engine the thrusts it reaches, so that the others take over its share;
    /// after the loss of an engine those of the descent, unless the robot is standing. Returns whether one is lost.
    pub fn limit(&self, engines: &[EngineState], is_standing: bool, limits: &mut Limits) -> bool {
        let thrusts = || engines.iter().zip(&self.usual.thrust);
        let descending = self.descending.as_ref().filter(|(descent, _)| {
            thrusts().any(|(engine, (_, thrust_max))| engine.is_lost(descent, *thrust_max))
        });
        let chosen = descending.filter(|_| !is_standing).map_or(&self.usual, |(_, limits)| limits);
        limits.copy_from(chosen);
        for ((engine, (_, thrust_max)), range) in thrusts().zip(&mut limits.thrust) {
            let greatest = engine.range.1.min(*thrust_max);
            *range = (engine.range.0.min(greatest), greatest);
        }
        descending.is_some()
    }
}

/// Error of a jet's thrust sensor that would explain the residual `n` of the momentum \[N\]; `column` is the jet's
/// column of `A_T`.
///
/// Only moments are compared: gyroscopes are less noisy than velocities, and aerodynamic forces change more than their
/// moments. For a jet through the centre of mass the error cannot be determined; it is zero, so that the engine counts
/// as failing, the worse of the two cases.
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
