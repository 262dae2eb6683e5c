//! What the law may use in a tick: as configured, or as the detectors allow.

use super::law::attitude::MomentumGains;
use crate::robot::RobotModel;

/// What a joint does with its torque.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum JointCondition {
    /// It acts.
    #[default]
    Healthy,
    /// The joint keeps its position.
    Stuck,
    /// This share of it acts.
    Weak(f64),
    /// It does not act.
    Free,
}

impl JointCondition {
    /// Share of the commanded torque that acts; all of it at a stuck joint, whose bearing holds against it.
    #[must_use]
    pub fn effectiveness(self) -> f64 {
        match self {
            Self::Healthy | Self::Stuck => 1.0,
            Self::Weak(share) => share,
            Self::Free => 0.0,
        }
    }

    /// Number in logs.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Healthy => 0,
            Self::Stuck => 1,
            Self::Weak(_) => 2,
            Self::Free => 3,
        }
    }
}

/// Why the robot descends instead of following its mission: it does so for any of these causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Descent {
    /// Joints or base have not been measured for too long: to the end of the flight, unless it begins again.
    pub is_blind: bool,
    /// An engine is lost: until it works again.
    pub is_without_engine: bool,
}

impl Descent {
    /// Whether the robot descends.
    #[must_use]
    pub fn is_active(self) -> bool {
        self.is_blind || self.is_without_engine
    }
}

/// Gains and limits of a tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Gains of the momentum and attitude tasks.
    pub gains: MomentumGains,
    /// Whether the centre of mass is held at its set-point; otherwise only its velocity is controlled (M107).
    pub holds_position: bool,
    /// Least and greatest thrust of each jet \[N\].
    pub thrust: Vec<(f64, f64)>,
    /// Whether each engine works: it reaches these thrusts as its model does.
    pub works: Vec<bool>,
    /// Greatest velocity of each joint \[rad/s, m/s\].
    pub joint_velocity: Vec<f64>,
    /// Greatest torque rate of each joint \[N m/s, N/s\].
    pub torque_rate: Vec<f64>,
    /// What each joint does with its torque.
    pub joints: Vec<JointCondition>,
}

impl Limits {
    /// The limits of `robot`, with these gains.
    #[must_use]
    pub fn new(gains: MomentumGains, robot: &RobotModel) -> Self {
        Self {
            gains,
            holds_position: true,
            thrust: robot.jets.iter().map(|jet| (jet.thrust_min, jet.thrust_max)).collect(),
            works: vec![true; robot.jets.len()],
            joint_velocity: robot.joints.iter().map(|joint| joint.velocity_max).collect(),
            torque_rate: robot.joints.iter().map(|joint| joint.torque_rate_max).collect(),
            joints: vec![JointCondition::Healthy; robot.joints.len()],
        }
    }

    /// Copies the limits of the same robot; does not allocate.
    pub fn copy_from(&mut self, other: &Self) {
        self.descend(other);
        self.thrust.copy_from_slice(&other.thrust);
        self.works.copy_from_slice(&other.works);
        self.joints.copy_from_slice(&other.joints);
    }

    /// Lowers the greatest velocities of joints that are stuck or free, those of a descent too.
    pub(super) fn slow_joints(&mut self) {
        for (joint, velocity_max) in self.joints.iter().zip(&mut self.joint_velocity) {
            *velocity_max = joint.velocity_max(*velocity_max);
        }
    }

    /// Takes the gains, and the rates of the joints, of a descent.
    pub(super) fn descend(&mut self, of_descent: &Self) {
        let Self { gains, holds_position, joint_velocity, torque_rate, .. } = of_descent;
        (self.gains, self.holds_position) = (*gains, *holds_position);
        self.joint_velocity.copy_from_slice(joint_velocity);
        self.torque_rate.copy_from_slice(torque_rate);
    }
}
