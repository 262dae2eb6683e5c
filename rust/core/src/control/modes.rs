//! Sets of modes of a tick: what was not measured, and how the robot flies without it. The list is in [`guard`](super::guard).

use std::fmt;

/// Set of the ways in which a tick differs from one with complete measurements, one bit each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Modes(pub(super) u32);

/// Makes a constant of every mode, and [`Modes::NAMES`], from one list.
macro_rules! modes {
    ($($(#[doc = $doc:literal])+ $name:ident = $bit:literal, $text:literal;)*) => {
        impl Modes {
            $($(#[doc = $doc])+ pub const $name: Self = Self(1 << $bit);)*

            /// All modes with their names and meanings.
            pub const NAMES: [(Self, &'static str, &'static str); [$($bit),*].len()] =
                [$((Self::$name, $text, concat!($($doc),+))),*];
        }
    };
}
pub(super) use modes;

impl Modes {
    /// Modes in which a tick does not measure the momentum.
    pub(super) const WITHOUT_MOMENTUM: Self =
        Self(Self::JOINTS_PREDICTED.0 | Self::ROTATION_PREDICTED.0 | Self::VELOCITY_PREDICTED.0);

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
