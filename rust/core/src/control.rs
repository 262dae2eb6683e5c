//! The flight controller: one tick, from a measurement to thrust rates and joint torques.
//!
//! [`Controller::tick`] reads top to bottom as the controller does: reference, kinematics and
//! dynamics, aerodynamic forces, momentum, tasks, QP, torques. Each step fills one plain struct that
//! the next reads; after a tick all of them are open to inspection in [`Controller::terms`].
//!
//! A tick does not allocate, does not panic and ends after a bounded number of iterations. (Clarabel
//! allocates, where the configuration chooses it.)
//!
//! Equations: `docs/model.md`, the integral of M68 here. Unknowns `u = (Ṫ, ṡ)`: thrust rates and joint velocities. With
//! `contact` in its configuration the same controller stands on its feet as well: `u = (Ṫ, ḟ_c, ṡ)`, and
//! torques and foot wrenches are found together.

pub mod attitude;
pub mod bounds;
pub mod config;
pub mod contact;
pub mod minimum_jerk;
pub mod mission;
pub mod model_error;
pub mod momentum;
pub mod recorded;
pub mod references;
pub mod standing;
pub mod tasks;
pub mod torque;
pub mod wind_estimate;

use crate::aero::{AeroModel, ForceFactors, LinkConventions, LinkForces};
use crate::dynamics::{Dynamics, MassFactor};
use crate::error::{BuildError, check};
use crate::kinematics::{Kinematics, RobotState};
use crate::qp::{QpAnswer, QpChain, QpProblem, QpSolver, QpStatus};
use crate::robot::RobotModel;
use crate::spatial::rpy_from_rotation;
use attitude::{AttitudeDemand, attitude_demand};
use config::ControllerConfig;
use contact::Contact;
use mission::Mission;
use momentum::MomentumModel;
use nalgebra::{DVector, Matrix3, Vector3, Vector6};
use references::{Reference, ReferenceGenerator};
use standing::StandingQp;
use tasks::{MomentumQp, TaskInputs};
use torque::{TorqueQp, limit_rate};

/// Where the published integrator of the joint velocity error saturates \[rad\]; no flight comes near.
const INTEGRAL_LIMIT: f64 = 20.0;

/// What the controller is told at a tick.
#[derive(Debug, Clone, Copy)]
pub struct Measurement<'a> {
    /// Time since the flight began \[s\].
    pub time: f64,
    /// Pose and velocity of the robot.
    pub state: &'a RobotState,
    /// Thrust of every jet \[N\].
    pub thrust: &'a [f64],
    /// Velocity of the air \[m/s, inertial axes\].
    pub wind: Vector3<f64>,
}

/// Whether a command is what the controller wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandStatus {
    /// Both QPs solved and certified.
    Nominal,
    /// The measurement holds a number that is not finite: thrust rates and joint velocities are
    /// zero, torques stay.
    BadMeasurement,
    /// The momentum QP has no answer: thrust rates and joint velocities are zero, or as near to zero
    /// as their bounds allow; torques brake the joints.
    MomentumHeld,
    /// The torque QP has no answer: torques stay.
    TorqueHeld,
    /// Neither QP has an answer.
    BothHeld,
}

/// What the controller asks of the robot, held until the next tick.
#[derive(Debug, Clone)]
pub struct Command {
    /// Thrust rates `Ṫ*` \[N/s\].
    pub thrust_rate: DVector<f64>,
    /// Joint velocities `ṡ*` \[rad/s\].
    pub joint_velocity: DVector<f64>,
    /// Joint torques after the rate limiter \[N m\].
    pub joint_torque: DVector<f64>,
    /// Answer of the momentum QP.
    pub momentum_qp: QpAnswer,
    /// Answer of the torque QP.
    pub torque_qp: QpAnswer,
    /// Whether this is what the controller wanted.
    pub status: CommandStatus,
}

/// What the controller remembers from one tick to the next.
#[derive(Debug, Clone)]
pub struct Memory {
    /// Posture to return to, `s_d`: the joint positions of the first tick \[rad\].
    pub posture: DVector<f64>,
    /// Centroidal inertia in body axes at the first tick \[kg m²\].
    pub inertia_0_b: Matrix3<f64>,
    /// `∫(ṡ − ṡ*)` \[rad\].
    pub velocity_error_integral: DVector<f64>,
    /// Whether the rate limiter has a torque to start from.
    pub torque_is_known: bool,
}

/// All intermediate values of the last tick.
#[derive(Debug, Clone)]
pub struct Terms {
    /// Poses, velocities, centre of mass.
    pub kinematics: Kinematics,
    /// Mass matrix, bias, centroidal momentum.
    pub dynamics: Dynamics,
    /// Estimated aerodynamic forces.
    pub link_forces: LinkForces,
    /// `A_T`, `Λ`, `L̇`.
    pub momentum: MomentumModel,
    /// Reference followed.
    pub reference: Reference,
    /// What the attitude law asked for.
    pub attitude: AttitudeDemand,
    /// Tasks and the momentum QP.
    pub momentum_qp: MomentumQp,
    /// The torque QP of a robot that does not stand; of an earlier tick while the feet carry.
    pub torque_qp: TorqueQp,
    /// The feet, for a controller that can stand.
    pub contact: Option<Contact>,
    /// The torque QP of a robot that stands; up to date while the feet carry.
    pub standing_qp: Option<StandingQp>,
    /// Torques before the rate limiter \[N m\].
    pub unlimited_torque: DVector<f64>,
}

/// The controller of one robot.
#[derive(Debug)]
pub struct Controller {
    robot: RobotModel,
    config: ControllerConfig,
    mission: Mission,
    time_step: f64,
    aero: AeroModel,
    aero_factors: ForceFactors,
    references: Option<ReferenceGenerator>,
    memory: Memory,
    terms: Terms,
    command: Command,
    mass_factor: MassFactor,
    force: DVector<f64>,
    velocity_error: DVector<f64>,
    solution: DVector<f64>,
    momentum_solver: QpChain,
    torque_solver: QpChain,
    standing_solver: Option<QpChain>,
    /// Whether the foot wrenches that were handed over last can be used.
    feet_are_sound: bool,
    /// What stands for the thrusts where jets are not used.
    no_thrust: Vec<f64>,
}

impl Controller {
    /// A controller for `robot`, or for what it believes `robot` to be, that ticks every `time_step` \[s\].
    ///
    /// # Errors
    /// [`BuildError`] naming what in the configuration does not fit the robot.
    pub fn new(
        robot: RobotModel,
        aero: AeroModel,
        mission: Mission,
        config: ControllerConfig,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        config.check(&robot)?;
        config.aero_feedback.check(&aero)?;
        mission.check()?;
        check("controller time step", time_step, |dt| dt > 0.0, "a positive number of seconds")?;
        let robot = config.model_error.believed(robot);
        let (jets, joints) = (robot.jets.len(), robot.joints.len());
        let n = 6 + joints;
        let feet = robot.feet.len();
        let contact = config.contact.as_ref();
        let unknowns = jets + contact.map_or(0, |_| contact::WRENCH * feet) + joints;
        let zero = Vector3::zeros();
        Ok(Self {
            aero,
            aero_factors: ForceFactors::new(
                &config.aero_feedback.factors(),
                &robot.aero_links,
                "controller.aero_feedback",
            )?,
            references: None,
            memory: Memory {
                posture: DVector::zeros(joints),
                inertia_0_b: Matrix3::identity(),
                velocity_error_integral: DVector::zeros(joints),
                torque_is_known: false,
            },
            terms: Terms {
                kinematics: Kinematics::new(&robot),
                dynamics: Dynamics::new(&robot),
                link_forces: LinkForces::new(&robot),
                momentum: MomentumModel::new(&robot),
                reference: Reference::hold(zero, Matrix3::identity()),
                attitude: AttitudeDemand { k_ddot_desired_b: zero, sigma_i: zero },
                momentum_qp: MomentumQp::new(&config, &robot)?,
                torque_qp: TorqueQp::new(&config.torque, joints),
                contact: contact.map(|contact| Contact::new(contact, &robot)),
                standing_qp: contact.map(|contact| StandingQp::new(&config.torque, contact, joints, feet)),
                unlimited_torque: DVector::zeros(joints),
            },
            command: Command {
                thrust_rate: DVector::zeros(jets),
                joint_velocity: DVector::zeros(joints),
                joint_torque: DVector::zeros(joints),
                momentum_qp: QpAnswer::refused(QpStatus::NonFinite),
                torque_qp: QpAnswer::refused(QpStatus::NonFinite),
                status: CommandStatus::Nominal,
            },
            mass_factor: MassFactor::new(n),
            force: DVector::zeros(n),
            velocity_error: DVector::zeros(joints),
            solution: DVector::zeros(unknowns),
            momentum_solver: config.qp.chain(unknowns, 0),
            torque_solver: config.qp.chain(joints, 0),
            standing_solver: contact
                .map(|_| config.qp.chain(contact::WRENCH * feet + joints, contact::WRENCH_ROWS * feet)),
            feet_are_sound: true,
            no_thrust: vec![0.0; jets],
            robot,
            config,
            mission,
            time_step,
        })
    }

    /// One tick. The first call starts the controller: it takes the position, attitude and posture
    /// it finds as those to keep.
    pub fn tick(&mut self, measurement: &Measurement) -> &Command {
        if !self.accepts(measurement) {
            return self.refuse_measurement();
        }
        self.observe(measurement);
        if self.references.is_none() && !self.start(measurement.state) {
            return self.refuse_measurement();
        }
        if let Some(references) = &mut self.references {
            self.terms.reference = references.update(&self.mission, measurement.time);
        }
        self.act(measurement)
    }

    /// One tick that follows a given reference instead of the mission.
    pub fn tick_with_reference(&mut self, measurement: &Measurement, reference: &Reference) -> &Command {
        if !self.accepts(measurement) {
            return self.refuse_measurement();
        }
        self.observe(measurement);
        self.terms.reference = *reference;
        self.act(measurement)
    }

    /// Takes what each foot feels, until told otherwise: wrenches about the origins of the soles, force
    /// first, inertial axes \[N, N m\], in the order of the robot's feet. A controller without `contact` in
    /// its configuration has no use for them.
    ///
    /// Numbers that are not finite, or another number of feet, make the next ticks refuse to act, as any
    /// bad measurement does.
    pub fn feel(&mut self, feet: &[Vector6<f64>]) {
        let Some(contact) = &mut self.terms.contact else { return };
        self.feet_are_sound = feet.len() == contact.measured.len()
            && feet.iter().all(|wrench| wrench.iter().all(|component| component.is_finite()));
        if self.feet_are_sound {
            contact.measured.copy_from_slice(feet);
        }
    }

    /// Everything that depends on the measurement alone.
    fn observe(&mut self, measurement: &Measurement) {
        let Terms { kinematics, dynamics, link_forces, momentum, contact, .. } = &mut self.terms;
        let thrust = if self.config.use_jets { measurement.thrust } else { &self.no_thrust };
        let feedback = &self.config.aero_feedback;
        let conventions = LinkConventions {
            lever_arm: self.config.lever_arm,
            jacobian_offset: self.config.jacobian_offset,
            link_velocity: self.config.link_velocity,
        };
        kinematics.update(&self.robot, measurement.state);
        dynamics.update(&self.robot, measurement.state, kinematics);
        link_forces.update(&self.robot, kinematics, conventions, &mut self.aero, &measurement.wind);
        link_forces.scale(feedback.scale);
        self.aero_factors.apply(link_forces);
        let whole = feedback.momentum_rate && feedback.force && feedback.moment;
        let enters = (whole, feedback.lambda);
        momentum.update(&self.robot, kinematics, dynamics, thrust, link_forces, enters);
        if feedback.momentum_rate && !whole {
            momentum.add_part_of_rate(link_forces, &kinematics.com, feedback.force, feedback.moment);
        }
        if let Some(contact) = contact {
            contact.update(&self.robot, kinematics, dynamics, self.time_step);
            if contact.is_active {
                momentum.add_contact(&self.robot, kinematics, dynamics, contact);
            }
        }
    }

    /// Everything that follows from the reference: the momentum QP, then the torque QP.
    fn act(&mut self, measurement: &Measurement) -> &Command {
        self.solve_momentum_qp(measurement);
        self.solve_torque_qp(measurement);
        &self.command
    }

    /// Thrust rates and joint velocities that shape momentum and attitude.
    fn solve_momentum_qp(&mut self, measurement: &Measurement) {
        let Terms { kinematics, dynamics, momentum, reference, attitude, momentum_qp, contact, .. } =
            &mut self.terms;
        let moment_estimate: Vector3<f64> = momentum.rate_estimate.fixed_rows::<3>(3).into();
        let inertia_0_b = &self.memory.inertia_0_b;
        *attitude = attitude_demand(
            &self.config.momentum,
            reference,
            &measurement.state.base.rotation,
            &measurement.state.base_angular_velocity(),
            &moment_estimate,
            inertia_0_b,
            &inertia_0_b.try_inverse().unwrap_or_else(Matrix3::zeros),
        );
        let inputs = TaskInputs {
            state: measurement.state,
            thrust: measurement.thrust,
            kinematics,
            dynamics,
            momentum,
            reference,
            attitude,
            inertia_0_b,
            posture: &self.memory.posture,
            contact: contact.as_ref(),
        };
        momentum_qp.update(&self.robot, &self.config.momentum, &inputs);

        let answer = self.momentum_solver.solve(&momentum_qp.problem);
        self.command.momentum_qp = answer;
        self.solution.as_mut_slice().copy_from_slice(self.momentum_solver.x());
        self.command.status = CommandStatus::Nominal;
        if answer.status != QpStatus::Solved {
            self.command.status = CommandStatus::MomentumHeld;
            nearest_to_zero(&momentum_qp.problem, &mut self.solution);
        }
        let jets = self.robot.jets.len();
        self.command.thrust_rate.copy_from(&self.solution.rows(0, jets));
        let joints = self.robot.joints.len();
        let first_joint = self.solution.len() - joints;
        self.command.joint_velocity.copy_from(&self.solution.rows(first_joint, joints));
        if let Some(contact) = contact {
            contact.take_rate(&self.solution.as_slice()[jets..first_joint]);
        }
    }

    /// Torques that let the joints follow the commanded velocities.
    fn solve_torque_qp(&mut self, measurement: &Measurement) {
        let Terms {
            kinematics,
            dynamics,
            link_forces,
            momentum,
            torque_qp,
            contact,
            standing_qp,
            unlimited_torque,
            ..
        } = &mut self.terms;
        let thrust = if self.config.use_jets { measurement.thrust } else { &self.no_thrust };
        // Σ Jᵀ T a + J_aᵀ f_a − h
        self.force.copy_from(&dynamics.bias);
        self.force.neg_mut();
        for (index, jet) in self.robot.jets.iter().enumerate() {
            let thrust_force = momentum.jet_axes_i[index] * thrust[index];
            let point = &momentum.jet_points_i[index];
            kinematics.add_generalised_force(jet.frame.body, point, &thrust_force, &mut self.force);
        }
        if self.config.aero_feedback.torque && !matches!(self.aero, AeroModel::Off) {
            link_forces.add_generalised_force(&self.robot, kinematics, &mut self.force);
        }
        for (joint, velocity) in measurement.state.joint_velocity().iter().enumerate() {
            self.velocity_error[joint] = velocity - self.command.joint_velocity[joint];
        }

        let mass_is_sound = self.mass_factor.factorise(&dynamics.mass_matrix);
        let integral = &self.memory.velocity_error_integral;
        let standing = contact.as_mut().zip(standing_qp.as_mut()).zip(self.standing_solver.as_mut());
        let standing = standing.filter(|((contact, _), _)| contact.is_active);
        let answer = if !mass_is_sound {
            QpAnswer::refused(QpStatus::NotPositiveDefinite)
        } else if let Some(((contact, qp), solver)) = standing {
            qp.update(
                &self.config.torque,
                contact,
                &self.mass_factor,
                &mut self.force,
                &self.velocity_error,
                integral,
            );
            let answer = solver.solve(&qp.problem);
            if answer.status == QpStatus::Solved {
                let (forces, torques) = solver.x().split_at(contact.force.len());
                contact.force_of_torques.as_mut_slice().copy_from_slice(forces);
                unlimited_torque.as_mut_slice().copy_from_slice(torques);
            }
            answer
        } else {
            torque_qp.update(
                &self.config.torque,
                &self.mass_factor,
                &mut self.force,
                &self.velocity_error,
                integral,
            );
            let answer = self.torque_solver.solve(&torque_qp.problem);
            unlimited_torque.as_mut_slice().copy_from_slice(self.torque_solver.x());
            answer
        };
        self.command.torque_qp = answer;
        if answer.status == QpStatus::Solved {
            if !self.memory.torque_is_known {
                // The published rate limiter starts from its first input.
                self.command.joint_torque.copy_from(unlimited_torque);
                self.memory.torque_is_known = true;
            }
            let rate_max = self.config.torque.torque_rate_max;
            limit_rate(&mut self.command.joint_torque, unlimited_torque.as_slice(), rate_max, self.time_step);
        } else {
            self.command.status = match self.command.status {
                CommandStatus::MomentumHeld => CommandStatus::BothHeld,
                _ => CommandStatus::TorqueHeld,
            };
        }
        // Forward Euler: used first, advanced after. A tick without a commanded velocity has no error to
        // remember, and one absurd sample must not outlive its tick.
        if self.command.momentum_qp.status == QpStatus::Solved {
            let integral = self.memory.velocity_error_integral.iter_mut();
            for (integral, error) in integral.zip(&self.velocity_error) {
                *integral = (*integral + self.time_step * error).clamp(-INTEGRAL_LIMIT, INTEGRAL_LIMIT);
            }
        }
    }

    /// Remembers where the flight starts; `false` if its inertia or centre of mass overflow.
    fn start(&mut self, state: &RobotState) -> bool {
        let rotation = &state.base.rotation;
        let inertia = rotation.transpose() * self.terms.dynamics.centroidal_inertia * rotation;
        let com = &self.terms.kinematics.com;
        if inertia.try_inverse().is_none() || !inertia.iter().chain(com).all(|x| x.is_finite()) {
            return false;
        }
        self.references = Some(ReferenceGenerator::new(
            &self.config.references,
            self.time_step,
            self.terms.kinematics.com,
            rpy_from_rotation(rotation),
        ));
        self.memory.posture.copy_from(&state.joint_position);
        self.memory.inertia_0_b = inertia;
        true
    }

    fn accepts(&self, measurement: &Measurement) -> bool {
        measurement.state.n_joints() == self.robot.joints.len()
            && measurement.state.velocity.len() == 6 + self.robot.joints.len()
            && measurement.thrust.len() == self.robot.jets.len()
            && measurement.state.is_finite()
            && measurement.thrust.iter().all(|thrust| thrust.is_finite())
            && measurement.wind.iter().all(|wind| wind.is_finite())
            && measurement.time.is_finite()
            && self.feet_are_sound
    }

    fn refuse_measurement(&mut self) -> &Command {
        self.command.thrust_rate.fill(0.0);
        self.command.joint_velocity.fill(0.0);
        self.command.momentum_qp = QpAnswer::refused(QpStatus::NonFinite);
        self.command.torque_qp = QpAnswer::refused(QpStatus::NonFinite);
        self.command.status = CommandStatus::BadMeasurement;
        &self.command
    }

    /// The robot that the controller believes it flies.
    #[must_use]
    pub fn robot(&self) -> &RobotModel {
        &self.robot
    }

    /// Command of the last tick.
    #[must_use]
    pub fn command(&self) -> &Command {
        &self.command
    }

    /// Intermediate values of the last tick.
    #[must_use]
    pub fn terms(&self) -> &Terms {
        &self.terms
    }

    /// What is remembered between ticks.
    #[must_use]
    pub fn memory(&self) -> &Memory {
        &self.memory
    }

    /// Replaces the memory, to start from a recorded tick.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] if a length does not fit or the inertia cannot be inverted.
    pub fn set_memory(&mut self, memory: Memory) -> Result<(), BuildError> {
        let joints = self.robot.joints.len();
        for (item, length) in [
            ("posture", memory.posture.len()),
            ("velocity_error_integral", memory.velocity_error_integral.len()),
        ] {
            if length != joints {
                return Err(BuildError::bad_value(
                    format!("length of controller memory {item}"),
                    length,
                    format!("{joints}, one entry per joint"),
                ));
            }
        }
        for (item, values) in [
            ("posture", memory.posture.as_slice()),
            ("inertia_0_b", memory.inertia_0_b.as_slice()),
            ("velocity_error_integral", memory.velocity_error_integral.as_slice()),
        ] {
            for value in values {
                check(&format!("controller memory {item}"), *value, |_| true, "finite numbers")?;
            }
        }
        if memory.inertia_0_b.try_inverse().is_none() {
            return Err(BuildError::bad_value(
                "controller memory inertia_0_b",
                memory.inertia_0_b,
                "an invertible inertia",
            ));
        }
        self.memory = memory;
        Ok(())
    }
}

/// The safe command where the momentum QP has no answer: nothing moves, as far as the bounds allow.
fn nearest_to_zero(problem: &QpProblem, x: &mut DVector<f64>) {
    for (x, (lower, upper)) in x.iter_mut().zip(problem.lower.iter().zip(&problem.upper)) {
        *x = 0.0_f64.max(*lower).min(*upper);
    }
}
