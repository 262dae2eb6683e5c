//! The flight controller: one tick, from a measurement to thrust rates and joint torques.
//!
//! [`Controller::tick`] follows the order of the computation: state estimate, set-point, kinematics and dynamics,
//! aerodynamic forces, momentum, tasks, QP, torques, wind estimate. Each step fills one plain struct that the next
//! reads; after a tick [`Controller::terms`] gives access to all of them.
//!
//! [`Controller::start`] returns the [`ControllerState`], the only value that is changed by a tick and needed by the
//! next. A clone of it that is restored later continues with the same bits.
//!
//! A tick does not allocate, does not panic and ends after a bounded number of iterations. (Clarabel allocates, if the
//! configuration selects it.)
//!
//! Equations: `docs/model.md`; this file has the integral of M68, and M101. Unknowns `u = (Ṫ, ṡ)`: thrust rates and
//! joint velocities. With `contact` in its configuration the same controller also stands on its feet:
//! `u = (Ṫ, ḟ_c, ṡ)`, and torques and foot wrenches are determined together.

pub mod attitude;
pub mod bounds;
pub mod channels;
pub mod command;
pub mod config;
pub mod contact;
pub mod engines;
pub mod minimum_jerk;
pub mod mission;
pub mod momentum;
pub mod momentum_qp;
pub mod observer;
pub mod recorded;
pub mod setpoint;
pub mod state;
pub mod tasks;
pub mod torque;

pub use command::{BadCommand, BadStart, Command, CommandStatus, Measurement};
pub use state::ControllerState;

use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::dynamics::{Dynamics, InverseMass};
use crate::error::{BuildError, check};
use crate::estimator::{Estimator, EstimatorConfig, Reading};
use crate::kinematics::Kinematics;
use crate::qp::{QpAnswer, QpChain, QpSolver, QpStatus, WarmStart};
use crate::robot::RobotModel;
use crate::spatial::parts;
use crate::wind_observer::{WindObserver, WindState};
use attitude::{AttitudeDemand, attitude_demand};
use channels::{Channels, Modes, UsedMeasurement};
use config::ControllerConfig;
use contact::{Contact, ContactState, WRENCH};
use engines::{DescentConfig, EngineState, sensor_error};
use mission::Mission;
use momentum::MomentumModel;
use momentum_qp::{MomentumQp, Task, TaskInputs};
use nalgebra::{DVector, Matrix3, Vector3, Vector6};
use observer::{ObserverState, Sample};
use setpoint::{Setpoint, SetpointGenerator};
use std::sync::Arc;
use torque::{TorqueQp, limit_rate};

/// Least time between two ticks \[s\]; the longest delay, that of a wind estimate, is then five million ticks.
const TIME_STEP_MIN: f64 = 2e-4;

/// Checks the time between two ticks \[s\]; `item` is named in errors.
///
/// # Errors
/// [`BuildError::BadValue`].
pub fn check_time_step(item: &str, time_step: f64) -> Result<(), BuildError> {
    check(item, time_step, |step| (TIME_STEP_MIN..=1.0).contains(&step), "seconds from 0.0002 to 1")?;
    Ok(())
}

/// Limit of the published integrator of the joint velocity error \[rad\]; no flight comes near it.
const INTEGRAL_LIMIT: f64 = 20.0;

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

/// All intermediate values of the last tick.
#[derive(Debug, Clone)]
pub struct Terms {
    /// The last measurement of this robot, after the estimators.
    pub estimates: Estimates,
    /// The measurement as used: predicted where it is not measured.
    pub measurement: UsedMeasurement,
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
    /// Set-point that is followed.
    pub setpoint: Setpoint,
    /// Demand of the attitude law.
    pub attitude: AttitudeDemand,
    /// Tasks and the momentum QP.
    pub momentum_qp: MomentumQp,
    /// The torque QP.
    pub torque_qp: TorqueQp,
    /// Contact quantities; empty for a controller that only flies.
    pub contact: Contact,
    /// Torques before the rate limiter \[N m\].
    pub unlimited_torque: DVector<f64>,
}

/// The controller of one robot: model, control laws and workspace.
#[derive(Debug)]
pub struct Controller {
    /// Model of the robot; without jets if the controller does not use them.
    model: RobotModel,
    /// Number of jets of the robot, used or not.
    n_jets: usize,
    config: ControllerConfig,
    /// State estimator, if configured.
    estimator: Option<Estimator>,
    /// Wind observer, if configured; the next tick uses its estimate.
    wind_observer: Option<WindObserver>,
    /// Channels of the measurement.
    channels: Channels,
    time_step: f64,
    aero: AeroModel,
    setpoint_generator: SetpointGenerator,
    terms: Terms,
    command: Command,
    /// `ν̇` without torques and foot wrenches.
    free_acceleration: DVector<f64>,
    acceleration: DVector<f64>,
    velocity_error: DVector<f64>,
    solution: DVector<f64>,
    momentum_solver: QpChain,
    torque_solver: QpChain,
}

impl Controller {
    /// Builds a controller for `robot` with the tick `time_step` \[s\]. `aero` builds its aerodynamic model after
    /// `config` has been checked, so that gains for another robot are reported before missing coefficients.
    ///
    /// # Errors
    /// [`BuildError`] naming the part of the configuration that does not match the robot or the time step.
    pub fn new(
        robot: RobotModel,
        aero: impl FnOnce(&RobotModel) -> Result<AeroModel, BuildError>,
        mission: Mission,
        config: ControllerConfig,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        config.check(&robot)?;
        check_time_step("controller time step", time_step)?;
        let aero = aero(&robot)?;
        let n_jets = robot.jets.len();
        let mut model = config.restrict(robot);
        let (estimator, wind_observer) = (config.estimator.as_ref(), config.wind_observer.as_ref());
        let estimator = estimator
            .map(|estimator| Estimator::new(estimator, model.clone(), aero.clone(), time_step))
            .transpose()?;
        let wind_observer = wind_observer
            .map(|observer| WindObserver::new(observer, model.clone(), aero.clone(), time_step))
            .transpose()?;
        config.check_rate_bounds(&model, time_step)?;
        config.observer.as_ref().map_or(Ok(()), |observer| observer.check(time_step))?;
        let observes_joints = |estimator: &EstimatorConfig| estimator.joint_observer.is_some();
        let needs_joint_velocity = !config.estimator.as_ref().is_some_and(observes_joints);
        let channels = Channels::new(&config.channels, &model, time_step, needs_joint_velocity);
        let measurement = UsedMeasurement::new(&model, time_step);
        if !config.use_jets {
            model.jets.clear();
        }
        let joints = model.joints.len();
        let n = 6 + joints;
        let contact = config.contact.clone().unwrap_or_default();
        let momentum_qp = MomentumQp::new(&config, &model)?;
        let torque_qp = TorqueQp::new(&config.torque, &contact, &model);
        let zero = Vector3::zeros();
        Ok(Self {
            n_jets,
            aero,
            estimator,
            wind_observer,
            solution: DVector::zeros(momentum_qp.problem.len()),
            momentum_solver: config.qp.chain(momentum_qp.problem.len(), 0),
            torque_solver: config.qp.chain(torque_qp.problem.len(), torque_qp.problem.rows()),
            setpoint_generator: SetpointGenerator::new(
                &config.setpoint,
                mission,
                &model.forward_axis_b,
                time_step,
            )?,
            channels,
            terms: Terms {
                estimates: Estimates { reading: Reading::zero(joints, n_jets), wind: zero, wind_std: zero },
                measurement,
                kinematics: Kinematics::new(&model),
                dynamics: Dynamics::new(&model),
                inverse_mass: InverseMass::new(joints),
                link_forces: LinkForces::new(&model),
                momentum: MomentumModel::new(&model),
                setpoint: Setpoint::hold(zero, Matrix3::identity()),
                attitude: AttitudeDemand { k_ddot_desired_b: zero, sigma_i: zero },
                unlimited_torque: DVector::zeros(joints),
                contact: Contact::new(&contact, &model),
                momentum_qp,
                torque_qp,
            },
            command: Command {
                thrust_rate: DVector::zeros(n_jets),
                joint_velocity: DVector::zeros(joints),
                joint_torque: DVector::zeros(joints),
                momentum_qp: QpAnswer::from_status(QpStatus::NonFinite),
                torque_qp: QpAnswer::from_status(QpStatus::NonFinite),
                status: CommandStatus::Nominal,
                modes: Modes::default(),
            },
            acceleration: DVector::zeros(n),
            free_acceleration: DVector::zeros(n),
            velocity_error: DVector::zeros(joints),
            model,
            config,
            time_step,
        })
    }

    /// State of a controller whose first tick is that of `measurement`; position, attitude and posture of this
    /// measurement become its reference.
    ///
    /// # Errors
    /// [`BadStart`] for a measurement of another robot, for one that lacks a number other than the wind, and where inertia
    /// or centre of mass overflow.
    pub fn start(&mut self, measurement: &Measurement) -> Result<ControllerState, BadStart> {
        let channels = self.channels.start(measurement)?;
        let Terms { kinematics, dynamics, contact, .. } = &mut self.terms;
        kinematics.update(&self.model, measurement.state);
        dynamics.update(&self.model, measurement.state, kinematics);
        let rotation = &measurement.state.base.rotation;
        let inertia_0_b = rotation.transpose() * dynamics.centroidal_inertia * rotation;
        let com = kinematics.com;
        if inertia_0_b.try_inverse().is_none() || !inertia_0_b.iter().chain(&com).all(|x| x.is_finite()) {
            return Err(BadStart::SingularInertia);
        }
        let estimator = self.estimator.as_ref();
        let joints = self.model.joints.len();
        Ok(ControllerState {
            estimator: estimator
                .map(|estimator| estimator.start(measurement.state, self.channels.thrust(&channels))),
            wind: self.wind_observer.as_ref().map(WindObserver::start),
            channels,
            setpoint: self.setpoint_generator.start(com, rotation),
            posture: measurement.state.joint_position.clone(),
            inertia_0_b,
            velocity_error_integral: DVector::zeros(joints),
            joint_torque: DVector::zeros(joints),
            torque_is_known: false,
            contact: ContactState::new(contact.soles.len()),
            engines: vec![EngineState::default(); self.n_jets],
            observer: ObserverState::default(),
            momentum_start: WarmStart::cold(self.terms.momentum_qp.problem.len()),
            torque_start: WarmStart::cold(self.terms.torque_qp.problem.len()),
        })
    }

    /// One tick, which follows the mission.
    ///
    /// What of the measurement is missing or cannot be right is predicted from what is known ([`channels`]); the command
    /// says what. Of a measurement that is not of this robot everything is missing, and the command holds: thrust rates
    /// and joint velocities are zero, torques stay.
    pub fn tick(&mut self, state: &mut ControllerState, measurement: &Measurement) -> &Command {
        if !self.fits(state) {
            return self.hold_command(CommandStatus::BadState, Modes::default());
        }
        let is_usable = self.take_measurement(state, measurement);
        let setpoint = if state.channels.is_descending {
            self.setpoint_generator.descend(&mut state.setpoint, self.terms.contact.stays(&state.contact))
        } else {
            self.setpoint_generator.update(&mut state.setpoint, self.terms.measurement.time)
        };
        self.act(state, is_usable, &setpoint)
    }

    /// One tick that follows the given set-point instead of the mission. An invalid set-point results in the status
    /// [`CommandStatus::BadSetpoint`], and the robot brakes from the motion of the last valid one (M115). During a
    /// descent set-points are ignored.
    pub fn tick_towards(
        &mut self,
        state: &mut ControllerState,
        measurement: &Measurement,
        setpoint: &Setpoint,
    ) -> &Command {
        if !self.fits(state) {
            return self.hold_command(CommandStatus::BadState, Modes::default());
        }
        let is_usable = self.take_measurement(state, measurement);
        let is_valid = setpoint.is_valid(&self.config.channels.greatest);
        let followed = if state.channels.is_descending {
            self.setpoint_generator.descend(&mut state.setpoint, self.terms.contact.stays(&state.contact))
        } else if is_valid {
            self.setpoint_generator.follow(&mut state.setpoint, &setpoint.motion());
            *setpoint
        } else {
            self.setpoint_generator.stop(&mut state.setpoint)
        };
        self.act(state, is_usable, &followed);
        if !is_valid && matches!(self.command.status, CommandStatus::Nominal | CommandStatus::Degraded) {
            self.command.status = CommandStatus::BadSetpoint;
        }
        &self.command
    }

    /// Reports that other thrust rates and torques act until the next tick in place of the last command, such as those
    /// of a safety layer or of a learned residual. The predictions of channels and estimator use them. While the feet
    /// carry load, the predictions use the thrust rates only, because other torques change the load on the feet more
    /// than the motion of the robot. The rate limiter continues from the control law's own torques.
    ///
    /// # Errors
    /// [`BadCommand`]; the state is then unchanged.
    pub fn replace_command(
        &mut self,
        state: &mut ControllerState,
        thrust_rate: &[f64],
        joint_torque: &[f64],
    ) -> Result<(), BadCommand> {
        let is_finite = thrust_rate.iter().chain(joint_torque).all(|number| number.is_finite());
        let is_sized = thrust_rate.len() == self.n_jets && joint_torque.len() == self.model.joints.len();
        if !is_finite || !is_sized || !self.fits(state) {
            return Err(BadCommand);
        }
        let Self {
            model,
            command,
            acceleration,
            terms: Terms { kinematics, dynamics, inverse_mass, .. },
            ..
        } = self;
        let last = &mut state.channels;
        if !state.contact.is_active {
            // ν̇ is linear in the torques: it changes by M⁻¹ S (τ′ − τ). The state may be that of another tick than the
            // controller's last one.
            kinematics.update(model, &last.commanded_in);
            dynamics.update(model, &last.commanded_in, kinematics);
            inverse_mass.update(&dynamics.mass_matrix);
            if inverse_mass.is_known {
                acceleration.fill(0.0);
                let torques = joint_torque.iter().zip(&last.joint_torque);
                for (entry, (new, old)) in acceleration.as_mut_slice()[6..].iter_mut().zip(torques) {
                    *entry = new - old;
                }
                inverse_mass.multiply_in_place(acceleration);
                last.acceleration += &*acceleration;
            }
            last.joint_torque.copy_from_slice(joint_torque);
        }
        last.thrust_rate.copy_from_slice(thrust_rate);
        command.thrust_rate.copy_from_slice(thrust_rate);
        command.joint_torque.copy_from_slice(joint_torque);
        if let Some(memory) = &mut state.estimator {
            memory.replace_command(last.thrust_rate.as_slice(), last.joint_torque.as_slice());
        }
        Ok(())
    }

    /// Processes a measurement and advances the time; returns whether the measurement has the sizes of this robot.
    fn take_measurement(&mut self, state: &mut ControllerState, measurement: &Measurement) -> bool {
        let is_usable = self.channels.fit(measurement);
        let Terms { estimates, measurement: used, .. } = &mut self.terms;
        if is_usable {
            estimates.wind = state.wind.as_ref().map_or(measurement.wind, WindState::wind);
            estimates.wind_std = state.wind.as_ref().map_or_else(Vector3::zeros, WindState::std);
            estimates.reading.copy(measurement.state, measurement.thrust);
            let measurement = Measurement { wind: estimates.wind, ..*measurement };
            self.channels.update(&mut state.channels, &measurement, used);
        } else {
            self.channels.update_unmeasured(&mut state.channels, measurement.time, used);
        }
        if let (Some(estimator), Some(memory)) = (&mut self.estimator, &mut state.estimator) {
            self.channels.select_accepted(&state.channels, &mut estimates.reading);
            if used.pause > 0.0 {
                memory.restart();
            }
            estimator.update(memory, &mut estimates.reading, used.elapsed, &mut used.thrust_innovation);
            self.channels.replace(&mut estimates.reading, used);
        }
        is_usable
    }

    /// Observes, then solves the momentum QP and the torque QP, or holds where the measurement is not of this robot.
    fn act(&mut self, state: &mut ControllerState, is_usable: bool, setpoint: &Setpoint) -> &Command {
        self.terms.setpoint = *setpoint;
        self.command.joint_torque.copy_from(&state.joint_torque);
        self.observe(state);
        let modes = self.terms.measurement.modes;
        self.command.modes = modes;
        let descent = self.config.engines.as_ref().and_then(|config| config.descent).filter(|descent| {
            let mut engines = state.engines.iter().zip(&self.model.jets);
            engines.any(|(engine, jet)| engine.is_lost(descent, jet.thrust_max))
        });
        state.channels.is_descending |= descent.is_some();
        let descent = descent.filter(|_| !state.contact.is_active);
        self.update_free_acceleration();
        self.terms.contact.force_of_torques.copy_from(&state.contact.force);
        if is_usable {
            self.solve_momentum_qp(state, descent.as_ref());
            self.solve_torque_qp(state, descent.as_ref());
        } else {
            self.hold_command(CommandStatus::BadMeasurement, modes);
        }
        self.predict_acceleration(state);
        if let (Some(observer), Some(memory)) = (&mut self.wind_observer, &mut state.wind) {
            observer.update(memory, &self.terms);
        }
        if let Some(memory) = &mut state.estimator {
            let Terms { momentum, measurement: used, contact, .. } = &self.terms;
            let feet = contact.force_of_torques.as_slice();
            memory.command(&self.command, &momentum.unmodelled_wrench, &used.wind, feet);
        }
        &self.command
    }

    /// Computes all quantities that depend on the measurement and the set-point only.
    fn observe(&mut self, state: &mut ControllerState) {
        let Terms { measurement, kinematics, dynamics, link_forces, momentum, contact, setpoint, .. } =
            &mut self.terms;
        let conventions = LinkConventions {
            lever_arm: self.config.lever_arm,
            jacobian_offset: self.config.jacobian_offset,
            link_velocity: self.config.link_velocity,
        };
        kinematics.update(&self.model, &measurement.state);
        dynamics.update(&self.model, &measurement.state, kinematics);
        link_forces.update(&self.model, kinematics, conventions, &mut self.aero, &measurement.wind);
        let thrust = &measurement.thrust[..self.model.jets.len()];
        let feedback = &self.config.aero_feedback;
        momentum.update(&self.model, kinematics, dynamics, thrust, link_forces, feedback);
        // Momentum rate for the observer: with the feet as measured, not as desired.
        let mut rate = momentum.rate_estimate;
        let climb = setpoint.com_position.z - kinematics.com.z;
        // During a descent the robot must not take off.
        let climb = if state.channels.is_descending { climb.min(0.0) } else { climb };
        let observer = &mut state.observer;
        let are_measured = !measurement.modes.contains(Modes::FEET_PREDICTED);
        let unmodelled = observer.wrench[2] + observer.residual[2];
        let carry_unknown =
            contact.carry_unknown(&mut state.contact, are_measured, climb, unmodelled, measurement.elapsed);
        if carry_unknown {
            // The observed wrench is the load of the feet.
            *observer = ObserverState::default();
            if are_measured {
                state.channels.reject_feet(measurement);
            }
        }
        contact.update(
            &mut state.contact,
            &self.model,
            kinematics,
            dynamics,
            &measurement.foot_wrenches,
            climb,
            -momentum.rate_estimate[2],
            carry_unknown,
            self.time_step,
        );
        // Predicted wrenches of loaded feet are not a measurement of the acting forces.
        measurement.has_momentum &=
            !(state.contact.is_active && measurement.modes.contains(Modes::FEET_PREDICTED));
        contact.add_measured(&measurement.foot_wrenches, &kinematics.com, &mut rate);
        if state.contact.is_active {
            momentum.add_contact(&self.model, kinematics, dynamics, &contact.soles, &state.contact.force);
            if let Some(height) = contact.stand_height() {
                state.setpoint.keep_above(kinematics.com.z - height);
            }
        }
        if let Some(config) = &self.config.observer {
            let sample = Sample { momentum: dynamics.momentum, rate };
            momentum.add_unmodelled(if measurement.has_momentum {
                state.observer.update(config, measurement.elapsed, sample)
            } else {
                state.observer.hold()
            });
        }
        if let Some(config) = &self.config.engines {
            let momentum_share = self.estimator.as_ref().map_or(1.0, |estimator| estimator.momentum_share);
            for (jet, engine) in state.engines.iter_mut().enumerate().take(self.model.jets.len()) {
                let column: Vector6<f64> = momentum.a_t.column(jet).into();
                let measured = (measurement.thrust[jet], measurement.thrust_innovation[jet]);
                let sensor_error =
                    measurement.has_momentum.then(|| sensor_error(&column, &state.observer.residual));
                let is_sensor_wrong =
                    engine.update(config, measurement.elapsed, measured, momentum_share, sensor_error);
                if is_sensor_wrong {
                    state.channels.reject_sensor(jet, engine.deviation);
                    if let Some(estimator) = &mut state.estimator {
                        estimator.correct_thrust(jet, engine.deviation);
                    }
                    *engine = EngineState::default();
                }
            }
            if state.engines.iter().any(EngineState::is_limited) {
                measurement.modes.insert(Modes::ENGINE_LIMITED);
            }
        }
    }

    /// Computes thrust rates and joint velocities that control momentum and attitude.
    fn solve_momentum_qp(&mut self, state: &mut ControllerState, descent: Option<&DescentConfig>) {
        let Terms {
            measurement,
            kinematics,
            dynamics,
            momentum,
            setpoint,
            attitude,
            momentum_qp,
            contact,
            ..
        } = &mut self.terms;
        let (_, moment_estimate) = parts(&momentum.rate_estimate);
        let inertia_0_b = &state.inertia_0_b;
        let gains = descent.map_or(&self.config.momentum, |descent| &descent.momentum);
        if descent.is_some() {
            *setpoint = setpoint.without_place(&kinematics.com);
        }
        *attitude = attitude_demand(
            gains,
            setpoint,
            &measurement.state.base.rotation,
            &measurement.state.base_angular_velocity(),
            &moment_estimate,
            inertia_0_b,
            &inertia_0_b.try_inverse().unwrap_or_else(Matrix3::zeros),
        );
        let inputs = TaskInputs {
            state: &measurement.state,
            thrust: &measurement.thrust[..self.model.jets.len()],
            kinematics,
            dynamics,
            momentum,
            setpoint,
            attitude,
            inertia_0_b,
            posture: &state.posture,
            contact,
            contact_state: &state.contact,
            gains,
        };
        momentum_qp.update(&inputs);
        // If an engine does not reach its thrust, the others take over its share.
        let thrust_ranges = self.model.jets.iter().zip(&state.engines).map(|(jet, engine)| {
            let greatest = engine.range.1.min(jet.thrust_max);
            (engine.range.0.min(greatest), greatest)
        });
        let velocity_max = self.model.joints.iter();
        let velocity_max = velocity_max
            .map(|joint| descent.map_or(joint.velocity_max, |descent| descent.velocity_max(joint)));
        momentum_qp.update_bounds(&inputs, thrust_ranges, velocity_max);

        let answer = self.momentum_solver.solve_from(&mut state.momentum_start, &momentum_qp.problem);
        self.command.momentum_qp = answer;
        self.solution.as_mut_slice().copy_from_slice(self.momentum_solver.x());
        self.command.status =
            if self.command.modes.is_empty() { CommandStatus::Nominal } else { CommandStatus::Degraded };
        if answer.status != QpStatus::Solved {
            self.command.status = CommandStatus::MomentumHeld;
            // Zero rates, as far as the bounds allow.
            self.solution.fill(0.0);
            momentum_qp.problem.clamp(self.solution.as_mut_slice());
        }
        let (jets, unknowns, u) = (self.model.jets.len(), &momentum_qp.unknowns, self.solution.as_slice());
        self.command.thrust_rate.fill(0.0); // also of unused jets, whose rates may have been replaced
        self.command.thrust_rate.as_mut_slice()[..jets].copy_from_slice(&u[unknowns.thrust_rate.clone()]);
        self.command.joint_velocity.copy_from_slice(&u[unknowns.joint_velocity.clone()]);
        contact.store_rate(&mut state.contact, &u[unknowns.force_rate.clone()]);
    }

    /// Acceleration without torques and foot wrenches, `M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a − h)`.
    fn update_free_acceleration(&mut self) {
        let Terms { kinematics, dynamics, inverse_mass, momentum, .. } = &mut self.terms;
        let force = &mut self.free_acceleration;
        force.copy_from(&dynamics.bias);
        force.neg_mut();
        momentum.thrusts.add_generalised_force(kinematics, force);
        if self.config.aero_feedback.torque {
            momentum.aero.add_generalised_force(kinematics, force);
        }
        inverse_mass.update(&dynamics.mass_matrix);
        if inverse_mass.is_known {
            inverse_mass.multiply_in_place(force);
        }
    }

    /// Torques that let the joints follow the commanded velocities.
    fn solve_torque_qp(&mut self, state: &mut ControllerState, descent: Option<&DescentConfig>) {
        let Terms { measurement, inverse_mass, torque_qp, contact, unlimited_torque, .. } = &mut self.terms;
        for (joint, velocity) in measurement.state.joint_velocity().iter().enumerate() {
            self.velocity_error[joint] = velocity - self.command.joint_velocity[joint];
        }
        let answer = if inverse_mass.is_known {
            torque_qp.update(
                contact,
                &state.contact,
                inverse_mass,
                &self.free_acceleration,
                &self.velocity_error,
                &state.velocity_error_integral,
            );
            self.torque_solver.solve_from(&mut state.torque_start, &torque_qp.problem)
        } else {
            QpAnswer::from_status(QpStatus::NotPositiveDefinite)
        };
        self.command.torque_qp = answer;
        if answer.status == QpStatus::Solved {
            let (forces, torques) = self.torque_solver.x().split_at(torque_qp.foot_force.end);
            if state.contact.is_active {
                contact.force_of_torques.copy_from_slice(forces);
            }
            unlimited_torque.copy_from_slice(torques);
            if !state.torque_is_known {
                // The published rate limiter starts from its first input.
                state.joint_torque.copy_from(unlimited_torque);
                state.torque_is_known = true;
            }
            let rate_max =
                self.model.joints.iter().map(|joint| {
                    descent.map_or(joint.torque_rate_max, |descent| descent.torque_rate_max(joint))
                });
            limit_rate(&mut state.joint_torque, unlimited_torque.as_slice(), rate_max, self.time_step);
            self.command.joint_torque.copy_from(&state.joint_torque);
        } else {
            self.command.status = match self.command.status {
                CommandStatus::MomentumHeld => CommandStatus::BothHeld,
                _ => CommandStatus::TorqueHeld,
            };
        }
        // Forward Euler: used first, advanced after. Without a commanded velocity there is no error to integrate; with
        // held torques the integral would grow without effect on the torques.
        if matches!(self.command.status, CommandStatus::Nominal | CommandStatus::Degraded) {
            let integral = state.velocity_error_integral.iter_mut();
            for (integral, error) in integral.zip(&self.velocity_error) {
                *integral = (*integral + self.time_step * error).clamp(-INTEGRAL_LIMIT, INTEGRAL_LIMIT);
            }
        }
    }

    /// Predicts the acceleration under the command, for the channels of the next tick (M101):
    /// `ν̇ = M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a + J_cᵀ f_c + S τ + ŵ − h)`, with the observed wrench `ŵ` on the base.
    fn predict_acceleration(&mut self, state: &mut ControllerState) {
        let Terms { measurement: used, kinematics, inverse_mass, momentum, contact, .. } = &mut self.terms;
        let acceleration = &mut self.acceleration;
        acceleration.fill(0.0);
        if inverse_mass.is_known {
            let wrench = &momentum.unmodelled_wrench;
            let arm = kinematics.com - kinematics.bodies[0].i_from_b.position;
            let (force, moment) = parts(wrench);
            acceleration.fixed_rows_mut::<3>(0).copy_from(&force);
            acceleration.fixed_rows_mut::<3>(3).copy_from(&(moment + arm.cross(&force)));
            acceleration.rows_mut(6, self.command.joint_torque.len()).copy_from(&self.command.joint_torque);
            // The wrenches that keep the feet at rest, because those of an impact last for less than a tick.
            let wrenches = contact.force_of_torques.as_slice().chunks_exact(WRENCH);
            for ((foot, sole), wrench) in self.model.feet.iter().zip(&contact.soles).zip(wrenches) {
                let (body, wrench) = (foot.frame.body, Vector6::from_column_slice(wrench));
                kinematics.add_generalised_wrench(body, &sole.position, &wrench, acceleration);
            }
            inverse_mass.multiply_in_place(acceleration);
            *acceleration += &self.free_acceleration;
        }
        state.channels.acceleration.copy_from(acceleration);
        state.channels.commanded_in.copy_from(&used.state);
        state.channels.joint_torque.copy_from(&self.command.joint_torque);
        state.channels.thrust_rate.copy_from(&self.command.thrust_rate);
        state.channels.foot_wrenches.copy_from(&contact.force_of_torques);
    }

    /// Adds a user-defined objective to the momentum QP; not to be called in a tick.
    ///
    /// # Errors
    /// As [`MomentumQp::add`].
    pub fn add_task(&mut self, task: Arc<dyn Task>) -> Result<(), BuildError> {
        self.terms.momentum_qp.add(task)
    }

    /// Whether a state has the sizes of this controller.
    fn fits(&self, state: &ControllerState) -> bool {
        state.posture.len() == self.model.joints.len()
            && state.momentum_start.len() == self.solution.len()
            && state.contact.force.len() == self.terms.contact.force_of_torques.len()
            && self.channels.fit_state(&state.channels)
            && self.wind_observer.is_some() == state.wind.is_some()
            && match (&self.estimator, &state.estimator) {
                (Some(estimator), Some(memory)) => estimator.fits(memory),
                (estimator, memory) => estimator.is_none() && memory.is_none(),
            }
    }

    /// The command of a tick that cannot act: nothing moves, torques stay.
    fn hold_command(&mut self, status: CommandStatus, modes: Modes) -> &Command {
        self.command.thrust_rate.fill(0.0);
        self.command.joint_velocity.fill(0.0);
        self.command.momentum_qp = QpAnswer::from_status(QpStatus::NonFinite);
        self.command.torque_qp = QpAnswer::from_status(QpStatus::NonFinite);
        self.command.status = status;
        self.command.modes = modes;
        &self.command
    }

    /// The controller's model of the robot; without jets if it does not use them.
    #[must_use]
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// Number of thrusts in a measurement and of thrust rates in a command.
    #[must_use]
    pub fn n_jets(&self) -> usize {
        self.n_jets
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
}
