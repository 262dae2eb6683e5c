//! The mission of a controller: commands of an autopilot, or recorded set-points.

use super::recorded::Recording;
use crate::error::{BuildError, check};
use serde::{Deserialize, Serialize};

/// Mission of a controller.
#[derive(Debug, Clone)]
pub enum Mission {
    /// Commands of an autopilot.
    Commands(Commands),
    /// Recorded set-points, followed without smoothing.
    Recorded(Recording),
}

/// Time interval `(start, end)` \[s\], open at both ends.
pub type Interval = (f64, f64);

/// Times of the autopilot's commands: lists of open intervals; a list may be empty or absent.
///
/// Source: the published autopilot; `configs/mission/*.toml` hold its three missions.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Commands {
    /// Climb \[s\].
    pub up: Vec<Interval>,
    /// Descend \[s\].
    pub down: Vec<Interval>,
    /// Descend to the ground, near it slowly \[s\].
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub land: Vec<Interval>,
    /// Fly forwards at normal speed \[s\].
    pub forward: Vec<Interval>,
    /// Fly forwards at increased speed, nose down \[s\].
    pub forward_turbo: Vec<Interval>,
    /// Raise the nose \[s\].
    pub pitch_up: Vec<Interval>,
    /// Turn left \[s\].
    pub yaw_left: Vec<Interval>,
}

/// Commands of one tick: −1, 0 or 1 along or about the robot's forward, left and up axes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct AutopilotCommand {
    /// Along the robot's forward axis.
    pub forward: i8,
    /// Upwards.
    pub vertical: i8,
    /// Nose down; a rotation about the left axis.
    pub nose_down: i8,
    /// To the left; a rotation about the vertical.
    pub yaw: i8,
    /// Whether the forward speed is increased.
    pub turbo: bool,
    /// Whether the robot is to land: near the ground it descends slowly.
    pub lands: bool,
}

impl Commands {
    /// Checks that intervals are finite and end after they start.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the list and the interval.
    pub fn check(&self) -> Result<(), BuildError> {
        for (name, intervals) in self.lists() {
            for &(start, end) in intervals {
                let of = |what: &str| format!("{what} of an interval of mission.{name}");
                check(&of("start"), start, |_| true, "finite seconds")?;
                check(&of("end"), end, |end| end > start, &format!("a time after the start {start}"))?;
            }
        }
        Ok(())
    }

    /// All lists with their keys.
    #[must_use]
    pub fn lists(&self) -> [(&'static str, &[Interval]); 7] {
        [
            ("up", &self.up),
            ("down", &self.down),
            ("land", &self.land),
            ("forward", &self.forward),
            ("forward_turbo", &self.forward_turbo),
            ("pitch_up", &self.pitch_up),
            ("yaw_left", &self.yaw_left),
        ]
    }

    /// The command at `time` \[s\].
    #[must_use]
    pub fn command(&self, time: f64) -> AutopilotCommand {
        // A tick at an end of an interval is outside; the margin prevents rounding of k · 0.01 from moving it
        // inside.
        const MARGIN: f64 = 1e-9;
        let active = |intervals: &[Interval]| {
            intervals.iter().any(|&(start, end)| time > start + MARGIN && time < end - MARGIN)
        };
        let (turbo, lands) = (active(&self.forward_turbo), active(&self.land));
        AutopilotCommand {
            forward: i8::from(turbo || active(&self.forward)),
            vertical: i8::from(active(&self.up)) - i8::from(active(&self.down) || lands),
            nose_down: -i8::from(active(&self.pitch_up)),
            yaw: i8::from(active(&self.yaw_left)),
            turbo,
            lands,
        }
    }
}
