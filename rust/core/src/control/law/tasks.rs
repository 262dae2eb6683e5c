//! The controller's own tasks of the momentum QP.
//!
//! ```text
//! linear momentum    A_T Ṫ + A_c ḟ_c + (Λ_s + K A_s) ṡ + (Λ_b + K A_b) ν_B
//!                       − K L_d − L̈_d + (K_D + 1)(L̇ − L̇_d) + K_P I_L = 0       three rows, inertial axes
//! attitude           Rᵀ (A_T Ṫ + A_c ḟ_c + Λ_s ṡ + Λ_b ν_B − σ) − k̈* = 0       three rows, base axes
//! angular momentum   Rᵀ A_s,ang ṡ + (I_b − I₀) w = 0                              so that k = I₀ w
//! feet               J_c,s ṡ + J_c,b ν_B = 0                                      feet that carry load rest
//! symmetric jets     Ṫ_a − Ṫ_b = 0                                                for each pair
//! posture            ṡ + K_s (s − s_d) = 0
//! rates              Ṫ + κ_T T = 0,   ḟ_c + κ_f f_c* = 0                          κ > 0 for the unloaded side
//! and minimisation of ṡ and of all unknowns
//! ```
//!
//! with `K = K_P + K_D + K_O⁻¹`. The linear task is `e⃛ + 8.75 ë + 22.8 ė + 15 e = 0` in the position
//! error at the published gains. Equations M57, M58, M61 to M64, M73 and M111 of `docs/model`.

use super::contact::ContactConfig;
use super::momentum_qp::{Equations, Layout, Task, TaskInputs, Unknowns};
use crate::error::{BuildError, place_of};
use crate::robot::RobotModel;
use crate::schema::NonNegative;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// Rows of the momentum (3), attitude (3) and angular-momentum (3) tasks, which precede all others.
pub const MOMENTUM_ROWS: usize = 9;

/// Added to the diagonal of the Hessian, as published.
const REGULARISATION: f64 = 1e-4;

/// Weight of `J_c ν = 0`, as published on the ground.
const WEIGHT_FOOT_VELOCITY: f64 = 150.0;

/// Weights of the tasks in the momentum QP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MomentumWeights {
    /// Momentum and attitude tasks.
    #[schemars(range(min = 0))]
    pub momentum: f64,
    /// Angular-momentum constraint task.
    #[schemars(range(min = 0))]
    pub angular_momentum: f64,
    /// Posture task.
    #[schemars(range(min = 0))]
    pub posture: f64,
    /// Minimisation of joint velocities.
    #[schemars(range(min = 0))]
    pub joint_velocity: f64,
    /// Minimisation of thrust rates, by jet.
    #[schemars(with = "BTreeMap<String, NonNegative>")]
    pub thrust_rate: BTreeMap<String, f64>,
    /// Equal thrust rates within each pair of [`Self::symmetric_jets`].
    #[schemars(range(min = 0))]
    pub symmetry: f64,
    /// Pairs of jets with equal thrust rates.
    pub symmetric_jets: Vec<[String; 2]>,
}

impl MomentumWeights {
    /// Jet indices of the pairs of [`Self::symmetric_jets`].
    ///
    /// # Errors
    /// [`BuildError::UnknownName`] for a jet the robot does not have.
    pub fn symmetric_pairs(&self, robot: &RobotModel) -> Result<Vec<(usize, usize)>, BuildError> {
        let place = |jet: &str| place_of("controller.weights.symmetric_jets", jet, robot.jet_names());
        self.symmetric_jets.iter().map(|[a, b]| Ok((place(a)?, place(b)?))).collect()
    }
}

/// The tasks of a controller with these weights, and these posture gains \[1/s\] of the joints.
///
/// # Errors
/// [`BuildError`] for names the robot does not have.
pub fn standard_tasks(
    weights: &MomentumWeights,
    posture_gain: Vec<f64>,
    contact: Option<&ContactConfig>,
    robot: &RobotModel,
    unknowns: &Unknowns,
) -> Result<Vec<Arc<dyn Task>>, BuildError> {
    let Unknowns { thrust_rate, force_rate, joint_velocity } = unknowns;
    let transfer = contact.and_then(|contact| contact.load_transfer.as_ref());
    let transfer_gain = transfer.map_or(0.0, |transfer| transfer.gain);
    let mut tasks: Vec<Arc<dyn Task>> = vec![
        Arc::new(LinearMomentum { weight: weights.momentum }),
        Arc::new(Attitude { weight: weights.momentum }),
        Arc::new(AngularMomentum { weight: weights.angular_momentum }),
        Arc::new(Posture { joints: joint_velocity.clone(), weight: weights.posture, gain: posture_gain }),
    ];
    if !thrust_rate.is_empty() {
        let pairs = weights.symmetric_pairs(robot)?;
        tasks.push(Arc::new(SymmetricJets { pairs, weight: weights.symmetry }));
        tasks.push(Arc::new(LoadRate {
            side: Side::Jets,
            first: thrust_rate.start,
            weights: robot.by_jet(&weights.thrust_rate),
            gain: transfer_gain,
        }));
    }
    if let Some(contact) = contact {
        tasks.push(Arc::new(Feet { rows: force_rate.len(), weight: WEIGHT_FOOT_VELOCITY }));
        tasks.push(Arc::new(LoadRate {
            side: Side::Feet,
            first: force_rate.start,
            weights: vec![contact.weight_force_rate; force_rate.len()],
            gain: transfer_gain,
        }));
    }
    tasks.push(keep_small("joint velocity", joint_velocity, weights.joint_velocity));
    tasks.push(keep_small("regularisation", &(0..unknowns.len()), REGULARISATION));
    Ok(tasks)
}

fn keep_small(name: &'static str, unknowns: &Range<usize>, weight: f64) -> Arc<dyn Task> {
    Arc::new(TowardsZero { name, first: unknowns.start, weights: vec![weight; unknowns.len()] })
}

/// Linear momentum follows the set-point (M57).
#[derive(Debug, Clone)]
struct LinearMomentum {
    weight: f64,
}

impl Task for LinearMomentum {
    fn name(&self) -> &'static str {
        "linear momentum"
    }

    fn layout(&self) -> Layout {
        Layout::Rows(vec![self.weight; 3])
    }

    fn update(&self, inputs: &TaskInputs, equations: &mut Equations) {
        let TaskInputs { kinematics, dynamics, momentum, setpoint, gains, .. } = inputs;
        let Equations { matrix, offset, unknowns } = equations;
        let mass = kinematics.mass();
        for axis in 0..3 {
            let (kp, kd) = (gains.kp_linear[axis], gains.kd_linear[axis]);
            let k = kp + 1.0 / gains.ko + kd;
            let motion = |column: usize| {
                momentum.lambda[(axis, column)] + k * dynamics.momentum_matrix[(axis, column)]
            };
            let mut row = matrix.column_mut(axis);
            for (unknown, force) in momentum.a_t.row(axis).iter().chain(&momentum.a_c.row(axis)).enumerate() {
                row[unknown] = *force;
            }
            for (joint, unknown) in unknowns.joint_velocity.clone().enumerate() {
                row[unknown] = motion(6 + joint);
            }
            let base_motion: f64 = (0..6).map(|column| motion(column) * inputs.state.velocity[column]).sum();
            let desired = k * mass * setpoint.com_velocity[axis] + mass * setpoint.com_jerk[axis];
            let rate_error = momentum.rate_estimate[axis] - mass * setpoint.com_acceleration[axis];
            let integral = mass * (kinematics.com[axis] - setpoint.com_position[axis]);
            offset[axis] = base_motion - desired + (kd + 1.0) * rate_error + kp * integral;
        }
    }
}

/// Angular momentum follows the attitude law (M61).
#[derive(Debug, Clone)]
struct Attitude {
    weight: f64,
}

impl Task for Attitude {
    fn name(&self) -> &'static str {
        "attitude"
    }

    fn layout(&self) -> Layout {
        Layout::Rows(vec![self.weight; 3])
    }

    fn update(&self, inputs: &TaskInputs, equations: &mut Equations) {
        let TaskInputs { state, momentum, attitude, .. } = inputs;
        let Equations { matrix, offset, .. } = equations;
        let b_from_i = state.base.rotation.transpose();
        let forces = momentum.a_t.column_iter().chain(momentum.a_c.column_iter());
        let joints = momentum.lambda.column_iter().skip(6);
        for (unknown, column) in forces.chain(joints).enumerate() {
            let turned = b_from_i * column.fixed_rows::<3>(3);
            matrix.fixed_view_mut::<1, 3>(unknown, 0).tr_copy_from(&turned);
        }
        let base_motion: Vector3<f64> =
            momentum.lambda.fixed_view::<3, 6>(3, 0) * state.velocity.fixed_rows::<6>(0);
        let demand = b_from_i * (base_motion - attitude.sigma_i) - attitude.k_ddot_desired_b;
        offset.copy_from(&demand);
    }
}

/// The angular momentum of the limbs compensates the change of inertia, so that `k = I₀ w` (M62).
#[derive(Debug, Clone)]
struct AngularMomentum {
    weight: f64,
}

impl Task for AngularMomentum {
    fn name(&self) -> &'static str {
        "angular momentum"
    }

    fn layout(&self) -> Layout {
        Layout::Rows(vec![self.weight; 3])
    }

    fn update(&self, inputs: &TaskInputs, equations: &mut Equations) {
        let TaskInputs { state, dynamics, inertia_0_b, .. } = inputs;
        let Equations { matrix, offset, unknowns } = equations;
        let b_from_i = state.base.rotation.transpose();
        let joints = dynamics.momentum_matrix.column_iter().skip(6);
        for (unknown, column) in unknowns.joint_velocity.clone().zip(joints) {
            let turned = b_from_i * column.fixed_rows::<3>(3);
            matrix.fixed_view_mut::<1, 3>(unknown, 0).tr_copy_from(&turned);
        }
        let inertia_b = b_from_i * dynamics.centroidal_inertia * b_from_i.transpose();
        let w = b_from_i * state.base_angular_velocity();
        offset.copy_from(&((inertia_b - *inertia_0_b) * w));
    }
}

/// Feet that carry load rest (M73). Without load their Jacobian is zero, and so is the task.
#[derive(Debug, Clone)]
struct Feet {
    rows: usize,
    weight: f64,
}

impl Task for Feet {
    fn name(&self) -> &'static str {
        "feet"
    }

    fn layout(&self) -> Layout {
        Layout::Rows(vec![self.weight; self.rows])
    }

    fn update(&self, inputs: &TaskInputs, equations: &mut Equations) {
        let Equations { matrix, offset, unknowns } = equations;
        let (jacobian, joints) = (&inputs.contact.jacobian_transposed, unknowns.joint_velocity.clone());
        matrix.rows_mut(joints.start, joints.len()).copy_from(&jacobian.rows(6, joints.len()));
        offset.gemv_tr(1.0, &jacobian.rows(0, 6), &inputs.state.velocity.rows(0, 6), 0.0);
    }
}

/// Jets of a pair have equal thrust rates.
#[derive(Debug, Clone)]
struct SymmetricJets {
    pairs: Vec<(usize, usize)>,
    weight: f64,
}

impl Task for SymmetricJets {
    fn name(&self) -> &'static str {
        "symmetric jets"
    }

    fn layout(&self) -> Layout {
        Layout::Rows(vec![self.weight; self.pairs.len()])
    }

    fn update(&self, _: &TaskInputs, equations: &mut Equations) {
        for (row, &(a, b)) in self.pairs.iter().enumerate() {
            (equations.matrix[(a, row)], equations.matrix[(b, row)]) = (1.0, -1.0);
        }
    }
}

/// Joints return to the reference posture (M63).
#[derive(Debug, Clone)]
struct Posture {
    joints: Range<usize>,
    weight: f64,
    /// `K_s` \[1/s\].
    gain: Vec<f64>,
}

impl Task for Posture {
    fn name(&self) -> &'static str {
        "posture"
    }

    fn layout(&self) -> Layout {
        Layout::Diagonal { first: self.joints.start, weights: vec![self.weight; self.joints.len()] }
    }

    fn update(&self, inputs: &TaskInputs, equations: &mut Equations) {
        let positions = inputs.state.joint_position.iter().zip(inputs.posture);
        for ((offset, gain), (s, s_d)) in equations.offset.iter_mut().zip(&self.gain).zip(positions) {
            *offset = gain * (s - s_d);
        }
    }
}

/// Side that carries the robot's weight.
#[derive(Debug, Clone, Copy)]
enum Side {
    Jets,
    Feet,
}

/// Rates of thrusts or foot wrenches are small; those of the side that is being unloaded let its load decay to
/// zero (M111).
#[derive(Debug, Clone)]
struct LoadRate {
    side: Side,
    first: usize,
    weights: Vec<f64>,
    /// `κ` \[1/s\].
    gain: f64,
}

impl Task for LoadRate {
    fn name(&self) -> &'static str {
        match self.side {
            Side::Jets => "thrust rate",
            Side::Feet => "force rate",
        }
    }

    fn layout(&self) -> Layout {
        Layout::Diagonal { first: self.first, weights: self.weights.clone() }
    }

    fn update(&self, inputs: &TaskInputs, equations: &mut Equations) {
        let TaskInputs { contact, contact_state, thrust, .. } = inputs;
        let (load, is_relieved) = match self.side {
            Side::Jets => (*thrust, contact_state.is_active && !contact.takes_off),
            Side::Feet => (contact_state.force.as_slice(), contact_state.is_active && contact.takes_off),
        };
        let gain = if is_relieved { self.gain } else { 0.0 };
        for (offset, load) in equations.offset.iter_mut().zip(load) {
            *offset = gain * load;
        }
    }
}

/// Minimises some of the unknowns.
#[derive(Debug, Clone)]
struct TowardsZero {
    name: &'static str,
    first: usize,
    weights: Vec<f64>,
}

impl Task for TowardsZero {
    fn name(&self) -> &'static str {
        self.name
    }

    fn layout(&self) -> Layout {
        Layout::Diagonal { first: self.first, weights: self.weights.clone() }
    }

    fn update(&self, _: &TaskInputs, _: &mut Equations) {}
}
