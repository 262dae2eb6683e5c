//! Modes of a tick: what was not measured, and how the robot flies without it.

use std::fmt;

/// Set of the ways in which a tick differs from one with complete measurements, one bit each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Modes(u32);

impl Modes {
    /// The wind is the last measured one, held or fading.
    pub const WIND_HELD: Self = Self(1);
    /// The wind has been missing for so long that still air is assumed.
    pub const WIND_LOST: Self = Self(1 << 1);
    /// A thrust is predicted by the model of the jet.
    pub const THRUST_MODELLED: Self = Self(1 << 2);
    /// Joint positions and velocities are predicted by the model.
    pub const JOINTS_PREDICTED: Self = Self(1 << 3);
    /// The base position is predicted by the model.
    pub const POSITION_PREDICTED: Self = Self(1 << 4);
    /// The base rotation is predicted by the model.
    pub const ROTATION_PREDICTED: Self = Self(1 << 5);
    /// The base velocity is predicted by the model, or follows the pose.
    pub const VELOCITY_PREDICTED: Self = Self(1 << 6);
    /// The foot wrenches are those that keep the feet at rest in the model.
    pub const FEET_PREDICTED: Self = Self(1 << 7);
    /// The time is the controller's own, because the clock is missing or has jumped.
    pub const CLOCK_PREDICTED: Self = Self(1 << 8);
    /// The robot levels and descends instead of following its mission.
    pub const DESCENDING: Self = Self(1 << 9);
    /// An engine does not reach its commanded thrust.
    pub const ENGINE_LIMITED: Self = Self(1 << 10);
    /// The first measurements are outvoted: the flight begins again from those of this tick.
    pub const BEGUN_AGAIN: Self = Self(1 << 11);
    /// A joint does not follow its torque.
    pub const JOINT_LIMITED: Self = Self(1 << 12);
    /// The flight strays from its set-point.
    pub const STRAYING: Self = Self(1 << 14);
    /// The residual of a policy, or a given one, is not finite and not used.
    pub const RESIDUAL_IGNORED: Self = Self(1 << 15);
    /// Commands act later or earlier than the controller knows.
    pub const LATE: Self = Self(1 << 16);

    /// Modes in which a tick does not measure the momentum.
    pub(super) const WITHOUT_MOMENTUM: Self =
        Self(Self::JOINTS_PREDICTED.0 | Self::ROTATION_PREDICTED.0 | Self::VELOCITY_PREDICTED.0);

    /// All modes with their names.
    pub const NAMES: [(Self, &'static str); 16] = [
        (Self::WIND_HELD, "wind_held"),
        (Self::WIND_LOST, "wind_lost"),
        (Self::THRUST_MODELLED, "thrust_modelled"),
        (Self::JOINTS_PREDICTED, "joints_predicted"),
        (Self::POSITION_PREDICTED, "position_predicted"),
        (Self::ROTATION_PREDICTED, "rotation_predicted"),
        (Self::VELOCITY_PREDICTED, "velocity_predicted"),
        (Self::FEET_PREDICTED, "feet_predicted"),
        (Self::CLOCK_PREDICTED, "clock_predicted"),
        (Self::DESCENDING, "descending"),
        (Self::ENGINE_LIMITED, "engine_limited"),
        (Self::BEGUN_AGAIN, "begun_again"),
        (Self::JOINT_LIMITED, "joint_limited"),
        (Self::STRAYING, "straying"),
        (Self::RESIDUAL_IGNORED, "residual_ignored"),
        (Self::LATE, "late"),
    ];

    /// The set as a number, as in logs.
    #[must_use]
    pub fn bits(self) -> u32 {
        self.0
    }

    /// Whether the set is empty.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether all modes of `other` are in the set.
    #[must_use]
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether at least one mode of `other` is in the set.
    #[must_use]
    pub fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Adds the modes of `other`.
    pub fn insert(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// Names of the modes in the set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES.into_iter().filter_map(move |(mode, name)| self.contains(mode).then_some(name))
    }
}

/// Names of the modes, separated by commas; `none` if the set is empty.
impl fmt::Display for Modes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return f.write_str("none");
        }
        for (index, name) in self.names().enumerate() {
            write!(f, "{}{name}", if index > 0 { ", " } else { "" })?;
        }
        Ok(())
    }
}
