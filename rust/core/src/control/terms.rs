//! Intermediate values of a tick, in the order in which they are computed.

use super::detect::detector::Findings;
use super::engine_condition::EngineFinding;
use super::law::attitude::AttitudeDemand;
use super::law::contact::Contact;
use super::law::momentum::{AeroFeedback, MomentumModel};
use super::law::momentum_qp::MomentumQp;
use super::law::setpoint::Setpoint;
use super::law::torque::TorqueQp;
use super::limits::Limits;
use super::measure::measurement::{Estimate, Measurement};
use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::dynamics::{Dynamics, InverseMass};
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use nalgebra::{DVector, Matrix3, Vector3};

/// All intermediate values of the last tick.
#[derive(Debug, Clone)]
pub struct Terms {
    /// Set-point that is followed.
    pub setpoint: Setpoint,
    /// Set-point of when the command acts, as is the state; without a latency it is `setpoint` (M151).
    pub due: Setpoint,
    /// Poses, velocities, centre of mass.
    pub kinematics: Kinematics,
    /// Mass matrix, bias, centroidal momentum.
    pub dynamics: Dynamics,
    /// Inverse mass matrix.
    pub inverse_mass: InverseMass,
    /// Estimated aerodynamic forces.
    pub link_forces: LinkForces,
    /// `A_T`, `Λ`, `L̇`.
    pub momentum: MomentumModel,
    /// Acceleration without torques and foot wrenches, `M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a − h)`.
    pub free_acceleration: DVector<f64>,
    /// Contact quantities; empty for a controller that only flies.
    pub contact: Contact,
    /// Gains and limits of the law in this tick.
    pub limits: Limits,
    /// Demand of the attitude law.
    pub attitude: AttitudeDemand,
    /// Tasks and the momentum QP.
    pub momentum_qp: MomentumQp,
    /// What is to be added to the answer of the law, thrust rates first; zero without a residual \[N/s, rad/s\].
    pub residual: DVector<f64>,
    /// The torque QP.
    pub torque_qp: TorqueQp,
    /// Torques before the rate limiter \[N m\].
    pub unlimited_torque: DVector<f64>,
    /// What detectors find, beside the limits.
    pub findings: Findings,
}

/// A tick as it is known: what a plan begins with.
#[derive(Debug, Clone, Copy)]
pub struct Present<'a> {
    /// The robot as it is known.
    pub estimate: &'a Estimate,
    /// What follows from it in this tick.
    pub terms: &'a Terms,
}

impl Terms {
    /// Allocates the terms of `robot`.
    pub(super) fn new(
        robot: &RobotModel,
        jets: usize,
        limits: Limits,
        contact: Contact,
        momentum_qp: MomentumQp,
        torque_qp: TorqueQp,
    ) -> Self {
        let (joints, zero) = (robot.joints.len(), Vector3::zeros());
        Self {
            setpoint: Setpoint::at_rest(zero, Matrix3::identity()),
            due: Setpoint::at_rest(zero, Matrix3::identity()),
            kinematics: Kinematics::new(robot),
            dynamics: Dynamics::new(robot),
            inverse_mass: InverseMass::new(joints),
            link_forces: LinkForces::new(robot),
            momentum: MomentumModel::new(robot),
            free_acceleration: DVector::zeros(6 + joints),
            contact,
            limits,
            attitude: AttitudeDemand { k_ddot_desired_b: zero, sigma_i: zero },
            momentum_qp,
            residual: DVector::zeros(jets + joints),
            torque_qp,
            unlimited_torque: DVector::zeros(joints),
            findings: Findings { engines: vec![EngineFinding::Nothing; jets], ..Findings::default() },
        }
    }

    /// Computes all quantities that depend on the estimate of the robot only.
    pub(super) fn update_model(
        &mut self,
        robot: &RobotModel,
        aero: &mut AeroModel,
        conventions: LinkConventions,
        feedback: AeroFeedback,
        estimate: &Measurement,
    ) {
        let Self { kinematics, dynamics, inverse_mass, link_forces, momentum, .. } = self;
        kinematics.update(robot, &estimate.state);
        dynamics.update(robot, &estimate.state, kinematics);
        link_forces.update(robot, kinematics, conventions, aero, &estimate.wind);
        let thrust = &estimate.thrust[..robot.jets.len()];
        momentum.update(robot, kinematics, dynamics, thrust, link_forces, &feedback);

        let force = &mut self.free_acceleration;
        force.copy_from(&dynamics.bias);
        force.neg_mut();
        momentum.thrusts.add_generalised_force(kinematics, force);
        if feedback.torque {
            momentum.aero.add_generalised_force(kinematics, force);
        }
        inverse_mass.update(&dynamics.mass_matrix);
        if inverse_mass.is_known {
            inverse_mass.multiply_in_place(force);
        }
    }
}
