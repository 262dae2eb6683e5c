//! Output of a tick.

use super::measure::measurement::Estimate;
use super::modes::Modes;
use crate::jets::JetModel;
use crate::qp::{QpAnswer, QpStatus};
use nalgebra::DVector;
use std::fmt;

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
    /// The given set-point exceeds the accepted range, or its matrix is not a rotation: the command
    /// of the control law, which brakes from the motion of the last valid set-point.
    BadSetpoint,
    /// Set-points or winds of the preview exceed the accepted range, or their times do not increase: the command of the
    /// control law, without them.
    BadPreview,
    /// The predictive law has no new certified plan: it follows the last one.
    PlanKept,
    /// The predictive law has no certified plan: thrust rates and joint velocities are those of the momentum QP.
    PlanMissing,
    /// The momentum QP has no answer: thrust rates and joint velocities are zero, or as near to zero as their bounds
    /// allow; the torques brake the joints.
    MomentumHeld,
    /// The torque QP has no answer: torques keep their values.
    TorqueHeld,
    /// Neither QP has an answer.
    BothHeld,
}

impl CommandStatus {
    /// Of a command of the law in a tick with these modes.
    pub(super) fn of_modes(modes: Modes) -> Self {
        if modes.is_empty() { Self::Nominal } else { Self::Degraded }
    }

    /// Whether the torque QP is solved and the law has thrust rates and joint velocities, for a valid set-point.
    #[must_use]
    pub fn is_of_law(self) -> bool {
        matches!(self, Self::Nominal | Self::Degraded | Self::PlanKept | Self::PlanMissing)
    }

    /// Whether thrust rates, torques or both are not those of the law.
    #[must_use]
    pub fn is_held(self) -> bool {
        matches!(
            self,
            Self::MomentumHeld | Self::TorqueHeld | Self::BothHeld | Self::BadMeasurement | Self::BadState
        )
    }
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
            Self::BadPreview => "bad_preview",
            Self::PlanKept => "plan_kept",
            Self::PlanMissing => "plan_missing",
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
    /// Throttles that follow these rates \[%\], for a robot whose engines take no rates; zero for ideal jets.
    pub throttle: DVector<f64>,
    /// Joint velocities `ṡ*` \[rad/s\].
    pub joint_velocity: DVector<f64>,
    /// Joint torques after the rate limiter \[N m\].
    pub joint_torque: DVector<f64>,
    /// Answer of the QP that decides thrust rates and joint velocities: that of the plan, or the momentum QP.
    pub rates_qp: QpAnswer,
    /// Answer of the torque QP.
    pub torque_qp: QpAnswer,
    /// Whether this is the command of the control law.
    pub status: CommandStatus,
    /// Ways in which this tick differs from one with complete measurements.
    pub modes: Modes,
}

impl Command {
    /// The command of a robot with these numbers of jets and joints before its first tick: nothing moves.
    #[must_use]
    pub fn zero(jets: usize, joints: usize) -> Self {
        Self {
            thrust_rate: DVector::zeros(jets),
            throttle: DVector::zeros(jets),
            joint_velocity: DVector::zeros(joints),
            joint_torque: DVector::zeros(joints),
            rates_qp: QpAnswer::from_status(QpStatus::NonFinite),
            torque_qp: QpAnswer::from_status(QpStatus::NonFinite),
            status: CommandStatus::Nominal,
            modes: Modes::default(),
        }
    }

    /// Sets the throttles that follow the thrust rates, from the thrusts of a tick.
    pub(super) fn set_throttle(&mut self, jets: &[JetModel], used: &Estimate, time_step: f64) {
        let thrusts = used.robot.thrust.iter().zip(&used.thrust_rate).zip(&self.thrust_rate);
        for ((throttle, jet), ((thrust, rate), command)) in self.throttle.iter_mut().zip(jets).zip(thrusts) {
            *throttle = jet.throttle(*thrust, *rate, *command, time_step);
        }
    }

    /// Becomes the command of a tick that cannot act: nothing moves, torques stay.
    pub(super) fn set_hold(&mut self, status: CommandStatus, modes: Modes) {
        self.thrust_rate.fill(0.0);
        self.joint_velocity.fill(0.0);
        self.rates_qp = QpAnswer::from_status(QpStatus::NonFinite);
        self.torque_qp = QpAnswer::from_status(QpStatus::NonFinite);
        self.status = status;
        self.modes = modes;
    }
}
