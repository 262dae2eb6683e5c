//! Which measurements are accepted.

use serde::{Deserialize, Serialize};

/// Which measurements are accepted, and what replaces the others.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelsConfig {
    /// Whether differences from the prediction beyond [`Jumps::GREATEST`] are refused. Without it all differences are
    /// accepted, no value counts as frozen and no time step as wrong.
    pub jump: bool,
}

/// Greatest differences from the prediction. Thrusts and feet have no limit.
#[derive(Debug, Clone, PartialEq)]
pub struct Jumps {
    /// Wind \[m/s\].
    pub wind: f64,
    /// Joint position \[rad, m\].
    pub joint_position: f64,
    /// Joint velocity \[rad/s, m/s\].
    pub joint_velocity: f64,
    /// Position of the base \[m\].
    pub position: f64,
    /// Entry of the rotation matrix of the base.
    pub rotation: f64,
    /// Velocity of the base \[m/s\].
    pub velocity: f64,
    /// Angular velocity of the base \[rad/s\].
    pub angular_velocity: f64,
}

impl Jumps {
    /// Greatest accepted ones; what a tick can change is far less: gusts, noise and pushes pass.
    pub const GREATEST: Self = Self {
        // Six times what turbulence of 8 m/s changes. A wind that is beyond for as long as it is held is not used any more.
        wind: 5.0,
        joint_position: 0.5,
        joint_velocity: 30.0,
        position: 0.3,
        rotation: 0.2,
        velocity: 1.0,
        // Without a model the prediction is off by 2 in winds of 32 m/s.
        angular_velocity: 4.0,
    };

    /// No limits.
    pub(super) const NONE: Self = Self {
        wind: f64::INFINITY,
        joint_position: f64::INFINITY,
        joint_velocity: f64::INFINITY,
        position: f64::INFINITY,
        rotation: f64::INFINITY,
        velocity: f64::INFINITY,
        angular_velocity: f64::INFINITY,
    };
}
