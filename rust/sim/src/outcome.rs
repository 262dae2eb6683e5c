//! How a flight ended, and the limits that decide.
//!
//! The end of a flight is M80 of `docs/model`.

use crate::config::{FallConfig, SimulatorConfig};
use crate::log::FlightLog;
use crate::plant::Plant;
use crate::signals::TrackingErrors;
use crate::summary::Summary;
use nalgebra::Vector3;
use std::fmt;

/// Greatest distance of the centre of mass from its set-point after the start-up of a flight on course \[m\].
const COURSE_ERROR: f64 = 0.5;

/// Greatest speed downwards with which a robot that gave up its mission touches down \[m/s\]: that of a drop of 0.11 m.
const TOUCHDOWN_DOWNWARDS: f64 = 1.5;

/// Its greatest speed sideways \[m/s\].
const TOUCHDOWN_SIDEWAYS: f64 = 1.0;

/// Its greatest angle between base and vertical \[rad\]: 30 degrees.
const TOUCHDOWN_LEAN: f64 = std::f64::consts::FRAC_PI_6;

/// Greatest speed of base and air \[m/s\]: near that of sound, where no aerodynamic model here is valid.
pub(crate) const SPEED: f64 = 300.0;

/// Greatest angular velocity of the base \[rad/s\]: 16 turns per second.
const ANGULAR_VELOCITY: f64 = 100.0;

/// Greatest velocity of a joint \[rad/s, m/s\]: ten times that of motors of such robots.
const JOINT_VELOCITY: f64 = 100.0;

/// Greatest distance of a joint beyond its stops \[rad, m\]: about one turn.
const JOINT_EXCESS: f64 = 6.0;

/// Greatest ratio of a thrust to the jet's greatest.
const THRUST_RATIO: f64 = 10.0;

/// Outcome of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The mission was flown to its end, on course.
    Completed,
    /// The mission was flown to its end, but after the start-up further than 0.5 m from its set-point.
    OffCourse,
    /// The robot gave up its mission and touched down within the limits of a landing.
    Landed,
    /// The robot gave up its mission and was on its way down at the end.
    Landing,
    /// The robot gave up its mission and touched down too fast or too inclined.
    Crashed,
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
            Self::Landed => "landed",
            Self::Landing => "landing",
            Self::Crashed => "crashed",
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

/// Reason of an early end: the first two are falls, the next three crashes, the others a divergence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LossReason {
    /// Angle between base and desired base \[rad\].
    RotationError(f64),
    /// Distance of the centre of mass from its set-point \[m\].
    ComError(f64),
    /// Speed downwards at touch-down \[m/s\].
    DownwardSpeed(f64),
    /// Speed sideways at touch-down \[m/s\].
    SidewaysSpeed(f64),
    /// Angle between base and vertical at touch-down \[rad\].
    Lean(f64),
    /// The state contains a number that is not finite.
    NotFinite,
    /// Speed of base or air.
    Speed,
    /// Angular velocity of the base.
    AngularVelocity,
    /// Velocity of a joint.
    JointVelocity,
    /// Distance of a joint beyond its stops.
    JointPosition,
    /// Ratio of a thrust to the jet's greatest.
    Thrust,
}

impl LossReason {
    /// Whether the robot fell or crashed, or the computation diverged.
    #[must_use]
    pub fn outcome(self) -> Outcome {
        match self {
            Self::RotationError(_) | Self::ComError(_) => Outcome::Fell,
            Self::DownwardSpeed(_) | Self::SidewaysSpeed(_) | Self::Lean(_) => Outcome::Crashed,
            _ => Outcome::Diverged,
        }
    }
}

impl fmt::Display for LossReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RotationError(angle) => write!(f, "rotation error {:.1} deg", angle.to_degrees()),
            Self::ComError(distance) => write!(f, "CoM error {distance:.2} m"),
            Self::DownwardSpeed(speed) => write!(f, "touches down at {speed:.1} m/s"),
            Self::SidewaysSpeed(speed) => write!(f, "touches down at {speed:.1} m/s sideways"),
            Self::Lean(angle) => write!(f, "touches down at {:.1} deg from upright", angle.to_degrees()),
            Self::NotFinite => write!(f, "state not finite"),
            Self::Speed => write!(f, "speed of base or air above {SPEED} m/s"),
            Self::AngularVelocity => write!(f, "angular velocity above {ANGULAR_VELOCITY} rad/s"),
            Self::JointVelocity => write!(f, "joint velocity above {JOINT_VELOCITY} rad/s"),
            Self::JointPosition => write!(f, "joint more than {JOINT_EXCESS} rad beyond its stop"),
            Self::Thrust => write!(f, "thrust above {THRUST_RATIO} times its greatest"),
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

/// Limits beyond which a flight is lost, or off its course.
#[derive(Debug, Clone)]
pub struct Judge {
    fall: FallConfig,
}

impl Judge {
    /// The limits of a configuration.
    #[must_use]
    pub fn new(config: &SimulatorConfig) -> Self {
        Self { fall: config.fall.clone() }
    }

    /// Reason why a flight is lost, if it is: a physically impossible state, or a fall.
    #[must_use]
    pub fn loss(&self, plant: &Plant, wind: &Vector3<f64>, errors: &TrackingErrors) -> Option<LossReason> {
        Self::divergence(plant, wind).or_else(|| {
            if !errors.rotation.is_finite() || !errors.com.is_finite() {
                Some(LossReason::NotFinite)
            } else if errors.rotation > self.fall.rotation_error_deg.to_radians() {
                Some(LossReason::RotationError(errors.rotation))
            } else if errors.com > self.fall.com_error {
                Some(LossReason::ComError(errors.com))
            } else {
                None
            }
        })
    }

    /// Reason why the state is physically impossible, if it is.
    #[must_use]
    pub fn divergence(plant: &Plant, wind: &Vector3<f64>) -> Option<LossReason> {
        let (state, thrusts, robot) = (plant.state(), plant.jets().thrust(), plant.robot());
        let is_finite = state.is_finite() && thrusts.iter().chain(wind).all(|number| number.is_finite());
        let speed = state.base_linear_velocity().norm().max(wind.norm());
        let joints = || robot.joints.iter().zip(state.joint_position.iter());
        let excess =
            joints().map(|(joint, position)| (joint.stops.0 - position).max(position - joint.stops.1));
        let excess = excess.fold(f64::NEG_INFINITY, f64::max);
        let fastest =
            state.joint_velocity().iter().fold(0.0, |fastest: f64, velocity| fastest.max(velocity.abs()));
        let is_too_strong =
            robot.jets.iter().zip(thrusts).any(|(jet, thrust)| *thrust > THRUST_RATIO * jet.thrust_max);
        [
            (!is_finite, LossReason::NotFinite),
            (speed > SPEED, LossReason::Speed),
            (state.base_angular_velocity().norm() > ANGULAR_VELOCITY, LossReason::AngularVelocity),
            (fastest > JOINT_VELOCITY, LossReason::JointVelocity),
            (excess > JOINT_EXCESS, LossReason::JointPosition),
            (is_too_strong, LossReason::Thrust),
        ]
        .into_iter()
        .find_map(|(is_beyond, reason)| is_beyond.then_some(reason))
    }

    /// Reason why a touch-down is a crash, if it is: from the velocity of the centre of mass \[m/s\] and the angle between base
    /// and vertical \[rad\].
    #[must_use]
    pub fn crash(velocity: &Vector3<f64>, lean: f64) -> Option<LossReason> {
        let (down, sideways) = (-velocity.z, velocity.xy().norm());
        if down > TOUCHDOWN_DOWNWARDS {
            Some(LossReason::DownwardSpeed(down))
        } else if sideways > TOUCHDOWN_SIDEWAYS {
            Some(LossReason::SidewaysSpeed(sideways))
        } else if lean > TOUCHDOWN_LEAN {
            Some(LossReason::Lean(lean))
        } else {
            None
        }
    }

    /// Outcome of a flight that was lost or flown to its end, with a descent or along its mission.
    #[must_use]
    pub fn outcome(loss: Option<Loss>, descent: Option<Outcome>, summary: &Summary) -> Outcome {
        match (loss, descent) {
            (Some(loss), _) => loss.reason.outcome(),
            (None, Some(outcome)) => outcome,
            (None, None) if summary.max_com_error > COURSE_ERROR => Outcome::OffCourse,
            (None, None) => Outcome::Completed,
        }
    }
}
