//! Intermediate values of a tick, in the order in which they are computed.

use super::guard::wind_observer::WindState;
use super::law::attitude::AttitudeDemand;
use super::law::contact::Contact;
use super::law::momentum::{AeroFeedback, MomentumModel};
use super::law::momentum_qp::MomentumQp;
use super::law::setpoint::Setpoint;
use super::law::torque::TorqueQp;
use super::limits::Limits;
use super::measurement::{Measurement, Reading, UsedMeasurement};
use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::dynamics::{Dynamics, InverseMass};
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use nalgebra::{DVector, Matrix3, Vector3};

/// Input of the control law: the measurement after the estimators.
#[derive(Debug, Clone)]
pub struct Estimates {
    /// Pose, velocity and thrusts.
    pub reading: Reading,
    /// Velocity of the air \[m/s, inertial axes\].
    pub wind: Vector3<f64>,
    /// Its standard deviation; zero without a wind observer \[m/s\].
    pub wind_std: Vector3<f64>,
}

impl Estimates {
    /// Takes a measurement, with the wind estimated in the last tick where there is an estimate.
    pub(super) fn read(&mut self, measurement: &Measurement, wind: Option<&WindState>) {
        self.reading.copy(measurement.state, measurement.thrust);
        self.wind = wind.map_or(measurement.wind, WindState::wind);
        self.wind_std = wind.map_or_else(Vector3::zeros, WindState::std);
    }
}

/// All intermediate values of the last tick.
#[derive(Debug, Clone)]
pub struct Terms {
    /// The last measurement of this robot, after the estimators.
    pub estimates: Estimates,
    /// The measurement as used: predicted where it is not measured.
    pub measurement: UsedMeasurement,
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
    /// Friction with which the drives oppose the commanded velocities \[N m\].
    pub drive_friction: DVector<f64>,
    /// Torques of the command that act, as far as the guard finds, less that friction \[N m\].
    pub acting_torque: DVector<f64>,
    /// Measured latency of torques and thrust rates, as far as it is known \[s\].
    pub measured_latency: [Option<f64>; 2],
}

impl Terms {
    /// Allocates the terms of `robot`.
    pub(super) fn new(
        robot: &RobotModel,
        measurement: UsedMeasurement,
        limits: Limits,
        contact: Contact,
        momentum_qp: MomentumQp,
        torque_qp: TorqueQp,
    ) -> Self {
        let (joints, zero) = (robot.joints.len(), Vector3::zeros());
        let jets = measurement.thrust.len();
        let reading = Reading::zero(joints, jets);
        Self {
            estimates: Estimates { reading, wind: zero, wind_std: zero },
            measurement,
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
            drive_friction: DVector::zeros(joints),
            acting_torque: DVector::zeros(joints),
            measured_latency: [None; 2],
        }
    }

    /// Computes all quantities that depend on the measurement only.
    pub(super) fn update_model(
        &mut self,
        robot: &RobotModel,
        aero: &mut AeroModel,
        conventions: LinkConventions,
        feedback: AeroFeedback,
    ) {
        let Self { measurement, kinematics, dynamics, inverse_mass, link_forces, momentum, .. } = self;
        kinematics.update(robot, &measurement.state);
        dynamics.update(robot, &measurement.state, kinematics);
        link_forces.update(robot, kinematics, conventions, aero, &measurement.wind);
        let thrust = &measurement.thrust[..robot.jets.len()];
        momentum.update(robot, kinematics, dynamics, thrust, link_forces, &feedback);

        self.drive_friction.fill(0.0);
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

    /// Takes the torques that act where these are commanded \[N m, N\].
    pub(super) fn reduce_torque(&mut self, joint_torque: &[f64]) {
        let each = self.acting_torque.iter_mut().zip(joint_torque).zip(&self.limits.joints);
        for (((acting, commanded), found), friction) in each.zip(&self.drive_friction) {
            *acting = found.share() * commanded - friction;
        }
    }
}
