//! Which engines follow their commands.
//!
//! ```text
//! d ← e^{−Δt/τ} d + (T_k − T̂_k)        how far a thrust has left the commanded one, T̂ by M31
//! n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)  what the momentum says beside the observed wrench
//! ```
//!
//! Where `|d|` stays above its limit for a while, either the engine is lost or its sensor is wrong. A wrong sensor puts
//! a wrench of `−d` times the jet's column of `A_T` into the momentum that no thrust explains; an engine that is lost
//! puts none. Equations M105 and M106 of `docs/model.md`.

use crate::error::{BuildError, check};
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

/// When an engine counts as lost.
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
    /// Whether the robot levels and descends when an engine is lost.
    pub descend: bool,
}

impl EnginesConfig {
    /// Refuses numbers that mean nothing.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let at = |key: &str, value: f64, accept: fn(f64) -> bool, expected: &str| {
            check(&format!("controller.engines.{key}"), value, accept, expected).map(|_| ())
        };
        at("time_constant", self.time_constant, |x| x > 0.0, "a positive number")?;
        at("deviation_max", self.deviation_max, |x| x > 0.0, "a positive number")?;
        at("confirmation", self.confirmation, |x| x >= 0.0, "a number ≥ 0")
    }
}

/// What is known of an engine.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EngineState {
    /// `d` \[N\].
    pub deviation: f64,
    /// How long it has been too large \[s\].
    suspected: f64,
    /// Whether the engine is lost; for good.
    pub is_lost: bool,
}

/// What a tick finds out about an engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// Nothing new.
    Nothing,
    /// It is lost.
    Lost,
    /// Its sensor is wrong.
    WrongSensor,
}

impl EngineState {
    /// Takes in by how much the thrust of this tick is not the predicted one, after `dt` \[s\]; `column` is the jet's one
    /// of `A_T`, `residual` is `n`.
    pub fn update(
        &mut self,
        config: &EnginesConfig,
        dt: f64,
        innovation: f64,
        column: &Vector6<f64>,
        residual: &Vector6<f64>,
    ) -> Finding {
        self.deviation = libm::exp(-dt / config.time_constant) * self.deviation + innovation;
        if self.is_lost || self.deviation.abs() <= config.deviation_max {
            self.suspected = 0.0;
            return Finding::Nothing;
        }
        self.suspected += dt;
        // Half a tick is for rounding.
        if self.suspected < config.confirmation + 0.5 * dt {
            return Finding::Nothing;
        }
        let explained = -column.dot(residual) / column.norm_squared();
        if explained / self.deviation > 0.5 {
            return Finding::WrongSensor;
        }
        self.is_lost = true;
        Finding::Lost
    }
}
