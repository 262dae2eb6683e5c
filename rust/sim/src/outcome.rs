//! How a flight ended.

use crate::log::FlightLog;
use crate::summary::Summary;
use std::fmt;

/// Outcome of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The mission was flown to its end, on course.
    Completed,
    /// The mission was flown to its end, but after the start-up the errors exceeded `simulator.course_error`.
    OffCourse,
    /// The robot fell: its rotation error or position error passed its limit.
    Fell,
    /// The computation diverged: numbers are not finite or physically impossible, so the result has no meaning.
    Diverged,
}

impl Outcome {
    /// Name in result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::OffCourse => "off_course",
            Self::Fell => "fell",
            Self::Diverged => "diverged",
        }
    }
}

/// Time and reason of an early end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loss {
    /// Time \[s\].
    pub time: f64,
    /// The quantity that exceeded its limit.
    pub reason: LossReason,
}

/// Reason of an early end, with the limit: the first two are falls, the others a divergence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LossReason {
    /// Angle between base and desired base \[rad\].
    RotationError(f64),
    /// Distance of the centre of mass from its set-point \[m\].
    ComError(f64),
    /// The state contains a number that is not finite.
    NotFinite,
    /// Speed of base or air \[m/s\].
    Speed(f64),
    /// Angular velocity of the base \[rad/s\].
    AngularVelocity(f64),
    /// Velocity of a joint \[rad/s, m/s\].
    JointVelocity(f64),
    /// Distance of a joint beyond its stops \[rad, m\].
    JointPosition(f64),
    /// Ratio of a thrust to the jet's greatest.
    Thrust(f64),
}

impl LossReason {
    /// Whether the robot fell or the computation diverged.
    #[must_use]
    pub fn outcome(self) -> Outcome {
        match self {
            Self::RotationError(_) | Self::ComError(_) => Outcome::Fell,
            _ => Outcome::Diverged,
        }
    }
}

impl fmt::Display for LossReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RotationError(angle) => write!(f, "rotation error {:.1} deg", angle.to_degrees()),
            Self::ComError(distance) => write!(f, "CoM error {distance:.2} m"),
            Self::NotFinite => write!(f, "state not finite"),
            Self::Speed(limit) => write!(f, "speed above {limit} m/s"),
            Self::AngularVelocity(limit) => write!(f, "angular velocity above {limit} rad/s"),
            Self::JointVelocity(limit) => write!(f, "joint velocity above {limit} rad/s"),
            Self::JointPosition(limit) => write!(f, "joint more than {limit} rad beyond its stop"),
            Self::Thrust(limit) => write!(f, "thrust above {limit} times its greatest"),
        }
    }
}

/// A finished flight.
#[derive(Debug, Clone)]
pub struct FlightResult {
    /// Outcome of the flight.
    pub outcome: Outcome,
    /// Time and reason of an early end, if any.
    pub loss: Option<Loss>,
    /// All signals.
    pub log: FlightLog,
    /// Figures of merit, without the row in which a flight diverged.
    pub summary: Summary,
}
