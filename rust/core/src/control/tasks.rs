//! The momentum QP: tasks stacked into a cost, bounds around the unknowns.
//!
//! Unknowns `u = (Ṫ, ṡ)`, for a controller with `contact` `u = (Ṫ, ḟ_c, ṡ)`.
//! Cost `½ uᵀ H u + gᵀ u` of the weighted squares of
//!
//! ```text
//! momentum   A_T Ṫ + (Λ_s + K A_s) ṡ + (Λ_b + K A_b) ν_B
//!               − K L_d − L̈_d + (K_D + 1)(L̇ − L̇_d) + K_P I_L       three linear rows
//! attitude   Rᵀ (A_T Ṫ + Λ_s ṡ + Λ_b ν_B − σ) − k̈*                three angular rows
//! angular    Rᵀ A_s,ang ṡ + (I_b − I₀) w                              momentum the limbs may carry
//! posture    ṡ + K_s (s − s_d)
//! and of ṡ, Ṫ and the differences of paired thrust rates
//! ```
//!
//! Feet that carry add the columns `A_c ḟ_c` to the first two tasks, and the squares of
//!
//! ```text
//! feet       J_c,s ṡ + J_c,b ν_B                                      feet that carry stay
//! and of ḟ_c
//! ```
//!
//! with `K = K_P + K_D + K_O⁻¹`. The linear task is `e⃛ + 8.75 ë + 22.8 ė + 15 e = 0` in the position
//! error at the published gains. Equations M57, M58, M61 to M64 and M73 of `docs/model.md`.

use super::attitude::AttitudeDemand;
use super::bounds::rate_bounds;
use super::config::{ControllerConfig, MomentumGains};
use super::contact::{Contact, WRENCH};
use super::momentum::MomentumModel;
use super::setpoint::Setpoint;
use crate::dynamics::Dynamics;
use crate::error::BuildError;
use crate::kinematics::{Kinematics, RobotState};
use crate::qp::QpProblem;
use crate::robot::RobotModel;
use nalgebra::{DVector, Dyn, Matrix3, OMatrix, SVector, U9, Vector3};

/// Rows of the momentum (3), attitude (3) and angular-momentum (3) tasks.
pub const TASK_ROWS: usize = 9;

/// The momentum QP of one tick; preallocated.
#[derive(Debug, Clone)]
pub struct MomentumQp {
    /// Task matrix: nine rows, a column for every unknown.
    pub task: OMatrix<f64, U9, Dyn>,
    /// Task offset: the tasks ask `task · u + offset = 0`.
    pub offset: SVector<f64, TASK_ROWS>,
    /// The QP handed to the solver.
    pub problem: QpProblem,
    weighted_task: OMatrix<f64, U9, Dyn>,
    row_weights: SVector<f64, TASK_ROWS>,
    diagonal: DVector<f64>,
    symmetric_pairs: Vec<(usize, usize)>,
    symmetry_weight: f64,
    posture_weight: f64,
    posture_gain: DVector<f64>,
    thrust_rate_max: Vec<f64>,
    thrust_steepness: f64,
    joint_steepness: f64,
    /// Number of contact unknowns; they stand between thrust rates and joint velocities.
    forces: usize,
    force_rate_max: f64,
    foot_weight: f64,
}

/// What the tasks are built from.
pub struct TaskInputs<'a> {
    /// The measured state.
    pub state: &'a RobotState,
    /// The measured thrusts \[N\].
    pub thrust: &'a [f64],
    /// Its kinematics.
    pub kinematics: &'a Kinematics,
    /// Its dynamics.
    pub dynamics: &'a Dynamics,
    /// How forces change the momentum.
    pub momentum: &'a MomentumModel,
    /// What to follow.
    pub setpoint: &'a Setpoint,
    /// What the attitude law asks for.
    pub attitude: &'a AttitudeDemand,
    /// Centroidal inertia in body axes at the first tick \[kg m²\].
    pub inertia_0_b: &'a Matrix3<f64>,
    /// Desired posture `s_d` \[rad\].
    pub posture: &'a DVector<f64>,
    /// The feet of a robot that can stand.
    pub contact: Option<&'a Contact>,
}

impl MomentumQp {
    /// Space and weights for `robot`; `config` has been checked against it.
    ///
    /// # Errors
    /// [`BuildError`] for names the robot does not have.
    pub fn new(config: &ControllerConfig, robot: &RobotModel) -> Result<Self, BuildError> {
        let (jets, joints) = (robot.jets.len(), robot.joints.len());
        let forces = config.contact.as_ref().map_or(0, |_| WRENCH * robot.feet.len());
        let n = jets + forces + joints;
        let weights = &config.weights;
        let per_jet = |table: &std::collections::BTreeMap<String, f64>| -> Vec<f64> {
            robot.jets.iter().map(|jet| table.get(&jet.name).copied().unwrap_or(0.0)).collect()
        };
        let mut diagonal =
            DVector::from_element(n, weights.joint_velocity + weights.posture + weights.regularisation);
        for (index, weight) in per_jet(&weights.thrust_rate).into_iter().enumerate() {
            diagonal[index] = weight + weights.regularisation;
        }
        if let Some(contact) = &config.contact {
            diagonal.rows_mut(jets, forces).fill(contact.weight_force_rate + weights.regularisation);
        }
        let mut posture_gain = DVector::zeros(joints);
        for group in &robot.groups {
            for &joint in &group.joints {
                posture_gain[joint] = config.posture_gain.get(&group.name).copied().unwrap_or(0.0);
            }
        }
        let (m, a) = (weights.momentum, weights.angular_momentum);
        Ok(Self {
            task: OMatrix::<f64, U9, Dyn>::zeros(n),
            offset: SVector::zeros(),
            problem: QpProblem::new(n, 0),
            weighted_task: OMatrix::<f64, U9, Dyn>::zeros(n),
            row_weights: SVector::from([m, m, m, m, m, m, a, a, a]),
            diagonal,
            symmetric_pairs: if robot.jets.is_empty() {
                Vec::new()
            } else {
                config.symmetric_pairs(robot)?
            },
            symmetry_weight: weights.symmetry,
            posture_weight: weights.posture,
            posture_gain,
            thrust_rate_max: per_jet(&config.bounds.thrust_rate_max),
            thrust_steepness: config.bounds.thrust_steepness,
            joint_steepness: config.bounds.joint_steepness,
            forces,
            force_rate_max: config.contact.as_ref().map_or(0.0, |contact| contact.force_rate_max),
            foot_weight: config.contact.as_ref().map_or(0.0, |contact| contact.weight_foot_velocity),
        })
    }

    /// Builds tasks, cost and bounds of one tick.
    pub fn update(&mut self, robot: &RobotModel, gains: &MomentumGains, inputs: &TaskInputs) {
        self.update_linear_task(gains, inputs);
        self.update_angular_tasks(inputs);
        if let Some(contact) = inputs.contact {
            self.update_contact_columns(inputs, contact);
        }
        self.update_cost(inputs);
        if let Some(contact) = inputs.contact.filter(|contact| contact.is_active) {
            self.add_feet(robot, inputs, contact);
        }
        self.update_bounds(robot, inputs.state, inputs.thrust);
    }

    /// Rows 0 to 2.
    fn update_linear_task(&mut self, gains: &MomentumGains, inputs: &TaskInputs) {
        let TaskInputs { kinematics, dynamics, momentum, setpoint, .. } = inputs;
        let jets = momentum.a_t.ncols();
        let first_joint = jets + self.forces;
        let mass = kinematics.mass();
        let base_velocity = inputs.state.velocity.fixed_rows::<6>(0);
        for axis in 0..3 {
            let (kp, kd) = (gains.kp_linear[axis], gains.kd_linear[axis]);
            let k = kp + 1.0 / gains.ko + kd;
            for jet in 0..jets {
                self.task[(axis, jet)] = momentum.a_t[(axis, jet)];
            }
            for column in 6..momentum.lambda.ncols() {
                self.task[(axis, first_joint + column - 6)] =
                    momentum.lambda[(axis, column)] + k * dynamics.momentum_matrix[(axis, column)];
            }
            let mut base_motion = 0.0;
            for column in 0..6 {
                base_motion += (momentum.lambda[(axis, column)]
                    + k * dynamics.momentum_matrix[(axis, column)])
                    * base_velocity[column];
            }
            let desired = k * mass * setpoint.com_velocity[axis] + mass * setpoint.com_jerk[axis];
            let rate_error = momentum.rate_estimate[axis] - mass * setpoint.com_acceleration[axis];
            let integral = mass * (kinematics.com[axis] - setpoint.com_position[axis]);
            self.offset[axis] = base_motion - desired + (kd + 1.0) * rate_error + kp * integral;
        }
    }

    /// Rows 3 to 8.
    fn update_angular_tasks(&mut self, inputs: &TaskInputs) {
        let TaskInputs { state, kinematics, dynamics, momentum, attitude, .. } = inputs;
        let jets = momentum.a_t.ncols();
        let b_from_i = kinematics.bodies[0].i_from_b.rotation.transpose();
        for jet in 0..jets {
            let column: Vector3<f64> = momentum.a_t.fixed_view::<3, 1>(3, jet).into();
            self.task.fixed_view_mut::<3, 1>(3, jet).copy_from(&(b_from_i * column));
        }
        for column in 6..momentum.lambda.ncols() {
            let lambda: Vector3<f64> = momentum.lambda.fixed_view::<3, 1>(3, column).into();
            let a_ang: Vector3<f64> = dynamics.momentum_matrix.fixed_view::<3, 1>(3, column).into();
            let unknown = jets + self.forces + column - 6;
            self.task.fixed_view_mut::<3, 1>(3, unknown).copy_from(&(b_from_i * lambda));
            self.task.fixed_view_mut::<3, 1>(6, unknown).copy_from(&(b_from_i * a_ang));
        }
        let base_motion: Vector3<f64> =
            momentum.lambda.fixed_view::<3, 6>(3, 0) * state.velocity.fixed_rows::<6>(0);
        let attitude_offset = b_from_i * (base_motion - attitude.sigma_i) - attitude.k_ddot_desired_b;
        let inertia_b = b_from_i * dynamics.centroidal_inertia * b_from_i.transpose();
        let w = b_from_i * state.base_angular_velocity();
        self.offset.fixed_rows_mut::<3>(3).copy_from(&attitude_offset);
        self.offset.fixed_rows_mut::<3>(6).copy_from(&((inertia_b - inputs.inertia_0_b) * w));
    }

    /// `A_c` in the momentum and attitude rows; zero while the feet do not carry.
    fn update_contact_columns(&mut self, inputs: &TaskInputs, contact: &Contact) {
        let jets = inputs.thrust.len();
        let mut columns = self.task.columns_mut(jets, self.forces);
        columns.fill(0.0);
        if !contact.is_active {
            return;
        }
        let b_from_i = inputs.kinematics.bodies[0].i_from_b.rotation.transpose();
        for (mut column, a_c) in columns.column_iter_mut().zip(contact.a_c.column_iter()) {
            let moment: Vector3<f64> = a_c.fixed_rows::<3>(3).into();
            column.fixed_rows_mut::<3>(0).copy_from(&a_c.fixed_rows::<3>(0));
            column.fixed_rows_mut::<3>(3).copy_from(&(b_from_i * moment));
        }
    }

    /// `w |J_c,s ṡ + J_c,b ν_B|²`, over the joints of each leg alone.
    fn add_feet(&mut self, robot: &RobotModel, inputs: &TaskInputs, contact: &Contact) {
        let QpProblem { h, g, .. } = &mut self.problem;
        let first_joint = inputs.thrust.len() + self.forces;
        let jacobian = &contact.jacobian_transposed;
        for (index, foot) in robot.feet.iter().enumerate() {
            let chain = inputs.kinematics.chain(foot.frame.body);
            for row in WRENCH * index..WRENCH * (index + 1) {
                let of_row = jacobian.column(row);
                let base: f64 = of_row.rows(0, 6).dot(&inputs.state.velocity.rows(0, 6));
                for &a in chain {
                    let weighted = self.foot_weight * of_row[6 + a];
                    g[first_joint + a] += weighted * base;
                    for &b in chain {
                        h[(first_joint + a, first_joint + b)] += weighted * of_row[6 + b];
                    }
                }
            }
        }
        // Each product was rounded in its own order; solvers take H to be exactly symmetric.
        for column in first_joint..h.ncols() {
            for row in first_joint..column {
                h[(column, row)] = h[(row, column)];
            }
        }
    }

    /// `H = Σ w Gᵀ G + diagonal`, `g = Σ w Gᵀ offset`.
    fn update_cost(&mut self, inputs: &TaskInputs) {
        let n = self.task.ncols();
        let first_joint = n - inputs.posture.len();
        let QpProblem { h, g, .. } = &mut self.problem;
        for column in 0..n {
            let weighted = self.task.column(column).component_mul(&self.row_weights);
            self.weighted_task.set_column(column, &weighted);
            g[column] = weighted.dot(&self.offset);
        }
        for column in 0..n {
            let right = self.task.column(column);
            for row in 0..=column {
                let entry = self.weighted_task.column(row).dot(&right);
                h[(row, column)] = entry;
                h[(column, row)] = entry;
            }
            h[(column, column)] += self.diagonal[column];
        }
        for &(a, b) in &self.symmetric_pairs {
            h[(a, a)] += self.symmetry_weight;
            h[(b, b)] += self.symmetry_weight;
            h[(a, b)] -= self.symmetry_weight;
            h[(b, a)] -= self.symmetry_weight;
        }
        for joint in 0..inputs.posture.len() {
            let error = inputs.state.joint_position[joint] - inputs.posture[joint];
            g[first_joint + joint] += self.posture_weight * self.posture_gain[joint] * error;
        }
    }

    fn update_bounds(&mut self, robot: &RobotModel, state: &RobotState, thrust: &[f64]) {
        let QpProblem { lower, upper, .. } = &mut self.problem;
        for (index, jet) in robot.jets.iter().enumerate() {
            let limits = (0.0, jet.thrust_max);
            (lower[index], upper[index]) =
                rate_bounds(thrust[index], limits, self.thrust_rate_max[index], self.thrust_steepness);
        }
        let jets = robot.jets.len();
        for unknown in jets..jets + self.forces {
            (lower[unknown], upper[unknown]) = (-self.force_rate_max, self.force_rate_max);
        }
        let first_joint = jets + self.forces;
        for (index, joint) in robot.joints.iter().enumerate() {
            (lower[first_joint + index], upper[first_joint + index]) = rate_bounds(
                state.joint_position[index],
                joint.limits,
                joint.velocity_max,
                self.joint_steepness,
            );
        }
    }
}
