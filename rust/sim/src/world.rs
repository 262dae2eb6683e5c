//! Another simulation of the robot's bodies, handed in: what moves them there, and what is on the ground.
//!
//! ```text
//! World::observe ──► state, feet, joints ──► Plant::observe   kinematics, air, jets: of this crate, for every world
//! World::advance ◄── joint torques, generalised force ◄── Plant::advance_in
//! ```

use flight_core::kinematics::RobotState;
use flight_core::robot::RobotModel;
use nalgebra::{Vector3, Vector6};
use std::fmt::Debug;

/// What is seen of a robot in a world.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Pose and velocity.
    pub state: RobotState,
    /// The same as the robot finds it before the errors of its sensors, such as by its legs.
    pub measured: RobotState,
    /// Wrench on each foot about the origin of its sole, force first \[N, N m, inertial axes\].
    pub foot_wrenches: Vec<Vector6<f64>>,
    /// Torque that reaches each joint: of the motor, less its friction \[N m, N\].
    pub joint_torque: Vec<f64>,
    /// Origin of each sole \[m\].
    pub soles: Vec<Vector3<f64>>,
}

impl Seen {
    /// Zeros, for `robot`.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let (joints, feet) = (robot.joints.len(), robot.feet.len());
        Self {
            state: RobotState::zero(joints),
            measured: RobotState::zero(joints),
            foot_wrenches: vec![Vector6::zeros(); feet],
            joint_torque: vec![0.0; joints],
            soles: vec![Vector3::zeros(); feet],
        }
    }
}

/// A simulation of the robot's bodies in place of this crate's. One that cannot go on shows a state that is not finite.
pub trait World: Debug + Send + Sync {
    /// Writes what is seen at the beginning of a tick, or of a tick of the torques.
    fn observe(&mut self, seen: &mut Seen);

    /// Advances by so many physics steps: `torque` has a row of joint torques for each \[N m, N\]. `force` is the
    /// generalised force of jets, air and pushes throughout: on the base, force and moment about its origin in inertial
    /// axes, then on the joints \[N, N m\].
    fn advance(&mut self, steps: u32, torque: &[f64], force: &[f64]);
}
