//! Which engines follow their commands.
//!
//! ```text
//! d ← e^{−Δt/τ} d + (T_k − T̂_k)        how far a thrust has left the commanded one, T̂ by M31
//! n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)  what the momentum says beside the observed wrench
//! ```
//!
//! Where `|d|` stays above its limit for a while, either the engine does not reach the thrust it is commanded or its
//! sensor is wrong. A wrong sensor puts a wrench of `−d` times the jet's column of `A_T` into the momentum that no thrust
//! explains; an engine puts none. The thrust that an engine stops at bounds what is commanded from then on, and an engine
//! whose bounds meet is lost. Equations M105 and M106 of `docs/model.md`.

use super::config::MomentumGains;
use crate::error::{BuildError, Table};
use crate::robot::{Joint, JointKind};
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

/// When an engine does not reach its thrust, and when it counts as lost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EnginesConfig {
    /// Time constant with which deviations of the thrust are forgotten \[s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub time_constant: f64,
    /// Greatest deviation of a thrust from the commanded one, and least range of an engine that is not lost \[N\].
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
    /// How long it has been too large \[s\].
    suspected: f64,
    /// Least and greatest thrust that it reaches, as far as that was found \[N\].
    pub range: (f64, f64),
}

impl Default for EngineState {
    fn default() -> Self {
        Self { deviation: 0.0, suspected: 0.0, range: (0.0, f64::INFINITY) }
    }
}

/// What a tick finds out about an engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// Nothing new.
    Nothing,
    /// It does not reach the thrust it is commanded.
    OutOfReach,
    /// Its sensor is wrong.
    WrongSensor,
}

impl EngineState {
    /// Whether it does not reach every thrust.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.range != Self::default().range
    }

    /// Whether it keeps its thrust, or has none.
    #[must_use]
    pub fn is_lost(&self, config: &EnginesConfig) -> bool {
        self.range.1 - self.range.0 < config.deviation_max
    }

    /// Takes in the thrust of this tick \[N\] and by how much it is not the predicted one, after `dt` \[s\]; `column` is
    /// the jet's one of `A_T`, `residual` is `n`. Without it nothing is judged: the confirmation begins anew.
    pub fn update(
        &mut self,
        config: &EnginesConfig,
        dt: f64,
        (thrust, innovation): (f64, f64),
        column: &Vector6<f64>,
        residual: Option<&Vector6<f64>>,
    ) -> Finding {
        self.deviation = libm::exp(-dt / config.time_constant) * self.deviation + innovation;
        let Some(residual) = residual.filter(|_| self.deviation.abs() > config.deviation_max) else {
            self.suspected = 0.0;
            return Finding::Nothing;
        };
        self.suspected += dt;
        // Half a tick is for rounding.
        if self.suspected < config.confirmation + 0.5 * dt {
            return Finding::Nothing;
        }
        let explained = -column.dot(residual) / column.norm_squared();
        if !self.is_limited() && explained / self.deviation > 0.5 {
            return Finding::WrongSensor;
        }
        let (least, greatest) = self.range;
        self.range =
            if self.deviation < 0.0 { (least.min(thrust), thrust) } else { (thrust, greatest.max(thrust)) };
        Finding::OutOfReach
    }
}
