//! The torque QP of a standing robot: torques and foot wrenches together.
//!
//! ```text
//! u = (f_c, τ),   B = (J_cᵀ, S),   Y = K⁻¹ B with M = K Kᵀ,   P = Yᵀ Y = Bᵀ M⁻¹ B
//! (J_c ν̇ + J̇_c ν ; s̈)(u) = P u + c_free,      ν̇ = M⁻¹ (B u + Σ Jᵀ T a + J_aᵀ f_a − h)
//! min ½ |W^½ (P u + c_free − c*)|² + ½ w_f |f_c − f_c*|² + ½ w_τ |τ|² + ½ ε |u|²,  c* = (0 ; s̈*)
//! subject to |τ| ≤ τ_max and, foot by foot, the rows of `WrenchLimits`
//! ```
//!
//! One Gram matrix gives both accelerations, because what is measured (feet, joints) is what is pushed.
//! Equations M75 and M76 of `docs/model.md`.

use super::config::TorqueConfig;
use super::contact::{Contact, ContactConfig, WRENCH, WRENCH_ROWS};
use crate::dynamics::MassFactor;
use crate::linalg;
use crate::qp::QpProblem;
use crate::robot::RobotModel;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};

/// The torque QP of one tick with feet that carry; preallocated.
#[derive(Debug, Clone)]
pub struct StandingQp {
    /// The QP handed to the solver; unknowns `(f_c, τ)`.
    pub problem: QpProblem,
    /// `P = Bᵀ M⁻¹ B`.
    gain: DMatrix<f64>,
    /// Accelerations of feet and joints without `u`, less those wanted.
    free_error: DVector<f64>,
    /// Desired joint accelerations `s̈*` \[rad/s²\].
    acceleration_desired: DVector<f64>,
    /// `Y`, columns of n.
    factored: DMatrix<f64>,
    joint_inverse: DMatrix<f64>,
    /// `W^½ P`.
    weighted: DMatrix<f64>,
    roots: DVector<f64>,
    weighted_error: DVector<f64>,
    rows_sole: Vec<[(Vector6<f64>, f64); WRENCH_ROWS]>,
}

impl StandingQp {
    /// Space for a robot that stands on all its feet.
    #[must_use]
    pub fn new(torque: &TorqueConfig, contact: &ContactConfig, robot: &RobotModel) -> Self {
        let (feet, joints) = (robot.feet.len(), robot.joints.len());
        let (forces, n) = (WRENCH * feet, WRENCH * feet + joints);
        let mut problem = QpProblem::new(n, WRENCH_ROWS * feet);
        let QpProblem { lower, upper, .. } = &mut problem;
        for (index, joint) in robot.joints.iter().enumerate() {
            (lower[forces + index], upper[forces + index]) = (-joint.torque_max, joint.torque_max);
        }
        let mut roots = DVector::from_element(n, torque.weight_acceleration.sqrt());
        roots.rows_mut(0, forces).fill(contact.weight_foot_acceleration.sqrt());
        Self {
            problem,
            gain: DMatrix::zeros(n, n),
            free_error: DVector::zeros(n),
            acceleration_desired: DVector::zeros(joints),
            factored: DMatrix::zeros(6 + joints, n),
            joint_inverse: DMatrix::zeros(joints, joints),
            weighted: DMatrix::zeros(n, n),
            roots,
            weighted_error: DVector::zeros(n),
            rows_sole: robot.feet.iter().map(|foot| contact.wrench.rows(foot)).collect(),
        }
    }

    /// Builds the QP. `force` holds `Σ Jᵀ T a + J_aᵀ f_a − h` and is overwritten with the accelerations
    /// that it gives alone.
    pub fn update(
        &mut self,
        torque: &TorqueConfig,
        contact: &Contact,
        mass_factor: &MassFactor,
        force: &mut DVector<f64>,
        velocity_error: &DVector<f64>,
        velocity_error_integral: &DVector<f64>,
    ) {
        let forces = contact.force.len();
        let joints = velocity_error.len();
        self.acceleration_desired.copy_from(velocity_error);
        self.acceleration_desired.axpy(-torque.kp, velocity_error_integral, -torque.kd);
        self.update_gain(contact, mass_factor, joints);

        mass_factor.solve_in_place(force);
        let (n, feet) = (6 + joints, contact.jacobian_transposed.as_slice());
        for row in 0..forces {
            let acceleration = linalg::dot(&feet[row * n..][..n], force.as_slice());
            self.free_error[row] = acceleration + contact.velocity_product[row];
        }
        for joint in 0..joints {
            self.free_error[forces + joint] = force[6 + joint] - self.acceleration_desired[joint];
        }
        self.update_cost(torque, contact, forces, joints);
        self.update_rows(contact);
    }

    fn update_gain(&mut self, contact: &Contact, mass_factor: &MassFactor, joints: usize) {
        let n = 6 + joints;
        let forces = contact.force.len();
        let (of_feet, of_joints) = self.factored.as_mut_slice().split_at_mut(forces * n);
        of_feet.copy_from_slice(contact.jacobian_transposed.as_slice());
        linalg::solve_lower_in_place(mass_factor.factor.as_slice(), n, n, of_feet);
        // K⁻¹ S: the base comes first, so only the joint block of K is inverted.
        linalg::invert_lower(mass_factor.joint_block(), joints, n, self.joint_inverse.as_mut_slice());
        let inverse = self.joint_inverse.as_slice().chunks_exact(joints.max(1));
        for (to, from) in of_joints.chunks_exact_mut(n).zip(inverse) {
            to[..6].fill(0.0);
            to[6..].copy_from_slice(from);
        }
        linalg::gram(self.factored.as_slice(), n, self.gain.as_mut_slice());
    }

    fn update_cost(&mut self, torque: &TorqueConfig, contact: &Contact, forces: usize, joints: usize) {
        let n = forces + joints;
        for column in 0..n {
            for row in 0..n {
                self.weighted[(row, column)] = self.roots[row] * self.gain[(row, column)];
            }
        }
        for row in 0..n {
            self.weighted_error[row] = self.roots[row] * self.free_error[row];
        }
        let problem = &mut self.problem;
        linalg::gram(self.weighted.as_slice(), n, problem.h.as_mut_slice());
        let weight_force = contact.config().weight_force;
        for i in 0..n {
            let own = if i < forces { weight_force } else { torque.weight_torque };
            problem.h[(i, i)] += own + torque.regularisation;
            problem.g[i] =
                linalg::dot(&self.weighted.as_slice()[i * n..][..n], self.weighted_error.as_slice());
        }
        for (g, wanted) in problem.g.iter_mut().zip(&contact.force) {
            *g -= weight_force * wanted;
        }
    }

    /// Rows in sole axes, turned into inertial ones: `c · (Rᵀ f, Rᵀ m) = (R c_f, R c_m) · (f, m)`.
    fn update_rows(&mut self, contact: &Contact) {
        for (foot, (sole, rows)) in contact.soles.iter().zip(&self.rows_sole).enumerate() {
            for (index, (row, bound)) in rows.iter().enumerate() {
                let column = WRENCH_ROWS * foot + index;
                let force: Vector3<f64> = sole.rotation * row.fixed_rows::<3>(0);
                let moment: Vector3<f64> = sole.rotation * row.fixed_rows::<3>(3);
                let normals = &mut self.problem.normals;
                normals.fixed_view_mut::<3, 1>(WRENCH * foot, column).copy_from(&force);
                normals.fixed_view_mut::<3, 1>(WRENCH * foot + 3, column).copy_from(&moment);
                self.problem.limit[column] = *bound;
            }
        }
    }
}
