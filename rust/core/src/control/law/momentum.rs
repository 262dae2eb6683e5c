//! Effect of thrusts and joint motion on the centroidal momentum.
//!
//! ```text
//! L̇ = A_T T + Σ_j (f_j, r_j × f_j) − m g e₃                     estimated momentum rate
//! L̈ = A_T Ṫ + (Λ_T + Λ_a) ν                                     its derivative, controlled by the QP
//! on the ground also  A_c f_c*  and  A_c ḟ_c + Λ_c ν;  with an observer L̇ also  ŵ
//! ```
//!
//! with `r` the arm from the centre of mass. Source: paper, Methods, "Flight Control Design".
//!
//! Equations M50 to M52, M54 to M56 and M86 of `docs/model`.

use super::contact::WRENCH;
use crate::aero::LinkForces;
use crate::dynamics::Dynamics;
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use crate::spatial::{Pose, skew, stack};
use crate::subtree::SubtreeLoads;
use nalgebra::{DVector, Matrix6xX, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Where the estimated aerodynamic forces enter the controller; each place can be switched off for an ablation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AeroFeedback {
    /// Part of `A_a f_a` in the estimated momentum rate.
    pub momentum_rate: RateFeedback,
    /// Whether `Λ_a` enters the derivative of the momentum rate.
    pub lambda: bool,
    /// Whether `J_aᵀ f_a` enters the torque law.
    pub torque: bool,
}

impl Default for AeroFeedback {
    fn default() -> Self {
        Self { momentum_rate: RateFeedback::Wrench, lambda: true, torque: true }
    }
}

/// Part of the total aerodynamic wrench about the centre of mass in the estimated momentum rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RateFeedback {
    /// Force and moment.
    #[default]
    Wrench,
    /// The force only.
    Force,
    /// The moment only.
    Moment,
    /// Nothing.
    None,
}

/// Terms of the momentum rate and of its derivative; preallocated.
#[derive(Debug, Clone)]
pub struct MomentumModel {
    /// Unit thrust directions `a_i`, inertial axes.
    pub jet_axes_i: Vec<Vector3<f64>>,
    /// Thrust points \[m, inertial axes\].
    pub jet_points_i: Vec<Vector3<f64>>,
    /// `A_T = (a_i ; r_i × a_i)` (6 × jets).
    pub a_t: Matrix6xX<f64>,
    /// `A_c = (1 0 ; S(r_k) 1)` for each foot (6 × 6 feet); zero while the feet do not carry load.
    pub a_c: Matrix6xX<f64>,
    /// `Λ_T`: momentum acceleration per unit of ν due to rotation and translation of the thrusts (6 × n).
    pub lambda_t: Matrix6xX<f64>,
    /// `Λ_a`: the same for the aerodynamic forces, neglecting their own change (6 × n).
    pub lambda_a: Matrix6xX<f64>,
    /// `Λ = Λ_T + Λ_a` (6 × n).
    pub lambda: Matrix6xX<f64>,
    /// Estimated momentum rate `L̇` \[N, N m\].
    pub rate_estimate: Vector6<f64>,
    /// `L̇` with the wrenches that the feet measure, and without an observed one \[N, N m\].
    pub measured_rate: Vector6<f64>,
    /// Observed wrench `ŵ` that no model contains, part of the rate; zero without an observer \[N, N m\].
    pub unmodelled_wrench: Vector6<f64>,
    /// Thrusts, summed by subtrees.
    pub thrusts: SubtreeLoads,
    /// Aerodynamic forces at the points of their Jacobians, summed by subtrees.
    pub aero: SubtreeLoads,
}

impl MomentumModel {
    /// Allocates the terms of `robot`.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let n = 6 + robot.joints.len();
        let jets = vec![Vector3::zeros(); robot.jets.len()];
        Self {
            jet_axes_i: jets.clone(),
            jet_points_i: jets,
            a_t: Matrix6xX::zeros(robot.jets.len()),
            a_c: Matrix6xX::zeros(WRENCH * robot.feet.len()),
            lambda_t: Matrix6xX::zeros(n),
            lambda_a: Matrix6xX::zeros(n),
            lambda: Matrix6xX::zeros(n),
            rate_estimate: Vector6::zeros(),
            measured_rate: Vector6::zeros(),
            unmodelled_wrench: Vector6::zeros(),
            thrusts: SubtreeLoads::new(robot),
            aero: SubtreeLoads::new(robot),
        }
    }

    /// Recomputes all terms; `feedback` selects which of them contain the link forces.
    pub fn update(
        &mut self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        dynamics: &Dynamics,
        thrust: &[f64],
        link_forces: &LinkForces,
        feedback: &AeroFeedback,
    ) {
        self.a_c.fill(0.0);
        self.place_jets(robot, kinematics);
        self.update_lambda_t(robot, kinematics, dynamics, thrust);
        let forces = link_forces.jacobian_points_i.iter().zip(&link_forces.forces_i).zip(&robot.aero_links);
        let forces = forces.map(|((point, force), link)| (link.frame.body, *point, *force, Vector3::zeros()));
        self.aero.update(robot, kinematics, forces);
        if feedback.lambda {
            self.update_lambda_a(kinematics, dynamics);
        } else {
            self.lambda_a.fill(0.0);
        }
        self.lambda_t.add_to(&self.lambda_a, &mut self.lambda);

        self.rate_estimate = self.rate(robot, kinematics, thrust, link_forces, feedback.momentum_rate);
        self.measured_rate = self.rate_estimate;
        self.unmodelled_wrench.fill(0.0);
    }

    /// Momentum rate by thrusts, a part of the air, and weight \[N, N m\].
    #[must_use]
    pub fn rate(
        &self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        thrust: &[f64],
        link_forces: &LinkForces,
        air: RateFeedback,
    ) -> Vector6<f64> {
        let mut rate = Vector6::zeros();
        for (column, thrust) in self.a_t.column_iter().zip(thrust) {
            rate += column * *thrust;
        }
        let (force, moment) = link_forces.wrench_about(&kinematics.com);
        let none = Vector3::zeros();
        rate += match air {
            RateFeedback::Wrench => stack(&force, &moment),
            RateFeedback::Force => stack(&force, &none),
            RateFeedback::Moment => stack(&none, &moment),
            RateFeedback::None => stack(&none, &none),
        };
        rate[2] -= kinematics.mass() * robot.gravity;
        rate
    }

    /// Adds the observed wrench `ŵ` to the momentum rate.
    pub fn add_unmodelled(&mut self, wrench: Vector6<f64>) {
        self.unmodelled_wrench = wrench;
        self.rate_estimate += wrench;
    }

    /// Adds the feet that carry load: `A_c f_c*` to the momentum rate, `Λ_c` to its derivative.
    ///
    /// ```text
    /// Λ_c = (0 ; −Σ_k S(f_k) (J_k − J_G))
    /// ```
    pub fn add_contact(
        &mut self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        dynamics: &Dynamics,
        soles: &[Pose],
        force: &DVector<f64>,
    ) {
        for (foot, sole) in soles.iter().enumerate() {
            let mut a_c = self.a_c.columns_mut(WRENCH * foot, WRENCH);
            a_c.fill_with_identity();
            a_c.fixed_view_mut::<3, 3>(3, 0).copy_from(&skew(&(sole.position - kinematics.com)));
        }
        for (column, force) in self.a_c.column_iter().zip(force) {
            self.rate_estimate += column * *force;
        }
        let wrenches = force.as_slice().chunks_exact(WRENCH);
        let mut total = Vector3::zeros();
        for ((foot, sole), wrench) in robot.feet.iter().zip(soles).zip(wrenches) {
            let force = Vector3::from_column_slice(&wrench[..3]);
            total += force;
            let lambda = &mut self.lambda;
            kinematics.visit_jacobian_columns(foot.frame.body, &sole.position, |column, j_v, _| {
                let mut moment = lambda.fixed_view_mut::<3, 1>(3, column);
                moment -= force.cross(&j_v);
            });
        }
        add_com_motion(&mut self.lambda, dynamics, &(total / kinematics.mass()));
    }

    /// Recomputes axes and points of the jets, and `A_T`.
    pub(in crate::control) fn place_jets(&mut self, robot: &RobotModel, kinematics: &Kinematics) {
        for (index, jet) in robot.jets.iter().enumerate() {
            let pose = kinematics.frame_pose(&jet.frame);
            let axis = pose.rotation * jet.axis_f.into_inner();
            let arm = pose.position - kinematics.com;
            self.jet_axes_i[index] = axis;
            self.jet_points_i[index] = pose.position;
            self.a_t.set_column(index, &stack(&axis, &(arm.cross(&axis) + axis * jet.torque_to_thrust)));
        }
    }

    /// ```text
    /// Λ_T = −Σ_i T_i ( (0 ; S(a_i)) (J_i^v − J_G) + (I ; S(r_i) + κ_i I) S(a_i) J_i^ω )
    /// ```
    fn update_lambda_t(
        &mut self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        dynamics: &Dynamics,
        thrust: &[f64],
    ) {
        let Self { jet_axes_i, jet_points_i, thrusts, lambda_t, .. } = self;
        let forces = robot.jets.iter().zip(thrust).enumerate().map(|(index, (jet, thrust))| {
            let force = jet_axes_i[index] * *thrust;
            (jet.frame.body, jet_points_i[index], force, force * jet.torque_to_thrust)
        });
        thrusts.update(robot, kinematics, forces);
        let com = kinematics.com - kinematics.bodies[0].i_from_b.position;
        thrusts.visit(kinematics, |column, load, v_o, omega| {
            let turned = load.force.cross(&omega);
            let moment = load.force.cross(&v_o) + load.moment().cross(&omega) - com.cross(&turned);
            lambda_t.set_column(column, &-stack(&turned, &moment));
        });
        add_com_motion(lambda_t, dynamics, &(thrusts.total().force / kinematics.mass()));
    }

    /// ```text
    /// Λ_a = (0 ; −Σ_j S(f_j) (J_j − J_G))
    /// ```
    fn update_lambda_a(&mut self, kinematics: &Kinematics, dynamics: &Dynamics) {
        let Self { aero, lambda_a, .. } = self;
        aero.visit(kinematics, |column, load, v_o, omega| {
            let moment = load.force.cross(&v_o) + omega * load.dyad.trace() - load.dyad * omega;
            lambda_a.set_column(column, &-stack(&Vector3::zeros(), &moment));
        });
        add_com_motion(lambda_a, dynamics, &(aero.total().force / kinematics.mass()));
    }
}

/// Adds the part `+ Σ S(f) J_G` common to all forces: their arms change as the centre of mass moves.
fn add_com_motion(lambda: &mut Matrix6xX<f64>, dynamics: &Dynamics, force_per_mass: &Vector3<f64>) {
    for (mut lambda, momentum) in lambda.column_iter_mut().zip(dynamics.momentum_matrix.column_iter()) {
        let mut moment = lambda.fixed_rows_mut::<3>(3);
        moment += force_per_mass.cross(&momentum.fixed_rows::<3>(0));
    }
}
