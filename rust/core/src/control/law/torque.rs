//! The torque QP: joint torques, and foot wrenches under load, with which the joint accelerations follow the commanded
//! joint velocities while the feet rest.
//!
//! ```text
//! s̈* = −K_D (ṡ − ṡ*) − K_P ∫(ṡ − ṡ*)
//! u = (f_c, τ),   B = (J_cᵀ, S),   P = Bᵀ M⁻¹ B
//! (J_c ν̇ + J̇_c ν ; s̈)(u) = P u + c_free,      ν̇ = M⁻¹ (B u + Σ Jᵀ T a + J_aᵀ f_a − h − S F)
//! min ½ |W^½ (P u + c_free − c*)|² + ½ w_f |f_c − f_c*|² + ½ w_τ |τ|² + ½ ε |u|²,  c* = (0 ; s̈*)
//! subject to |τ| ≤ τ_max and, foot by foot, the rows of `WrenchLimits`
//! ```
//!
//! A rate limiter follows. One matrix gives both accelerations, because forces act on the same coordinates (feet,
//! joints) as are controlled. In flight `f_c` is empty. The base floats, so the joint block of `P` is `G`, the joint
//! block of the inverse mass matrix ([`InverseMass`]), not the inverse of the joint block. Equations M68 to M72, M75
//! and M76 of `docs/model` (the paper prints `τ = b̄ − M̄⁻¹ s̈**`, which contradicts its own `M̄ s̈ + b̄ = τ`; see
//! `docs/deviations.md`).

use super::contact::{Contact, ContactConfig, ContactState, WRENCH, WRENCH_ROWS};
use crate::control::limits::JointCondition;
use crate::dynamics::InverseMass;
use crate::linalg;
use crate::qp::QpProblem;
use crate::robot::RobotModel;
use crate::schema::NonNegative;
use crate::spatial::Pose;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

/// Weight of the torques, and what is added to the diagonal of the Hessian, as published.
const WEIGHT_TORQUE: f64 = 0.001;
const REGULARISATION: f64 = 1e-4;

/// Weight of `J_c ν̇ + J̇_c ν = 0`, as published on the ground.
const WEIGHT_FOOT_ACCELERATION: f64 = 100.0;

/// Weight of `f_c → f_c*`, as published there.
const WEIGHT_FORCE: f64 = 1.0;

/// The joint torque controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TorqueConfig {
    /// `K_Ds` on the joint velocity error \[1/s\].
    #[schemars(range(min = 0))]
    pub kd: f64,
    /// `K_Ps` on the integral of the joint velocity error \[1/s²\].
    #[schemars(range(min = 0))]
    pub kp: f64,
    /// Weight of the joint acceleration task.
    #[schemars(range(min = 0))]
    pub weight_acceleration: f64,
    /// Greatest torque of revolute joints \[N m\], in place of the robot's own limits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub torque_max: Option<f64>,
    /// Greatest torque rate of revolute joints \[N m/s\], in place of the robot's own limits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub torque_rate_max: Option<f64>,
    /// Rotor inertia of the drives of revolute joints, reflected to the joints, that the controller's mass matrix contains
    /// \[kg m²\].
    #[serde(default)]
    #[schemars(range(min = 0))]
    pub rotor_inertia: f64,
    /// Dry friction of the drives of revolute joints, by joint group, with which they oppose the commanded velocities
    /// \[N m\]; compensated while the feet carry no load.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<BTreeMap<String, NonNegative>>")]
    pub friction: Option<BTreeMap<String, f64>>,
    /// Ticks of the torques in a tick of the law.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 100))]
    pub steps: u32,
}

fn one() -> u32 {
    1
}

/// The torque QP of one tick; preallocated.
#[derive(Debug, Clone)]
pub struct TorqueQp {
    /// Columns of `f_c`.
    pub foot_force: Range<usize>,
    /// Columns of `τ`.
    pub joint_torque: Range<usize>,
    /// Desired joint accelerations `s̈*` \[rad/s²\].
    pub acceleration_desired: DVector<f64>,
    /// `c_free`: accelerations of feet and joints for `u = 0` \[m/s², rad/s²\].
    pub acceleration_free: DVector<f64>,
    /// The QP handed to the solver.
    pub problem: QpProblem,
    /// `K_D` \[1/s\] and `K_P` \[1/s²\].
    gains: (f64, f64),
    /// Greatest torques \[N m, N\].
    torque_max: Vec<f64>,
    weight_acceleration: f64,
    /// `K⁻¹ J_cᵀ`.
    feet: DMatrix<f64>,
    /// `P W^½`.
    weighted: DMatrix<f64>,
    roots: DVector<f64>,
    weighted_error: DVector<f64>,
    /// `w_f + ε` and `w_τ + ε`.
    diagonal: DVector<f64>,
    wrench_rows: Vec<[(Vector6<f64>, f64); WRENCH_ROWS]>,
}

impl TorqueQp {
    /// Allocates for `robot`.
    #[must_use]
    pub fn new(config: &TorqueConfig, contact: &ContactConfig, robot: &RobotModel) -> Self {
        let (joints, forces) = (robot.joints.len(), WRENCH * robot.feet.len());
        let n = forces + joints;
        let problem = QpProblem::new(n, WRENCH_ROWS * robot.feet.len());
        let per_block =
            |foot: f64, joint: f64| DVector::from_fn(n, |i, _| if i < forces { foot } else { joint });
        Self {
            foot_force: 0..forces,
            joint_torque: forces..n,
            acceleration_desired: DVector::zeros(joints),
            acceleration_free: DVector::zeros(n),
            problem,
            gains: (config.kd, config.kp),
            torque_max: robot.joints.iter().map(|joint| joint.torque_max).collect(),
            weight_acceleration: config.weight_acceleration,
            feet: DMatrix::zeros(6 + joints, forces),
            weighted: DMatrix::zeros(n, n),
            roots: per_block(WEIGHT_FOOT_ACCELERATION.sqrt(), config.weight_acceleration.sqrt()),
            weighted_error: DVector::zeros(n),
            diagonal: per_block(WEIGHT_FORCE, WEIGHT_TORQUE).add_scalar(REGULARISATION),
            wrench_rows: robot.feet.iter().map(|foot| contact.wrench.rows(foot)).collect(),
        }
    }

    /// Limits the torques to those that act in these conditions of the joints. The error of a joint's acceleration counts by
    /// this share: a weak joint would else move the others for what it cannot do itself, and a free one has no control.
    pub fn limit(&mut self, joints: &[JointCondition]) {
        let forces = self.foot_force.len();
        for (joint, (found, torque_max)) in joints.iter().zip(&self.torque_max).enumerate() {
            let most = found.effectiveness() * torque_max;
            (self.problem.lower[forces + joint], self.problem.upper[forces + joint]) = (-most, most);
            self.roots[forces + joint] = found.effectiveness() * self.weight_acceleration.sqrt();
        }
    }

    /// Torque to be commanded where `torques` are to act: more at a weak joint. For a free one, the torque with which it
    /// would follow its command if it acted, so that the joint is in use again as soon as it does.
    #[must_use]
    pub fn commanded(
        &self,
        joint: usize,
        found: JointCondition,
        torques: &[f64],
        inverse_mass: &InverseMass,
    ) -> f64 {
        if found != JointCondition::Free {
            return torques[joint] / found.effectiveness();
        }
        let gain = inverse_mass.joint_gain.column(joint);
        let others: f64 = gain.iter().zip(torques).map(|(gain, torque)| gain * torque).sum();
        let missing =
            self.acceleration_desired[joint] - self.acceleration_free[self.foot_force.len() + joint] - others;
        (missing / gain[joint]).clamp(-self.torque_max[joint], self.torque_max[joint])
    }

    /// Builds the QP. `free` are the accelerations of base and joints without `u`, `M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a − h − S F)`.
    pub fn update(
        &mut self,
        contact: &Contact,
        contact_state: &ContactState,
        inverse_mass: &InverseMass,
        free: &DVector<f64>,
        velocity_error: &DVector<f64>,
        velocity_error_integral: &DVector<f64>,
    ) {
        let (forces, joints) = (self.foot_force.len(), self.joint_torque.len());
        let (mut free_feet, mut free_joints) =
            self.acceleration_free.rows_range_pair_mut(0..forces, forces..);
        free_feet.copy_from(&contact.velocity_product);
        free_feet.gemv_tr(1.0, &contact.jacobian_transposed, free, 1.0);
        free_joints.copy_from(&free.rows(6, joints));

        self.update_gain(contact, contact_state.is_active, inverse_mass);
        self.update_hessian();
        self.update_limits(&contact.soles, contact_state.is_active);
        self.update_error(contact_state, velocity_error, velocity_error_integral);
    }

    /// Updates what depends on the joint velocities only; all else is that of the last [`Self::update`].
    pub fn update_error(
        &mut self,
        contact_state: &ContactState,
        velocity_error: &DVector<f64>,
        velocity_error_integral: &DVector<f64>,
    ) {
        let (kd, kp) = self.gains;
        self.acceleration_desired.copy_from(velocity_error);
        self.acceleration_desired.axpy(-kp, velocity_error_integral, -kd);
        self.weighted_error.copy_from(&self.acceleration_free);
        let mut of_joints = self.weighted_error.rows_range_mut(self.foot_force.end..);
        of_joints -= &self.acceleration_desired;
        self.weighted_error.component_mul_assign(&self.roots);
        self.update_gradient(&contact_state.force);
    }

    /// `P W^½`, with `(M⁻¹ J_cᵀ)_s = K_s⁻ᵀ (K⁻¹ J_cᵀ)_s`, which is zero for feet without load.
    fn update_gain(&mut self, contact: &Contact, carries: bool, inverse_mass: &InverseMass) {
        let (forces, joints) = (self.foot_force.len(), self.joint_torque.len());
        for (joint, column) in inverse_mass.joint_gain.column_iter().enumerate() {
            let root = self.roots[forces + joint];
            let mut to = self.weighted.column_mut(forces + joint);
            to.rows_mut(forces, joints).zip_apply(&column, |to, from| *to = root * from);
        }
        if !carries {
            self.weighted.rows_mut(0, forces).fill(0.0);
            self.weighted.columns_mut(0, forces).fill(0.0);
            return;
        }
        self.feet.copy_from(&contact.jacobian_transposed);
        let (n, factor) = (6 + joints, inverse_mass.factor.factor.as_slice());
        linalg::solve_lower_in_place(factor, n, n, self.feet.as_mut_slice());
        for row in 0..forces {
            let of_row = self.feet.column(row);
            for other in 0..forces {
                self.weighted[(other, row)] = self.roots[row] * self.feet.column(other).dot(&of_row);
            }
            let mut of_joints = self.weighted.view_mut((forces, row), (joints, 1));
            of_joints.gemm(1.0, &inverse_mass.joint_factor, &of_row.rows(6, joints), 0.0);
            for joint in self.joint_torque.clone() {
                let gain = self.weighted[(joint, row)];
                self.weighted[(row, joint)] = self.roots[joint] * gain;
                self.weighted[(joint, row)] = self.roots[row] * gain;
            }
        }
    }

    /// `H = P W P + diagonal`
    fn update_hessian(&mut self) {
        let h = &mut self.problem.h;
        linalg::times_transpose(self.weighted.as_slice(), self.diagonal.len(), h.as_mut_slice());
        for (i, weight) in self.diagonal.iter().enumerate() {
            h[(i, i)] += weight;
        }
    }

    /// `g = P W (c_free − c*) − w_f f_c*`
    fn update_gradient(&mut self, force_desired: &DVector<f64>) {
        let g = &mut self.problem.g;
        let n = g.len();
        g.fill(0.0);
        linalg::add_mat_vec(g.as_mut_slice(), self.weighted.as_slice(), n, self.weighted_error.as_slice());
        for (g, wanted) in g.iter_mut().zip(force_desired) {
            *g -= WEIGHT_FORCE * wanted;
        }
    }

    /// Transforms the rows from sole axes to inertial axes: `c · (Rᵀ f, Rᵀ m) = (R c_f, R c_m) · (f, m)`. They limit
    /// only feet under load; other wrenches are fixed at zero, and the problem has box constraints only.
    fn update_limits(&mut self, soles: &[Pose], carries: bool) {
        let QpProblem { normals, limit, lower, upper, .. } = &mut self.problem;
        let bound = if carries { f64::INFINITY } else { 0.0 };
        lower.rows_range_mut(self.foot_force.clone()).fill(-bound);
        upper.rows_range_mut(self.foot_force.clone()).fill(bound);
        if !carries {
            limit.fill(f64::INFINITY);
            return;
        }
        for (foot, (sole, rows)) in soles.iter().zip(&self.wrench_rows).enumerate() {
            for (index, (row, bound)) in rows.iter().enumerate() {
                let column = WRENCH_ROWS * foot + index;
                let force: Vector3<f64> = sole.rotation * row.fixed_rows::<3>(0);
                let moment: Vector3<f64> = sole.rotation * row.fixed_rows::<3>(3);
                normals.fixed_view_mut::<3, 1>(WRENCH * foot, column).copy_from(&force);
                normals.fixed_view_mut::<3, 1>(WRENCH * foot + 3, column).copy_from(&moment);
                limit[column] = *bound;
            }
        }
    }
}

/// Moves every torque towards its target by at most `rate_max · time_step`.
pub fn limit_rate(
    torque: &mut DVector<f64>,
    target: &[f64],
    rate_max: impl IntoIterator<Item = f64>,
    time_step: f64,
) {
    for ((torque, target), rate_max) in torque.iter_mut().zip(target).zip(rate_max) {
        let step = rate_max * time_step;
        *torque += (target - *torque).clamp(-step, step);
    }
}
