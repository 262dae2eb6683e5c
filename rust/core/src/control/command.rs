//! Inputs and outputs of a tick.

use super::channels::Modes;
use crate::kinematics::RobotState;
use crate::qp::QpAnswer;
use nalgebra::{DVector, Vector3, Vector6};
use std::fmt;

/// Measurement of a tick.
#[derive(Debug, Clone, Copy)]
pub struct Measurement<'a> {
    /// Time since the start of the flight \[s\].
    pub time: f64,
    /// Pose and velocity of the robot.
    pub state: &'a RobotState,
    /// Thrust of every jet \[N\].
    pub thrust: &'a [f64],
    /// Velocity of the air \[m/s, inertial axes\].
    pub wind: Vector3<f64>,
    /// Wrench on each foot about the origin of its sole, force first \[N, N m, inertial axes\], in the order of the
    /// robot's feet. Only a controller with `contact` reads it; others accept an empty slice.
    pub foot_wrenches: &'a [Vector6<f64>],
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
    /// The base rotation is not a rotation.
    #[error(
        "a flight cannot begin: `base_rotation` is not a rotation; expected orthonormal columns, right-handed, to 1e-6"
    )]
    NoRotation,
    /// In this posture the centroidal inertia cannot be inverted, or inertia or centre of mass overflow.
    #[error("a flight cannot begin: in this posture the inertia of the robot cannot be inverted")]
    SingularInertia,
}

/// A command with a number that is not finite, or of the wrong size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "this command cannot act; expected a finite number for every thrust rate and joint torque of this robot"
)]
pub struct BadCommand;

/// Whether a command is that of the control law.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandStatus {
    /// Both QPs are solved and certified.
    Nominal,
    /// Both QPs are solved and certified, but part of the measurement is predicted or the robot descends: see
    /// [`Command::modes`].
    Degraded,
    /// The measurement is not of this robot: thrust rates and joint velocities are zero, torques keep their values.
    BadMeasurement,
    /// The state belongs to another controller; the command is as for a bad measurement.
    BadState,
    /// The given set-point exceeds the accepted range (`channels.greatest`), or its matrix is not a rotation: the command
    /// of the control law, which brakes from the motion of the last valid set-point.
    BadSetpoint,
    /// The momentum QP has no answer: thrust rates and joint velocities are zero, or as near to zero as their bounds
    /// allow; the torques brake the joints.
    MomentumHeld,
    /// The torque QP has no answer: torques keep their values.
    TorqueHeld,
    /// Neither QP has an answer.
    BothHeld,
}

/// The name, as C has it: `bad_setpoint`.
impl fmt::Display for CommandStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nominal => "nominal",
            Self::Degraded => "degraded",
            Self::BadMeasurement => "bad_measurement",
            Self::BadState => "bad_state",
            Self::BadSetpoint => "bad_setpoint",
            Self::MomentumHeld => "momentum_held",
            Self::TorqueHeld => "torque_held",
            Self::BothHeld => "both_held",
        })
    }
}

/// Command of the controller, held until the next tick.
#[derive(Debug, Clone)]
pub struct Command {
    /// Thrust rates `Ṫ*` \[N/s\].
    pub thrust_rate: DVector<f64>,
    /// Joint velocities `ṡ*` \[rad/s\].
    pub joint_velocity: DVector<f64>,
    /// Joint torques after the rate limiter \[N m\].
    pub joint_torque: DVector<f64>,
    /// Answer of the momentum QP.
    pub momentum_qp: QpAnswer,
    /// Answer of the torque QP.
    pub torque_qp: QpAnswer,
    /// Whether this is the command of the control law.
    pub status: CommandStatus,
    /// Ways in which this tick differs from one with complete measurements.
    pub modes: Modes,
}
