//! The modes of a tick: what was not measured, given but ignored, found, or not answered by a solver.

use std::fmt;

/// Set of facts of a tick, one bit each; empty where everything is measured and both QPs are solved and certified.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Modes(u32);

/// A mode with its name and its meaning.
pub type Mode = (Modes, &'static str, &'static str);

/// Makes a constant of every mode, and a list of them.
macro_rules! modes {
    ($list:ident: $($(#[doc = $doc:literal])+ $name:ident = $bit:literal, $text:literal;)*) => {
        impl $crate::control::modes::Modes {
            $($(#[doc = $doc])+ pub const $name: Self = Self::of_bit($bit);)*
        }

        /// The modes of this module.
        pub(crate) const $list: [$crate::control::modes::Mode; [$($bit),*].len()] =
            [$(($crate::control::modes::Modes::$name, $text, concat!($($doc),+))),*];
    };
}
pub(crate) use modes;

/// Modes of several lists, in the order of their bits, which have no gaps.
pub(super) const fn listed<const N: usize>(lists: &[&[Mode]]) -> [Mode; N] {
    let mut all = [(Modes(0), "", ""); N];
    let mut list = 0;
    while list < lists.len() {
        let mut place = 0;
        while place < lists[list].len() {
            let mode = lists[list][place];
            let bit = mode.0.0.trailing_zeros() as usize;
            assert!(all[bit].1.is_empty(), "two modes have one bit");
            all[bit] = mode;
            place += 1;
        }
        list += 1;
    }
    all
}

modes! {
    OF_TICK:
    /// The wind is the last measured one, held or fading.
    WIND_HELD = 0, "wind_held";
    /// The wind has been missing for so long that still air is assumed.
    WIND_LOST = 1, "wind_lost";
    /// A thrust is predicted by the model of the jet.
    THRUST_MODELLED = 2, "thrust_modelled";
    /// Joint positions and velocities are predicted by the model.
    JOINTS_PREDICTED = 3, "joints_predicted";
    /// The base position is predicted by the model.
    POSITION_PREDICTED = 4, "position_predicted";
    /// The base rotation is predicted by the model.
    ROTATION_PREDICTED = 5, "rotation_predicted";
    /// The base velocity is predicted by the model, or follows the pose.
    VELOCITY_PREDICTED = 6, "velocity_predicted";
    /// The foot wrenches are those that keep the feet at rest in the model.
    FEET_PREDICTED = 7, "feet_predicted";
    /// The time is the controller's own, because the clock is missing or has jumped.
    CLOCK_PREDICTED = 8, "clock_predicted";
    /// The robot levels and descends instead of following its mission.
    DESCENDING = 9, "descending";
    /// The first measurements are outvoted: the flight begins again from those of this tick.
    BEGUN_AGAIN = 11, "begun_again";
    /// The measurement is not of this robot: thrust rates and joint velocities are zero, torques keep their values.
    MEASUREMENT_IGNORED = 13, "measurement_ignored";
    /// The residual of a policy, or a given one, is not finite and not used.
    RESIDUAL_IGNORED = 15, "residual_ignored";
    /// The state is of another controller; the command is as for an ignored measurement.
    STATE_IGNORED = 17, "state_ignored";
    /// The given set-point exceeds the accepted range, or its matrix is not a rotation: the robot brakes from the motion
    /// of the last valid one.
    SETPOINT_IGNORED = 18, "setpoint_ignored";
    /// Set-points or winds of the preview exceed the accepted range, or their times do not increase: none is used.
    PREVIEW_IGNORED = 19, "preview_ignored";
    /// The predictive law has no new certified plan: it follows the last one.
    PLAN_KEPT = 20, "plan_kept";
    /// The predictive law has no certified plan: the momentum QP decides.
    PLAN_MISSING = 21, "plan_missing";
    /// The momentum QP has no answer: thrust rates and joint velocities are as near to zero as their bounds allow; the
    /// torques brake the joints.
    MOMENTUM_HELD = 22, "momentum_held";
    /// The torque QP has no answer: torques keep their values.
    TORQUE_HELD = 23, "torque_held";
    /// The height above the ground has not been measured for 0.15 s: the ground is where it was found last.
    GROUND_HELD = 25, "ground_held";
}

impl Modes {
    /// The set of one mode.
    pub(crate) const fn of_bit(bit: u32) -> Self {
        Self(1 << bit)
    }

    /// Modes in which a tick does not measure the momentum.
    pub(super) const WITHOUT_MOMENTUM: Self =
        Self(Self::JOINTS_PREDICTED.0 | Self::ROTATION_PREDICTED.0 | Self::VELOCITY_PREDICTED.0);
    /// Modes in which thrust rates, torques or both are not those of the law.
    const HELD: Self = Self(
        Self::MEASUREMENT_IGNORED.0 | Self::STATE_IGNORED.0 | Self::MOMENTUM_HELD.0 | Self::TORQUE_HELD.0,
    );
    /// Modes that say what a solver did not answer, of a robot of which everything may be known.
    pub const OF_SOLVERS: Self =
        Self(Self::PLAN_KEPT.0 | Self::PLAN_MISSING.0 | Self::MOMENTUM_HELD.0 | Self::TORQUE_HELD.0);

    /// The set as a number, as in logs.
    #[must_use]
    pub const fn bits(self) -> u32 {
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

    /// Whether thrust rates, torques or both are not those of the law.
    #[must_use]
    pub fn is_held(self) -> bool {
        self.intersects(Self::HELD)
    }

    /// Adds the modes of `other`.
    pub fn insert(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// Adds the modes of `other` if they hold.
    pub(super) fn insert_if(&mut self, holds: bool, other: Self) {
        self.0 |= if holds { other.0 } else { 0 };
    }

    /// Names of the modes in the set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES.into_iter().filter_map(move |(mode, name, _)| self.contains(mode).then_some(name))
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
