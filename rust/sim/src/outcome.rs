//! How a flight ended, and the limits that decide.
//!
//! The end of a flight is M80 of `docs/model`.

use crate::config::{DivergenceConfig, FallConfig, SimulatorConfig};
use crate::log::FlightLog;
use crate::plant::Plant;
use crate::signals::TrackingErrors;
use crate::summary::Summary;
use nalgebra::Vector3;
use std::fmt;

/// Outcome of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The mission was flown to its end, on course.
    Completed,
    /// The mission was flown to its end, but after the start-up the errors exceeded `simulator.course_error`.
    OffCourse,
    /// The robot gave up its mission and came down to the height at which the flight began, or was on its way down at the end.
    Descended,
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
            Self::Descended => "descended",
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
            Self::Speed(limit) => write!(f, "speed of base or air above {limit} m/s"),
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

/// Limits beyond which a flight is lost, or off its course.
#[derive(Debug, Clone)]
pub struct Judge {
    fall: FallConfig,
    divergence: DivergenceConfig,
    /// \[m\]
    course_error: f64,
}

impl Judge {
    /// The limits of a configuration.
    #[must_use]
    pub fn new(config: &SimulatorConfig) -> Self {
        let SimulatorConfig { fall, divergence, course_error, .. } = config;
        Self { fall: fall.clone(), divergence: divergence.clone(), course_error: *course_error }
    }

    /// Reason why a flight is lost, if it is: a physically impossible state, or a fall.
    #[must_use]
    pub fn loss(&self, plant: &Plant, wind: &Vector3<f64>, errors: &TrackingErrors) -> Option<LossReason> {
        self.divergence(plant, wind).or_else(|| {
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
    pub fn divergence(&self, plant: &Plant, wind: &Vector3<f64>) -> Option<LossReason> {
        let (state, thrusts, robot) = (plant.state(), plant.jets().thrust(), plant.robot());
        let limits = &self.divergence;
        let is_finite = state.is_finite() && thrusts.iter().chain(wind).all(|number| number.is_finite());
        let speed = state.base_linear_velocity().norm().max(wind.norm());
        let joints = || robot.joints.iter().zip(state.joint_position.iter());
        let excess =
            joints().map(|(joint, position)| (joint.stops.0 - position).max(position - joint.stops.1));
        let excess = excess.fold(f64::NEG_INFINITY, f64::max);
        let fastest =
            state.joint_velocity().iter().fold(0.0, |fastest: f64, velocity| fastest.max(velocity.abs()));
        let is_too_strong = robot
            .jets
            .iter()
            .zip(thrusts)
            .any(|(jet, thrust)| *thrust > limits.thrust_ratio * jet.thrust_max);
        [
            (!is_finite, LossReason::NotFinite),
            (speed > limits.speed, LossReason::Speed(limits.speed)),
            (
                state.base_angular_velocity().norm() > limits.angular_velocity,
                LossReason::AngularVelocity(limits.angular_velocity),
            ),
            (fastest > limits.joint_velocity, LossReason::JointVelocity(limits.joint_velocity)),
            (excess > limits.joint_excess, LossReason::JointPosition(limits.joint_excess)),
            (is_too_strong, LossReason::Thrust(limits.thrust_ratio)),
        ]
        .into_iter()
        .find_map(|(is_beyond, reason)| is_beyond.then_some(reason))
    }

    /// Outcome of a flight that was lost or flown to its end, in which the robot descends or follows its mission.
    #[must_use]
    pub fn outcome(&self, loss: Option<Loss>, is_descending: bool, summary: &Summary) -> Outcome {
        match loss {
            Some(loss) => loss.reason.outcome(),
            None if is_descending => Outcome::Descended,
            None if summary.max_com_error > self.course_error => Outcome::OffCourse,
            None => Outcome::Completed,
        }
    }
}
