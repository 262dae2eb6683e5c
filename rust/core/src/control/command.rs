//! Output of a tick.

use super::measure::measurement::Estimate;
use super::modes::Modes;
use crate::jets::JetModel;
use crate::qp::{QpAnswer, QpStatus};
use nalgebra::DVector;

/// A command of the wrong size, or with a number that no drive and no engine can follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "this command cannot act; expected for every joint of this robot a torque of at most twice its greatest, and for every jet a thrust rate of at most 100 times its greatest thrust a second"
)]
pub struct BadCommand;

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
    /// What in this tick is not as usual, and whether the command is held: [`Modes::is_held`].
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
    pub(super) fn set_hold(&mut self, modes: Modes) {
        self.thrust_rate.fill(0.0);
        self.joint_velocity.fill(0.0);
        self.rates_qp = QpAnswer::from_status(QpStatus::NonFinite);
        self.torque_qp = QpAnswer::from_status(QpStatus::NonFinite);
        self.modes = modes;
    }
}
