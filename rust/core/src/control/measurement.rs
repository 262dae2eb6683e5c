//! What a tick measures, and the measurement as it is used.

use super::modes::Modes;
use crate::kinematics::RobotState;
use crate::robot::RobotModel;
use nalgebra::{Vector3, Vector6};

/// Measurement of a tick.
#[derive(Debug, Clone, Copy)]
pub struct Measurement<'a> {
    /// Time since the start of the flight \[s\].
    pub time: f64,
    /// Pose and velocity of the robot.
    pub state: &'a RobotState,
    /// Thrust of every jet \[N\], which is used where the speed of its shaft is not measured.
    pub thrust: &'a [f64],
    /// Speed of the shaft of every jet, a share of the full speed; NaN where it is not measured, or empty. Only a
    /// controller with `shaft` reads it: the thrust follows from it.
    pub shaft_speed: &'a [f64],
    /// Velocity of the air \[m/s, inertial axes\].
    pub wind: Vector3<f64>,
    /// Wrench on each foot about the origin of its sole, force first \[N, N m, inertial axes\], in the order of the
    /// robot's feet. Only a controller with `contact` reads it; others accept an empty slice.
    pub foot_wrenches: &'a [Vector6<f64>],
}

/// A measurement that owns its numbers, for the loop around a controller.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnedMeasurement {
    /// Pose and velocity of the robot.
    pub state: RobotState,
    /// Thrust of every jet \[N\].
    pub thrust: Vec<f64>,
    /// Speed of the shaft of every jet, a share of the full speed; NaN where it is not measured.
    pub shaft_speed: Vec<f64>,
    /// Velocity of the air \[m/s, inertial axes\].
    pub wind: Vector3<f64>,
    /// Wrench on each of the controller's feet \[N, N m\].
    pub foot_wrenches: Vec<Vector6<f64>>,
}

impl OwnedMeasurement {
    /// Zeros, without speeds of shafts.
    #[must_use]
    pub fn zero(joints: usize, jets: usize, feet: usize) -> Self {
        Self {
            state: RobotState::zero(joints),
            thrust: vec![0.0; jets],
            shaft_speed: vec![f64::NAN; jets],
            wind: Vector3::zeros(),
            foot_wrenches: vec![Vector6::zeros(); feet],
        }
    }

    /// That of a tick at `time` \[s\].
    #[must_use]
    pub fn at(&self, time: f64) -> Measurement<'_> {
        let Self { state, thrust, shaft_speed, wind, foot_wrenches } = self;
        Measurement { time, state, thrust, shaft_speed, wind: *wind, foot_wrenches }
    }
}

/// State and thrusts of a robot, measured or estimated.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Pose and velocity of the robot.
    pub state: RobotState,
    /// Thrust of every jet \[N\].
    pub thrust: Vec<f64>,
}

impl Reading {
    /// A robot at rest without thrust.
    #[must_use]
    pub fn zero(joints: usize, jets: usize) -> Self {
        Self { state: RobotState::zero(joints), thrust: vec![0.0; jets] }
    }

    /// Copies state and thrusts of the same robot without allocating.
    pub fn copy(&mut self, state: &RobotState, thrust: &[f64]) {
        self.state.copy_from(state);
        self.thrust.copy_from_slice(thrust);
    }

    pub(super) fn copy_from(&mut self, other: &Self) {
        self.copy(&other.state, &other.thrust);
    }

    /// Whether position, rotation, linear and angular velocity of the base are measured.
    pub(super) fn has_base(&self) -> [bool; 4] {
        let (linear, angular) = (self.state.base_linear_velocity(), self.state.base_angular_velocity());
        let are_finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
        let base = &self.state.base;
        [base.position.as_slice(), base.rotation.as_slice(), linear.as_slice(), angular.as_slice()]
            .map(are_finite)
    }

    pub(super) fn is_finite(&self) -> bool {
        self.state.is_finite() && self.thrust.iter().all(|thrust| thrust.is_finite())
    }
}

/// The measurement as a tick uses it: predicted where it is not measured.
#[derive(Debug, Clone)]
pub struct UsedMeasurement {
    /// Time of the controller (M108): that of the measurement, corrected for jumps of its clock \[s\].
    pub time: f64,
    /// Pose and velocity of the robot.
    pub state: RobotState,
    /// Thrust of every jet \[N\].
    pub thrust: Vec<f64>,
    /// Predicted rate of every thrust \[N/s\].
    pub thrust_rate: Vec<f64>,
    /// Difference of each thrust from its prediction, or its correction by the estimator; zero where the thrust is not
    /// measured \[N\].
    pub thrust_innovation: Vec<f64>,
    /// Error of each thrust sensor that is found to be wrong in this tick \[N\].
    pub sensor_error: Vec<Option<f64>>,
    /// Time since the last tick \[s\]; one time step if it is unknown.
    pub elapsed: f64,
    /// Advance of the measurement's clock if the time since the last tick is unknown, because either the clock has
    /// jumped or the controller has paused. Zero if the time is known or cannot be a pause \[s\].
    pub pause: f64,
    /// Whether the momentum is measured and the time since the last tick is known.
    pub has_momentum: bool,
    /// Time for which the momentum has not been measured, this tick and those before it \[s\]; infinite if it is unknown.
    pub gap: f64,
    /// Velocity of the air \[m/s, inertial axes\].
    pub wind: Vector3<f64>,
    /// Wrench on each foot \[N, N m, inertial axes\].
    pub foot_wrenches: Vec<Vector6<f64>>,
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
    /// It is measured, but not comparable with what was measured before.
    First,
    /// It is between two measurements.
    Between,
    /// It is not measured, and has not been for longer than between two measurements, or the time is unknown.
    Unknown,
}

impl UsedMeasurement {
    /// What this tick has of the momentum.
    #[must_use]
    pub fn sampling(&self) -> Sampling {
        match (self.has_momentum, self.modes.contains(Modes::BEGUN_AGAIN)) {
            (true, false) => Sampling::Measured,
            (true, true) => Sampling::First,
            (false, _) if self.is_between() => Sampling::Between,
            (false, _) => Sampling::Unknown,
        }
    }

    /// Whether this tick is between two measurements of the momentum.
    #[must_use]
    pub fn is_between(&self) -> bool {
        !self.has_momentum && self.gap <= BETWEEN_MAX
    }

    /// Zeros, for a robot with the tick `time_step` \[s\].
    #[must_use]
    pub fn new(robot: &RobotModel, time_step: f64) -> Self {
        let jets = robot.jets.len();
        Self {
            time: 0.0,
            state: RobotState::zero(robot.joints.len()),
            thrust: vec![0.0; jets],
            thrust_rate: vec![0.0; jets],
            thrust_innovation: vec![0.0; jets],
            sensor_error: vec![None; jets],
            elapsed: time_step,
            pause: 0.0,
            has_momentum: false,
            gap: 0.0,
            wind: Vector3::zeros(),
            foot_wrenches: vec![Vector6::zeros(); robot.feet.len()],
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
