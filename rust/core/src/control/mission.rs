//! What a controller is to fly: commands of an autopilot, or a recorded reference.

use super::recorded::Recording;
use crate::error::{BuildError, check};
use serde::{Deserialize, Serialize};

/// What a controller is to fly.
#[derive(Debug, Clone)]
pub enum Mission {
    /// Commands of an autopilot.
    Commands(Commands),
    /// A recorded reference, followed as it is.
    Recorded(Recording),
}

impl Mission {
    /// Refuses commands that [`Commands::check`] refuses.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the list and the interval.
    pub fn check(&self) -> Result<(), BuildError> {
        match self {
            Self::Commands(commands) => commands.check(),
            Self::Recorded(_) => Ok(()),
        }
    }
}

/// Time interval `(start, end)` \[s\], open at both ends.
pub type Interval = (f64, f64);

/// When the autopilot commands what. Every list may be empty or absent.
///
/// Source: the published autopilot; `configs/envelope/*.toml` hold its three envelopes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Commands {
    /// Climb.
    pub up: Vec<Interval>,
    /// Descend.
    pub down: Vec<Interval>,
    /// Fly forwards at the plain step.
    pub forward: Vec<Interval>,
    /// Fly forwards with the growing turbo step, nose down.
    pub forward_turbo: Vec<Interval>,
    /// Raise the nose.
    pub pitch_up: Vec<Interval>,
    /// Turn left.
    pub yaw_left: Vec<Interval>,
}

/// What the autopilot asks for in one tick; −1, 0 or 1 in the sense of the robot's base axes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct AutopilotCommand {
    /// Along base x; the base's x axis points backwards, so forwards is −1.
    pub forward: i8,
    /// Along z.
    pub vertical: i8,
    /// Pitch rate.
    pub pitch: i8,
    /// Yaw rate.
    pub yaw: i8,
    /// Whether the forward step may grow.
    pub turbo: bool,
}

impl Commands {
    /// Refuses intervals that are not finite or do not end after they start.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the list and the interval.
    pub fn check(&self) -> Result<(), BuildError> {
        for (name, intervals) in self.lists() {
            for &(start, end) in intervals {
                let of = |what: &str| format!("{what} of an interval of envelope.{name}");
                check(&of("start"), start, |_| true, "finite seconds")?;
                check(&of("end"), end, |end| end > start, &format!("a time after the start {start}"))?;
            }
        }
        Ok(())
    }

    /// Every list under its key.
    #[must_use]
    pub fn lists(&self) -> [(&'static str, &[Interval]); 6] {
        [
            ("up", &self.up),
            ("down", &self.down),
            ("forward", &self.forward),
            ("forward_turbo", &self.forward_turbo),
            ("pitch_up", &self.pitch_up),
            ("yaw_left", &self.yaw_left),
        ]
    }

    /// The command at `time` \[s\].
    #[must_use]
    pub fn command(&self, time: f64) -> AutopilotCommand {
        // A tick that falls on an end of an interval is outside; the margin keeps rounding of
        // k · 0.01 from moving it inside.
        const MARGIN: f64 = 1e-9;
        let active = |intervals: &[Interval]| {
            intervals.iter().any(|&(start, end)| time > start + MARGIN && time < end - MARGIN)
        };
        let turbo = active(&self.forward_turbo);
        AutopilotCommand {
            forward: -i8::from(turbo || active(&self.forward)),
            vertical: i8::from(active(&self.up)) - i8::from(active(&self.down)),
            pitch: i8::from(active(&self.pitch_up)),
            yaw: i8::from(active(&self.yaw_left)),
            turbo,
        }
    }
}
