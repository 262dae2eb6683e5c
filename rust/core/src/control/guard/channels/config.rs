//! Criteria for accepting measurements, and constants of the predictions that replace the others.

use crate::error::{BuildError, Table};
use serde::{Deserialize, Serialize};

/// Which measurements are accepted, and what replaces the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ChannelsConfig {
    /// Time for which the last wind is held \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub wind_hold: f64,
    /// Time in which the wind fades to zero after `wind_hold` \[s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub wind_fade: f64,
    /// Number of ticks with the same bits after which a value may count as frozen.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 100_000)))]
    pub frozen_ticks: u32,
    /// Share of `jump` within which the second measurement confirms the first, and a first joint position may be beyond
    /// its stops: less than a wrong first measurement can do harm with, more than noise of sensors.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub confirmation: f64,
    /// Relative growth of `jump` with the age of a channel \[1/s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub widening: f64,
    /// Gain with which a base velocity that is not measured follows the differences of the pose \[1/s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub velocity_gain: f64,
    /// Age of a channel of joints or base above which the robot levels and descends, to the end of the flight \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub descend_after: f64,
    /// Greatest accepted magnitude of each component.
    pub greatest: Greatest,
    /// Greatest accepted difference of each component from the prediction. Without it all differences are accepted, no
    /// value counts as frozen and no time step as wrong.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jump: Option<Jumps>,
}

/// Greatest accepted magnitudes; by default those of a simulated flight that has not diverged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Greatest {
    /// Wind \[m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub wind: f64,
    /// Thrust, as a multiple of the jet's greatest.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub thrust: f64,
    /// Joint position \[rad, m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub joint_position: f64,
    /// Joint velocity \[rad/s, m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub joint_velocity: f64,
    /// Position of the base \[m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub position: f64,
    /// Velocity of the base \[m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub velocity: f64,
    /// Angular velocity of the base \[rad/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub angular_velocity: f64,
    /// Force on a foot \[N\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub foot_force: f64,
    /// Moment on a foot \[N m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub foot_moment: f64,
}

/// Greatest accepted differences from the prediction. Thrusts and feet have no limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Jumps {
    /// Wind \[m/s\]: more than a gust changes in a tick. A wind that is beyond for `wind_hold` is not used any more.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub wind: f64,
    /// Joint position \[rad, m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub joint_position: f64,
    /// Joint velocity \[rad/s, m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub joint_velocity: f64,
    /// Position of the base \[m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub position: f64,
    /// Entry of the rotation matrix of the base.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub rotation: f64,
    /// Velocity of the base \[m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub velocity: f64,
    /// Angular velocity of the base \[rad/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub angular_velocity: f64,
}

impl Default for ChannelsConfig {
    fn default() -> Self {
        Self {
            wind_hold: 1.0,
            wind_fade: 2.0,
            frozen_ticks: 5,
            confirmation: 0.2,
            widening: 1.0,
            velocity_gain: 100.0,
            descend_after: 3.0,
            greatest: Greatest::default(),
            jump: None,
        }
    }
}

impl Default for Greatest {
    fn default() -> Self {
        Self {
            wind: 300.0,
            thrust: 10.0,
            joint_position: 100.0,
            joint_velocity: 100.0,
            position: 1e6,
            velocity: 300.0,
            angular_velocity: 100.0,
            foot_force: 1e5,
            foot_moment: 1e5,
        }
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

impl ChannelsConfig {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let table = Table("controller.channels");
        for (key, value) in [
            ("wind_hold", self.wind_hold),
            ("widening", self.widening),
            ("velocity_gain", self.velocity_gain),
            ("descend_after", self.descend_after),
        ] {
            table.check_non_negative(key, value)?;
        }
        let (greatest, jump) = (&self.greatest, self.jump.clone().unwrap_or_default());
        for (key, value) in [
            ("wind_fade", self.wind_fade),
            ("frozen_ticks", f64::from(self.frozen_ticks)),
            ("confirmation", self.confirmation),
            ("greatest.wind", greatest.wind),
            ("greatest.thrust", greatest.thrust),
            ("greatest.joint_position", greatest.joint_position),
            ("greatest.joint_velocity", greatest.joint_velocity),
            ("greatest.position", greatest.position),
            ("greatest.velocity", greatest.velocity),
            ("greatest.angular_velocity", greatest.angular_velocity),
            ("greatest.foot_force", greatest.foot_force),
            ("greatest.foot_moment", greatest.foot_moment),
            ("jump.wind", jump.wind),
            ("jump.joint_position", jump.joint_position),
            ("jump.joint_velocity", jump.joint_velocity),
            ("jump.position", jump.position),
            ("jump.rotation", jump.rotation),
            ("jump.velocity", jump.velocity),
            ("jump.angular_velocity", jump.angular_velocity),
        ] {
            table.check_positive(key, value)?;
        }
        Ok(())
    }
}
