//! What a tick is given of the robot, and what it makes of it: one set of numbers, which sensors write, channels complete,
//! estimators replace, and the law reads.

use crate::control::modes::Modes;
use crate::kinematics::RobotState;
use crate::robot::RobotModel;
use nalgebra::{DVector, Vector3};
use std::slice::{from_mut, from_ref};

/// Measurement of a tick.
#[derive(Debug, Clone)]
pub struct Measurement {
    /// Time since the start of the flight \[s\].
    pub time: f64,
    /// Pose and velocity of the robot.
    pub state: RobotState,
    /// Thrust of every jet \[N\], which is used where the speed of its shaft is not measured.
    pub thrust: Vec<f64>,
    /// Speed of the shaft of every jet, a share of the full speed; NaN where it is not measured, or empty. Only a
    /// controller with `shaft` reads it: the thrust follows from it.
    pub shaft_speed: Vec<f64>,
    /// Velocity of the air \[m/s, inertial axes\].
    pub wind: Vector3<f64>,
    /// Wrench on each foot about the origin of its sole, force first, foot after foot \[N, N m, inertial axes\], in the
    /// order of the robot's feet. Only a controller with `contact` reads it; others accept none.
    pub foot_wrenches: DVector<f64>,
    /// Height of the base origin above that on the ground on which the robot is to land, in the posture in which the flight
    /// begins \[m\]; NaN where it is not measured.
    pub height: f64,
}

/// Equal numbers; a height that neither has is equal too, because few robots measure it.
impl PartialEq for Measurement {
    fn eq(&self, other: &Self) -> bool {
        let Self { time, state, thrust, shaft_speed, wind, foot_wrenches, height } = self;
        (time, state, thrust, shaft_speed, wind, foot_wrenches)
            == (
                &other.time,
                &other.state,
                &other.thrust,
                &other.shaft_speed,
                &other.wind,
                &other.foot_wrenches,
            )
            && (*height == other.height || (height.is_nan() && other.height.is_nan()))
    }
}

/// Numbers of a measurement that are accepted or predicted together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::control) enum Channel {
    Wind,
    Thrust(usize),
    Joints,
    LinearVelocity,
    AngularVelocity,
    Position,
    Rotation,
    Feet,
    Height,
}

impl Measurement {
    /// A robot at rest with these numbers of joints, jets and feet, at time zero in still air; speeds of shafts and height
    /// are not measured.
    #[must_use]
    pub fn zero(joints: usize, jets: usize, feet: usize) -> Self {
        Self {
            time: 0.0,
            state: RobotState::zero(joints),
            thrust: vec![0.0; jets],
            shaft_speed: vec![f64::NAN; jets],
            wind: Vector3::zeros(),
            foot_wrenches: DVector::zeros(6 * feet),
            height: f64::NAN,
        }
    }

    /// Copies state, thrusts, wind, height and foot wrenches of the same robot; does not allocate.
    pub(in crate::control) fn copy_from(&mut self, other: &Self) {
        let Self { time, state, thrust, wind, foot_wrenches, height, .. } = other;
        (self.time, self.wind, self.height) = (*time, *wind, *height);
        self.state.copy_from(state);
        self.thrust.copy_from_slice(thrust);
        if self.foot_wrenches.len() <= foot_wrenches.len() {
            self.foot_wrenches.copy_from_slice(&foot_wrenches.as_slice()[..self.foot_wrenches.len()]);
        }
    }

    /// Numbers of a channel, in at most two runs.
    #[inline]
    pub(in crate::control) fn numbers(&self, channel: Channel) -> [&[f64]; 2] {
        let RobotState { base, joint_position, velocity } = &self.state;
        let run = match channel {
            Channel::Wind => self.wind.as_slice(),
            Channel::Thrust(jet) => from_ref(&self.thrust[jet]),
            Channel::Joints => return [joint_position.as_slice(), &velocity.as_slice()[6..]],
            Channel::LinearVelocity => &velocity.as_slice()[..3],
            Channel::AngularVelocity => &velocity.as_slice()[3..6],
            Channel::Position => base.position.as_slice(),
            Channel::Rotation => base.rotation.as_slice(),
            Channel::Feet => self.foot_wrenches.as_slice(),
            Channel::Height => from_ref(&self.height),
        };
        [run, &[]]
    }

    /// The same, to be changed.
    #[inline]
    pub(in crate::control) fn numbers_mut(&mut self, channel: Channel) -> [&mut [f64]; 2] {
        let RobotState { base, joint_position, velocity } = &mut self.state;
        let run = match channel {
            Channel::Wind => self.wind.as_mut_slice(),
            Channel::Thrust(jet) => from_mut(&mut self.thrust[jet]),
            Channel::Joints => {
                return [joint_position.as_mut_slice(), &mut velocity.as_mut_slice()[6..]];
            }
            Channel::LinearVelocity => &mut velocity.as_mut_slice()[..3],
            Channel::AngularVelocity => &mut velocity.as_mut_slice()[3..6],
            Channel::Position => base.position.as_mut_slice(),
            Channel::Rotation => base.rotation.as_mut_slice(),
            Channel::Feet => self.foot_wrenches.as_mut_slice(),
            Channel::Height => from_mut(&mut self.height),
        };
        [run, &mut []]
    }

    /// Copies the numbers of a channel.
    #[inline]
    pub(in crate::control) fn copy_channel(&mut self, channel: Channel, from: &Self) {
        for (to, from) in self.numbers_mut(channel).into_iter().zip(from.numbers(channel)) {
            to.copy_from_slice(from);
        }
    }

    /// Marks a channel as not measured.
    pub(in crate::control) fn remove(&mut self, channel: Channel) {
        self.numbers_mut(channel).into_iter().for_each(|numbers| numbers.fill(f64::NAN));
    }

    /// Whether every number of a channel is finite.
    #[inline]
    pub(in crate::control) fn is_measured(&self, channel: Channel) -> bool {
        self.numbers(channel).into_iter().flatten().all(|number| number.is_finite())
    }
}

/// Estimate of the robot in a tick: measured, predicted where it is not measured, or estimated; the controller's state has that
/// of the last tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// State, thrusts, wind, foot wrenches and height, at the time of the controller (M108): that of the measurement, corrected for
    /// jumps of its clock.
    pub robot: Measurement,
    /// Standard deviation of the wind where it is estimated, else zero \[m/s\].
    pub wind_std: Vector3<f64>,
    /// Predicted rate of every thrust \[N/s\].
    pub thrust_rate: Vec<f64>,
    /// Difference of each thrust from its prediction, or its correction by the estimator; zero where the thrust is not
    /// measured \[N\].
    pub thrust_innovation: Vec<f64>,
    /// What the sensor of each thrust says, also one that is not used; NaN where nothing that can be right \[N\].
    pub thrust_reading: Vec<f64>,
    /// Whether each thrust is that of a measured speed.
    pub is_of_speed: Vec<bool>,
    /// Time since the last tick \[s\]; one time step if it is unknown.
    pub elapsed: f64,
    /// Advance of the measurement's clock if the time since the last tick is unknown, because either the clock has
    /// jumped or the controller has paused. Zero if the time is known or cannot be a pause \[s\].
    pub pause: f64,
    /// What the tick has of the momentum.
    pub momentum: Sampling,
    /// Time for which the momentum has not been measured, this tick and those before it \[s\]; infinite if it is unknown.
    pub gap: f64,
    /// Which parts are not measured.
    pub modes: Modes,
}

/// Longest time between two measurements of a channel that has a rate of its own, 10 Hz and jitter \[s\].
pub const BETWEEN_MAX: f64 = 0.15;

/// What a tick has of the momentum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampling {
    /// It is measured.
    Measured,
    /// It is measured, but not comparable with what was measured before: in the first tick nothing was.
    First,
    /// It is between two measurements.
    Between,
    /// It is not measured, and has not been for longer than between two measurements, or the time is unknown.
    Unknown,
}

impl Estimate {
    /// Zeros, for a robot with the tick `time_step` \[s\], and so many jets.
    #[must_use]
    pub fn new(robot: &RobotModel, jets: usize, time_step: f64) -> Self {
        Self {
            robot: Measurement {
                shaft_speed: Vec::new(), // they are thrusts here
                ..Measurement::zero(robot.joints.len(), jets, robot.feet.len())
            },
            wind_std: Vector3::zeros(),
            thrust_rate: vec![0.0; jets],
            thrust_innovation: vec![0.0; jets],
            thrust_reading: vec![0.0; jets],
            is_of_speed: vec![false; jets],
            elapsed: time_step,
            pause: 0.0,
            momentum: Sampling::Unknown,
            gap: 0.0,
            modes: Modes::default(),
        }
    }
}

/// Reason why a flight cannot start with a measurement.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum BadStart {
    /// Numbers of joints, thrusts or feet differ from the robot's.
    #[error(
        "a flight cannot begin with a measurement of another robot; expected {joints} joints, {jets} thrusts, {feet} feet"
    )]
    OtherRobot {
        /// Number of joints.
        joints: usize,
        /// Number of jets.
        jets: usize,
        /// Number of feet whose wrenches are measured.
        feet: usize,
    },
    /// A number is missing or implausible.
    #[error("a flight cannot begin: `{name}` holds {value}; expected {expected}")]
    BadValue {
        /// Field of the measurement.
        name: &'static str,
        /// The number.
        value: f64,
        /// What is accepted.
        expected: &'static str,
    },
    /// A joint is further beyond its stops than a measurement can be wrong.
    #[error(
        "a flight cannot begin: `joint_position[{joint}]` holds {position}; expected its range, {lower} to {upper}"
    )]
    BeyondStops {
        /// Index of the joint.
        joint: usize,
        /// Its position \[rad, m\].
        position: f64,
        /// Least accepted position \[rad, m\].
        lower: f64,
        /// Greatest accepted position \[rad, m\].
        upper: f64,
    },
    /// The base rotation is not a rotation.
    #[error(
        "a flight cannot begin: `base_rotation` is not a rotation; expected orthonormal columns, right-handed, to 1e-6"
    )]
    NoRotation,
    /// The floating-point environment of the thread is not the default one.
    #[error("a flight cannot begin: this thread has {mode}; expected IEEE 754's default modes")]
    FloatingPoint {
        /// What it has instead.
        mode: &'static str,
    },
    /// In this posture the centroidal inertia cannot be inverted, or inertia or centre of mass overflow.
    #[error("a flight cannot begin: in this posture the inertia of the robot cannot be inverted")]
    SingularInertia,
}
