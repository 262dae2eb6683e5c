//! Which measurements are accepted.

use serde::{Deserialize, Serialize};

/// Which measurements are accepted, and what replaces the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelsConfig {
    /// Time for which the last wind is held \[s\].
    #[schemars(range(min = 0))]
    pub wind_hold: f64,
    /// Age of a channel of joints or base above which the robot levels and descends, to the end of the flight \[s\].
    #[schemars(range(min = 0))]
    pub descend_after: f64,
    /// Greatest accepted difference of each component from the prediction. Without it all differences are accepted, no
    /// value counts as frozen and no time step as wrong.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jump: Option<Jumps>,
}

/// Greatest accepted differences from the prediction. Thrusts and feet have no limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Jumps {
    /// Wind \[m/s\]: more than a gust changes in a tick. A wind that is beyond for `wind_hold` is not used any more.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub wind: f64,
    /// Joint position \[rad, m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_position: f64,
    /// Joint velocity \[rad/s, m/s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_velocity: f64,
    /// Position of the base \[m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub position: f64,
    /// Entry of the rotation matrix of the base.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub rotation: f64,
    /// Velocity of the base \[m/s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub velocity: f64,
    /// Angular velocity of the base \[rad/s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub angular_velocity: f64,
}

impl Default for ChannelsConfig {
    fn default() -> Self {
        Self { wind_hold: 1.0, descend_after: 3.0, jump: None }
    }
}

impl Jumps {
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

impl Default for Jumps {
    fn default() -> Self {
        Self {
            wind: 5.0,
            joint_position: 0.5,
            joint_velocity: 30.0,
            position: 0.3,
            rotation: 0.2,
            velocity: 1.0,
            angular_velocity: 2.0,
        }
    }
}
