//! The command that acts from one tick to the next, and what it lets expect.

use super::limits::JointCondition;
use nalgebra::DVector;

/// The last command, or what replaced it; kept for the next tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Acting {
    /// Thrust rates \[N/s\].
    pub thrust_rate: DVector<f64>,
    /// Commanded torques, the mean of several in a tick \[N m, N\].
    pub joint_torque: DVector<f64>,
    /// What each joint does with its torque.
    pub joints: Vec<JointCondition>,
    /// Friction with which the drives oppose the commanded velocities \[N m\].
    pub friction: DVector<f64>,
    /// Torques that act: of the commanded ones what the joints let act, less friction \[N m, N\].
    pub torque: DVector<f64>,
    /// Wrenches that keep the feet at rest, foot after foot \[N, N m\].
    pub foot_wrenches: DVector<f64>,
    /// Velocity `ν` of the tick.
    pub velocity: DVector<f64>,
    /// Acceleration `ν̇` that the command causes in its state.
    pub acceleration: DVector<f64>,
}

impl Acting {
    /// Nothing acts.
    #[must_use]
    pub fn new(joints: usize, jets: usize, feet: usize) -> Self {
        let (of_joints, rows) = (DVector::zeros(joints), DVector::zeros(6 + joints));
        Self {
            thrust_rate: DVector::zeros(jets),
            joint_torque: of_joints.clone(),
            joints: vec![JointCondition::default(); joints],
            friction: of_joints.clone(),
            torque: of_joints,
            foot_wrenches: DVector::zeros(6 * feet),
            velocity: rows.clone(),
            acceleration: rows,
        }
    }

    /// Sets the commanded torques \[N m, N\], and those that act.
    pub(super) fn set_torque(&mut self, joint_torque: impl IntoIterator<Item = f64>) {
        for (to, torque) in self.joint_torque.iter_mut().zip(joint_torque) {
            *to = torque;
        }
        self.reduce();
    }

    /// Takes the torques that act of the commanded ones.
    pub(super) fn reduce(&mut self) {
        let each = self.torque.iter_mut().zip(&self.joint_torque).zip(&self.joints).zip(&self.friction);
        for (((acting, commanded), found), friction) in each {
            *acting = found.effectiveness() * commanded - friction;
        }
    }
}
