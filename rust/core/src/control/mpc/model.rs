//! Centroidal dynamics with aerodynamics, linearised at the present state.
//!
//! ```text
//! δẇ = ∂w/∂(v, θ, k, T, s, ṡ)       rate of linear and angular momentum, w = A_T T + (Σ f ; Σ r × f) + const
//! ω = I_G⁻¹ (k − A_k ṡ)              angular velocity of the base
//! ```
//!
//! `θ` rotates the whole robot about its centre of mass, which stays. All in inertial axes. Equations M116 to M119 of
//! `docs/model`.

use super::config::Air;
use crate::aero::{AeroModel, ForceDerivatives, LinkForces};
use crate::control::law::momentum::MomentumModel;
use crate::control::measure::measurement::Measurement;
use crate::control::terms::{Present, Terms};
use crate::dynamics::Dynamics;
use crate::kinematics::Kinematics;
use crate::robot::{JointKind, RobotModel};
use crate::spatial::{skew, stack};
use nalgebra::{Matrix3, Matrix3xX, Matrix6x3, Matrix6xX, Vector3, Vector6};

/// Derivatives of the momentum rate and of the angular velocity; preallocated.
#[derive(Debug, Clone)]
pub struct Linearised {
    /// Joints that the law moves, as indices of the robot's joints.
    pub joints: Vec<usize>,
    /// Momentum rate \[N, N m\] by the velocity of the centre of mass.
    pub rate_v: Matrix6x3<f64>,
    /// By the rotation `θ` \[rad\].
    pub rate_theta: Matrix6x3<f64>,
    /// By the angular momentum `k`.
    pub rate_k: Matrix6x3<f64>,
    /// By the thrusts: `A_T`.
    pub rate_t: Matrix6xX<f64>,
    /// By the positions of [`Self::joints`].
    pub rate_s: Matrix6xX<f64>,
    /// By their velocities.
    pub rate_sigma: Matrix6xX<f64>,
    /// Angular velocity \[rad/s\] by `θ`.
    pub omega_theta: Matrix3<f64>,
    /// By `k`.
    pub omega_k: Matrix3<f64>,
    /// By the positions of [`Self::joints`].
    pub omega_s: Matrix3xX<f64>,
    /// By their velocities.
    pub omega_sigma: Matrix3xX<f64>,
    /// Derivatives of every link's force; zero where the air's wrench is constant.
    links: Vec<ForceDerivatives>,
    /// Momentum of every subtree.
    momenta: Vec<(Vector3<f64>, Vector3<f64>)>,
}

/// What the dynamics are linearised at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point<'a> {
    pub(super) robot: &'a Measurement,
    pub(super) kinematics: &'a Kinematics,
    pub(super) dynamics: &'a Dynamics,
    pub(super) momentum: &'a MomentumModel,
    pub(super) link_forces: &'a LinkForces,
}

impl Linearised {
    /// Allocates for `robot` and the joints that the law moves.
    #[must_use]
    pub fn new(robot: &RobotModel, joints: Vec<usize>) -> Self {
        let free = joints.len();
        Self {
            joints,
            rate_v: Matrix6x3::zeros(),
            rate_theta: Matrix6x3::zeros(),
            rate_k: Matrix6x3::zeros(),
            rate_t: Matrix6xX::zeros(robot.jets.len()),
            rate_s: Matrix6xX::zeros(free),
            rate_sigma: Matrix6xX::zeros(free),
            omega_theta: Matrix3::zeros(),
            omega_k: Matrix3::zeros(),
            omega_s: Matrix3xX::zeros(free),
            omega_sigma: Matrix3xX::zeros(free),
            links: vec![ForceDerivatives::zero(); robot.aero_links.len()],
            momenta: vec![(Vector3::zeros(), Vector3::zeros()); robot.bodies.len()],
        }
    }

    /// Linearises at the present state; `false` if the inertia cannot be inverted.
    #[must_use]
    pub fn update(&mut self, robot: &RobotModel, aero: &AeroModel, air: Air, now: Present) -> bool {
        let Terms { dynamics, kinematics, momentum, link_forces, .. } = now.terms;
        self.update_at(
            robot,
            aero,
            air,
            Point { robot: &now.estimate.robot, kinematics, dynamics, momentum, link_forces },
        )
    }

    /// Linearises at any state.
    pub(super) fn update_at(&mut self, robot: &RobotModel, aero: &AeroModel, air: Air, now: Point) -> bool {
        let Point { dynamics, kinematics, momentum, .. } = now;
        let Some(inverse) = dynamics.centroidal_inertia.try_inverse() else { return false };
        let total = dynamics.momentum;
        let (l, k): (Vector3<f64>, Vector3<f64>) =
            (total.fixed_rows::<3>(0).into(), total.fixed_rows::<3>(3).into());
        let omega = now.robot.state.base_angular_velocity();
        self.omega_k = inverse;
        self.omega_theta = inverse * skew(&k) - skew(&omega);
        dynamics.subtree_momenta(robot, kinematics, &mut self.momenta);

        self.rate_t.copy_from(&momentum.a_t);
        self.rate_v.fill(0.0);
        let mut turned = Vector6::zeros(); // wrench that turns with the robot
        for (column, thrust) in momentum.a_t.column_iter().zip(&now.robot.thrust) {
            turned += column * *thrust;
        }
        let mut by_omega = Matrix6x3::zeros();
        if air == Air::Linear {
            self.add_links_of_base(aero, now, &mut by_omega, &mut turned);
        }
        for (place, &joint) in self.joints.iter().enumerate() {
            let (by_l, by_k) = dynamics.momentum_by_joint(robot, kinematics, &self.momenta, joint);
            let column = dynamics.momentum_matrix.fixed_view::<6, 1>(0, 6 + joint);
            let (omega_s, omega_sigma) = (-inverse * by_k, -inverse * column.fixed_rows::<3>(3));
            self.omega_s.set_column(place, &omega_s);
            self.omega_sigma.set_column(place, &omega_sigma);
            let lambda: Vector6<f64> = momentum.lambda_t.column(6 + joint).into();
            let (mut by_s, mut by_sigma) = (lambda + by_omega * omega_s, by_omega * omega_sigma);
            if air == Air::Linear {
                let (links_s, links_sigma) =
                    of_joint(robot, &self.links, now, joint, &(by_l / kinematics.mass()));
                by_s += links_s;
                by_sigma += links_sigma;
            }
            self.rate_s.set_column(place, &by_s);
            self.rate_sigma.set_column(place, &by_sigma);
        }
        self.rate_k = by_omega * inverse;
        // f(θ; v, k, wind) = R f(0; Rᵀ v, Rᵀ k, Rᵀ wind), and f depends on v − wind.
        let through_air = l / kinematics.mass() - now.robot.wind;
        self.rate_theta = self.rate_v * skew(&through_air) + self.rate_k * skew(&k);
        for (rows, vector) in [(0, turned.fixed_rows::<3>(0)), (3, turned.fixed_rows::<3>(3))] {
            let mut block = self.rate_theta.fixed_rows_mut::<3>(rows);
            block -= skew(&vector.into());
        }
        true
    }

    /// Adds every link's derivatives by `v` and by the angular velocity, and its force to what turns with the robot.
    fn add_links_of_base(
        &mut self,
        aero: &AeroModel,
        now: Point,
        by_omega: &mut Matrix6x3<f64>,
        turned: &mut Vector6<f64>,
    ) {
        let Point { link_forces, kinematics, .. } = now;
        for (index, derivatives) in self.links.iter_mut().enumerate() {
            *derivatives = aero.derivatives(index, &link_forces.axes_i[index], &link_forces.v_air_i[index]);
            let by_air = derivatives.by_velocity;
            let arm = link_forces.arm_points_i[index] - kinematics.com;
            let force = link_forces.forces_i[index];
            *turned += stack(&force, &arm.cross(&force));
            let (of_air, arm) = (-by_air, skew(&arm));
            // The air's velocity relative to the link falls by v and by ω × r.
            let of_turning = by_air * arm;
            add_rows(&mut self.rate_v, &of_air, &(arm * of_air));
            add_rows(by_omega, &of_turning, &(arm * of_turning));
        }
    }
}

/// Change of the links' wrench by position and velocity of a joint, at constant `v` and ω; `moves` is the velocity
/// that the centre of mass gains per unit of the joint's position at constant ν.
fn of_joint(
    robot: &RobotModel,
    links: &[ForceDerivatives],
    now: Point,
    joint: usize,
    moves: &Vector3<f64>,
) -> (Vector6<f64>, Vector6<f64>) {
    let Point { link_forces, kinematics, dynamics, .. } = now;
    let j_g: Vector3<f64> = dynamics.momentum_matrix.fixed_view::<3, 1>(0, 6 + joint) / kinematics.mass();
    let motion = &kinematics.bodies[joint + 1];
    let parent = &kinematics.bodies[robot.bodies[joint + 1].parent.unwrap_or(0)];
    let turn = motion.joint_angular_i;
    debug_assert!(robot.joints[joint].kind == JointKind::Revolute || turn == Vector3::zeros());
    let (mut by_s, mut by_sigma) = (Vector6::zeros(), Vector6::zeros());
    for (index, link) in robot.aero_links.iter().enumerate() {
        let (axis, derivatives) = (&link_forces.axes_i[index], &links[index]);
        let centre = link_forces.arm_points_i[index];
        let (arm, force) = (centre - kinematics.com, link_forces.forces_i[index]);
        let (mut moved, mut velocity, mut axis_turn) = (-j_g, -*moves, Vector3::zeros());
        let mut velocity_by_rate = -j_g;
        if kinematics.chain(link.frame.body).contains(&joint) {
            let lever = motion.joint_velocity_at(&centre);
            let own = kinematics.bodies[link.frame.body].velocity_at(&centre);
            moved += lever;
            velocity +=
                parent.angular_velocity.cross(&lever) + turn.cross(&(own - parent.velocity_at(&centre)));
            axis_turn = turn.cross(axis);
            velocity_by_rate += lever;
        }
        let change = derivatives.by_axis * axis_turn - derivatives.by_velocity * velocity;
        by_s += stack(&change, &(moved.cross(&force) + arm.cross(&change)));
        let change = -derivatives.by_velocity * velocity_by_rate;
        by_sigma += stack(&change, &arm.cross(&change));
    }
    (by_s, by_sigma)
}

fn add_rows(to: &mut Matrix6x3<f64>, upper: &Matrix3<f64>, lower: &Matrix3<f64>) {
    let mut rows = to.fixed_rows_mut::<3>(0);
    rows += upper;
    let mut rows = to.fixed_rows_mut::<3>(3);
    rows += lower;
}
