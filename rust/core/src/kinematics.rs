//! Poses, velocities, centre of mass and Jacobians of a state of the robot.
//!
//! Velocities are *mixed*: `ν = (v_B, ω_B, ṡ)`, where `v_B` is the velocity of the base origin and
//! `ω_B` the angular velocity of the base, both in inertial axes. A Jacobian has one column for each
//! entry of `ν`.
//!
//! A Jacobian is requested as "the point `p`, moving with body `b`". The lever-arm errors of the published code
//! (`docs/deviations.md`) apply a force at a wrong point in space, so correct and published lever arms differ in this
//! point only.
//!
//! Equations M7 to M10 of `docs/model`.

use crate::robot::{Frame, JointKind, RobotModel};
use crate::spatial::{Pose, axis_angle, exp_so3, parts, stack};
use nalgebra::{DVector, Matrix3, Matrix3xX, Vector3, Vector6};

/// Pose, joint positions and velocity of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotState {
    /// Pose of the base in inertial axes.
    pub base: Pose,
    /// Joint positions, in the order of the robot's TOML \[rad\].
    pub joint_position: DVector<f64>,
    /// Mixed velocity `ν = (v_B, ω_B, ṡ)` \[m/s, rad/s, rad/s\].
    pub velocity: DVector<f64>,
}

impl RobotState {
    /// A robot at rest with the base at the origin and all joints at zero.
    #[must_use]
    pub fn zero(n_joints: usize) -> Self {
        Self {
            base: Pose::identity(),
            joint_position: DVector::zeros(n_joints),
            velocity: DVector::zeros(6 + n_joints),
        }
    }

    /// Number of joints.
    #[must_use]
    pub fn n_joints(&self) -> usize {
        self.joint_position.len()
    }

    /// Velocity of the base origin \[m/s, inertial axes\].
    #[must_use]
    pub fn base_linear_velocity(&self) -> Vector3<f64> {
        self.velocity.fixed_rows::<3>(0).into()
    }

    /// Angular velocity of the base \[rad/s, inertial axes\].
    #[must_use]
    pub fn base_angular_velocity(&self) -> Vector3<f64> {
        self.velocity.fixed_rows::<3>(3).into()
    }

    /// Joint velocities \[rad/s\].
    #[must_use]
    pub fn joint_velocity(&self) -> &[f64] {
        &self.velocity.as_slice()[6..]
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.base.position.iter().all(|x| x.is_finite())
            && self.base.rotation.iter().all(|x| x.is_finite())
            && self.joint_position.iter().all(|x| x.is_finite())
            && self.velocity.iter().all(|x| x.is_finite())
    }

    /// Advances the pose by `step` \[s\] at the present velocity (M78).
    pub fn advance_pose(&mut self, step: f64) {
        self.base.position += self.base_linear_velocity() * step;
        self.base.rotation = exp_so3(&(self.base_angular_velocity() * step)) * self.base.rotation;
        for (position, velocity) in self.joint_position.iter_mut().zip(&self.velocity.as_slice()[6..]) {
            *position += velocity * step;
        }
    }

    /// Copies another state of the same robot; does not allocate.
    pub fn copy_from(&mut self, other: &Self) {
        self.base = other.base;
        self.joint_position.copy_from(&other.joint_position);
        self.velocity.copy_from(&other.velocity);
    }
}

/// Pose and velocity of one body, with the effect of its joint.
#[derive(Debug, Clone, Copy)]
pub struct BodyMotion {
    /// Pose of the body in inertial axes.
    pub i_from_b: Pose,
    /// Velocity of the body's origin \[m/s, inertial axes\].
    pub linear_velocity: Vector3<f64>,
    /// Angular velocity of the body \[rad/s, inertial axes\].
    pub angular_velocity: Vector3<f64>,
    /// Velocity of the body's origin per unit rate of its joint, inertial axes: the axis of a prismatic joint, zero
    /// for a revolute one and for the base.
    pub joint_linear_i: Vector3<f64>,
    /// Angular velocity of the body per unit rate of its joint, inertial axes: the axis of a revolute joint, zero for
    /// a prismatic one and for the base.
    pub joint_angular_i: Vector3<f64>,
    /// Velocity of the body's point at the base origin per unit rate of its joint, inertial axes.
    pub joint_linear_at_base_i: Vector3<f64>,
}

impl BodyMotion {
    /// Velocity of the point of the body that is now at `point_i` \[m/s, inertial axes\].
    #[must_use]
    pub fn velocity_at(&self, point_i: &Vector3<f64>) -> Vector3<f64> {
        self.linear_velocity + self.angular_velocity.cross(&(point_i - self.i_from_b.position))
    }

    /// Velocity of the point at `point_i`, moving with the body, per unit rate of the body's joint.
    #[must_use]
    #[inline] // into the callers of `visit_jacobian_columns` in other crates
    pub fn joint_velocity_at(&self, point_i: &Vector3<f64>) -> Vector3<f64> {
        self.joint_linear_i + self.joint_angular_i.cross(&(point_i - self.i_from_b.position))
    }
}

/// A body at the origin, at rest.
const AT_REST: BodyMotion = BodyMotion {
    i_from_b: Pose { rotation: ROTATION, position: ZERO },
    linear_velocity: ZERO,
    angular_velocity: ZERO,
    joint_linear_i: ZERO,
    joint_angular_i: ZERO,
    joint_linear_at_base_i: ZERO,
};
const ZERO: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);
const ROTATION: Matrix3<f64> = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);

/// Kinematics of one state; preallocated, recomputed by [`Kinematics::update`].
#[derive(Debug, Clone)]
pub struct Kinematics {
    /// Motion of every body; body 0 is the base, body `i + 1` is moved by joint `i`.
    pub bodies: Vec<BodyMotion>,
    /// Centre of mass \[m, inertial axes\].
    pub com: Vector3<f64>,
    /// Joint positions of this state \[rad\].
    pub joint_position: Vec<f64>,
    /// For every body, the joints between it and the base, from the base outwards.
    chains: Vec<Vec<usize>>,
    mass: f64,
}

impl Kinematics {
    /// Allocates for the kinematics of `robot`, with its zero state.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let mut chains: Vec<Vec<usize>> = Vec::with_capacity(robot.bodies.len());
        for (index, body) in robot.bodies.iter().enumerate() {
            let mut chain = body.parent.map(|parent| chains[parent].clone()).unwrap_or_default();
            if body.parent.is_some() {
                chain.push(index - 1);
            }
            chains.push(chain);
        }
        let mut kinematics = Self {
            bodies: vec![AT_REST; robot.bodies.len()],
            com: Vector3::zeros(),
            joint_position: vec![0.0; robot.joints.len()],
            chains,
            mass: robot.mass(),
        };
        kinematics.update(robot, &RobotState::zero(robot.joints.len()));
        kinematics
    }

    /// Recomputes all quantities for `state`.
    pub fn update(&mut self, robot: &RobotModel, state: &RobotState) {
        self.bodies[0] = BodyMotion {
            i_from_b: state.base,
            linear_velocity: state.base_linear_velocity(),
            angular_velocity: state.base_angular_velocity(),
            ..AT_REST
        };
        let joint_velocity = state.joint_velocity();
        self.joint_position.copy_from_slice(state.joint_position.as_slice());
        for (index, joint) in robot.joints.iter().enumerate() {
            let (before, after) = self.bodies.split_at_mut(index + 1);
            let parent = &before[robot.bodies[index + 1].parent.unwrap_or(0)];
            let axis_b = joint.axis_b.into_inner();
            let mut i_from_b = parent.i_from_b * joint.parent_from_child;
            // The axis has the same components in the child frame and in the joint frame.
            let axis_i = i_from_b.rotation * axis_b;
            let position = state.joint_position[index];
            let (joint_linear_i, joint_angular_i) = match joint.kind {
                JointKind::Revolute => {
                    i_from_b.rotation *= axis_angle(&axis_b, position);
                    (ZERO, axis_i)
                }
                JointKind::Prismatic => {
                    i_from_b.position += axis_i * position;
                    (axis_i, ZERO)
                }
            };
            let (rate, to_base) = (joint_velocity[index], state.base.position - i_from_b.position);
            after[0] = BodyMotion {
                i_from_b,
                linear_velocity: parent.velocity_at(&i_from_b.position) + joint_linear_i * rate,
                angular_velocity: parent.angular_velocity + joint_angular_i * rate,
                joint_linear_i,
                joint_angular_i,
                joint_linear_at_base_i: joint_linear_i + joint_angular_i.cross(&to_base),
            };
        }
        let first_moment: Vector3<f64> = (robot.bodies.iter().zip(&self.bodies))
            .map(|(body, motion)| motion.i_from_b.transform_point(&body.com_b) * body.mass)
            .sum();
        self.mass = robot.mass();
        self.com = first_moment / self.mass;
    }

    /// Total mass \[kg\].
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Length of `ν`: 6 + number of joints.
    #[must_use]
    pub fn n_velocities(&self) -> usize {
        self.bodies.len() + 5
    }

    /// Pose of a frame in inertial axes.
    #[must_use]
    pub fn frame_pose(&self, frame: &Frame) -> Pose {
        self.bodies[frame.body].i_from_b * frame.body_from_frame
    }

    /// Joints between a body and the base, from the base outwards. In a Jacobian of that body only their columns and
    /// the six of the base are non-zero.
    #[must_use]
    pub fn chain(&self, body: usize) -> &[usize] {
        &self.chains[body]
    }

    /// Visits the non-zero columns of the Jacobian of the point of `body` that is now at `point_i`:
    /// `visit(column, linear, angular)`.
    ///
    /// Base translation gives `(e_k, 0)`, base rotation `(e_k × r, e_k)`; a joint at `o_j` with axis a gives
    /// `(a × (p − o_j), a)` if it is revolute and `(a, 0)` if it is prismatic.
    pub fn visit_jacobian_columns(
        &self,
        body: usize,
        point_i: &Vector3<f64>,
        mut visit: impl FnMut(usize, Vector3<f64>, Vector3<f64>),
    ) {
        let arm = point_i - self.bodies[0].i_from_b.position;
        for k in 0..3 {
            visit(k, unit_axis(k), Vector3::zeros());
        }
        for k in 0..3 {
            visit(3 + k, unit_axis(k).cross(&arm), unit_axis(k));
        }
        for &joint in &self.chains[body] {
            let motion = &self.bodies[joint + 1];
            visit(6 + joint, motion.joint_velocity_at(point_i), motion.joint_angular_i);
        }
    }

    /// Linear and angular Jacobian (each 3 × [`Self::n_velocities`]) of the point of `body` that is now at `point_i`.
    /// Allocates, so only for inspection and tests; a tick uses [`Self::visit_jacobian_columns`].
    #[must_use]
    pub fn jacobian(&self, body: usize, point_i: &Vector3<f64>) -> (Matrix3xX<f64>, Matrix3xX<f64>) {
        let mut linear = Matrix3xX::zeros(self.n_velocities());
        let mut angular = Matrix3xX::zeros(self.n_velocities());
        self.visit_jacobian_columns(body, point_i, |column, v, w| {
            linear.set_column(column, &v);
            angular.set_column(column, &w);
        });
        (linear, angular)
    }

    /// Adds `Jᵀ f`, the generalised force of the force `force_i` \[N\] on `body` at `point_i`.
    pub fn add_generalised_force(
        &self,
        body: usize,
        point_i: &Vector3<f64>,
        force_i: &Vector3<f64>,
        generalised: &mut DVector<f64>,
    ) {
        let moment = (point_i - self.bodies[0].i_from_b.position).cross(force_i);
        for k in 0..3 {
            generalised[k] += force_i[k];
            generalised[3 + k] += moment[k];
        }
        for &joint in &self.chains[body] {
            generalised[6 + joint] += self.bodies[joint + 1].joint_velocity_at(point_i).dot(force_i);
        }
    }

    /// Adds the generalised forces of the jets of `robot` and of their moments; `thrusts` are forces along the jet axes
    /// \[N\].
    pub fn add_thrusts(
        &self,
        robot: &RobotModel,
        thrusts: impl IntoIterator<Item = f64>,
        generalised: &mut DVector<f64>,
    ) {
        for (jet, thrust) in robot.jets.iter().zip(thrusts) {
            let pose = self.frame_pose(&jet.frame);
            let force = pose.rotation * jet.axis_f.into_inner() * thrust;
            let wrench = stack(&force, &(force * jet.torque_to_thrust));
            self.add_generalised_wrench(jet.frame.body, &pose.position, &wrench, generalised);
        }
    }

    /// Adds the generalised force of a wrench on `body` about `point_i`, force first \[N, N m, inertial axes\].
    pub fn add_generalised_wrench(
        &self,
        body: usize,
        point_i: &Vector3<f64>,
        wrench_i: &Vector6<f64>,
        generalised: &mut DVector<f64>,
    ) {
        let (force, moment) = parts(wrench_i);
        self.visit_jacobian_columns(body, point_i, |column, v, w| {
            generalised[column] += v.dot(&force) + w.dot(&moment);
        });
    }
}

/// Unit vector along axis `k` (0, 1 or 2).
#[inline]
fn unit_axis(k: usize) -> Vector3<f64> {
    let mut e = Vector3::zeros();
    e[k] = 1.0;
    e
}
