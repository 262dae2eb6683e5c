//! The controller of one robot, and its tick.

mod act;
mod build;
mod decide;
mod detect;
mod measure;
mod predict;
mod steer;

use super::acting::Acting;
use super::command::{BadCommand, Command};
use super::detect::Detectors;
use super::engine_condition::{EngineCondition, EngineLimits};
use super::estimate::disturbance_observer::{DisturbanceObserverConfig, ObserverState};
use super::estimate::estimator::Estimator;
use super::estimate::joint_tracker::{InnerLoop, JointMeasurement, JointTracker};
use super::estimate::wind_observer::WindObserver;
use super::law::contact::ContactState;
use super::law::momentum::AeroFeedback;
use super::law::momentum_qp::Task;
use super::law::residual::{Policy, Residual};
use super::law::setpoint::{Setpoint, SetpointGenerator};
use super::limits::{Descent, Limits};
use super::measure::channels::Channels;
use super::measure::greatest;
use super::measure::measurement::{BadStart, Estimate, Measurement};
use super::modes::Modes;
use super::mpc::PredictiveLaw;
use super::mpc::horizon::Horizon;
use super::mpc::model::Linearised;
use super::mpc::plan::Plan;
use super::preview::Preview;
use super::state::{ControllerState, Origin, Sizes};
use super::terms::Terms;
use crate::aero::{AeroModel, LinkConventions};
use crate::dynamics::Dynamics;
use crate::error::BuildError;
use crate::float::unusual_mode;
use crate::jets::JetModel;
use crate::kinematics::{Kinematics, RobotState};
use crate::qp::WarmStart;
use crate::robot::RobotModel;
use act::Torques;
use decide::Law;
use nalgebra::{DVector, Matrix3, Vector3};
use std::sync::Arc;

/// The controller of one robot: model, control laws and workspace.
#[derive(Debug)]
pub struct Controller {
    /// Model of the robot; without jets if the controller does not use them.
    model: RobotModel,
    jets: Vec<JetModel>,
    time_step: f64,
    aero: AeroModel,
    conventions: LinkConventions,
    feedback: AeroFeedback,
    channels: Channels,
    estimator: Option<Estimator>,
    wind: Option<WindObserver>,
    observer: Option<DisturbanceObserverConfig>,
    has_feet: bool,
    detectors: Detectors,
    /// What follows from the conditions of the engines.
    engines: EngineLimits,
    /// Limits of the law while nothing is found.
    usual: Limits,
    law: Law,
    policy: Option<Policy>,
    torques: Torques,
    joints: JointTracker,
    /// Ticks of the torques in a tick of the law.
    torque_steps: u32,
    /// The last tick of the law.
    origin: Origin,
    terms: Terms,
    command: Command,
    /// Workspace: a change of the predicted acceleration.
    change: DVector<f64>,
}

/// What a tick is given beside its measurement; by default nothing: it follows the mission.
#[derive(Debug, Clone, Copy, Default)]
pub struct Given<'a> {
    /// Set-point in place of the mission's. An invalid one is ignored ([`Modes::SETPOINT_IGNORED`]), and the robot
    /// brakes from the motion of the last valid one (M115). During a descent set-points are ignored.
    pub setpoint: Option<&'a Setpoint>,
    /// What is known of the future. Set-points or winds of an invalid preview are ignored
    /// ([`Modes::PREVIEW_IGNORED`]).
    pub preview: Preview<'a>,
    /// Residual in place of the policy's. One of another robot's sizes is not used, as is one that is not finite.
    pub residual: Option<&'a Residual<'a>>,
}

impl Controller {
    /// State of a controller whose first tick is that of `measurement`; position, attitude and posture of this
    /// measurement become its reference.
    ///
    /// # Errors
    /// [`BadStart`] for a measurement of another robot, for one that lacks a number other than the wind or has one beyond
    /// its range, where inertia or centre of mass overflow, and in a thread with unusual floating-point modes.
    pub fn start(&mut self, measurement: &Measurement) -> Result<ControllerState, BadStart> {
        if let Some(mode) = unusual_mode() {
            return Err(BadStart::FloatingPoint { mode });
        }
        let sizes = self.sizes();
        let Self { model, law, terms, channels, .. } = self;
        let (jets, feet) = (self.command.thrust_rate.len(), terms.contact.soles.len());
        let estimate = Estimate::new(model, jets, self.time_step);
        let (channels, estimate) = channels.start(measurement, estimate)?;
        let robot = &measurement.state;
        let reference = reference(model, robot, &mut terms.kinematics, &mut terms.dynamics);
        let (com, inertia_0_b) = reference.ok_or(BadStart::SingularInertia)?;
        let joints = model.joints.len();
        Ok(ControllerState {
            sizes,
            estimator: self.estimator.as_ref().map(|of| of.start(&estimate.robot)),
            detectors: self.detectors.start(&estimate),
            estimate,
            channels,
            acting: Acting::new(joints, jets, feet),
            disturbance: self.observer.map(|_| ObserverState::default()),
            wind: self.wind.as_ref().map(WindObserver::start),
            engines: vec![EngineCondition::default(); jets],
            descent: Descent::default(),
            setpoint: law.generator().start(com, &robot.base.rotation),
            posture: robot.joint_position.clone(),
            ground_rise: 0.0,
            stance: stance(&com, robot),
            inertia_0_b,
            velocity_error_integral: DVector::zeros(joints),
            joint_torque: DVector::zeros(joints),
            torque_is_known: false,
            inner_loop: InnerLoop::new(joints),
            contact: ContactState::new(terms.contact.soles.len()),
            residual_observer: None,
            plan: law.predictive().map_or_else(|| Plan::none(0, jets), PredictiveLaw::no_plan),
            momentum_start: WarmStart::cold(terms.momentum_qp.problem.len()),
            torque_start: WarmStart::cold(terms.torque_qp.problem.len()),
        })
    }

    /// One tick, which follows the mission.
    ///
    /// What of the measurement is missing or cannot be right is predicted from what is known
    /// ([`channels`](super::measure::channels)); the command says what. Of a measurement that is not of this robot
    /// everything is missing, and the command holds: thrust rates and joint velocities are zero, torques stay.
    pub fn tick(&mut self, state: &mut ControllerState, measurement: &Measurement) -> &Command {
        self.tick_with(state, measurement, &Given::default())
    }

    /// One tick with what is [`Given`] beside the measurement.
    pub fn tick_with(
        &mut self,
        state: &mut ControllerState,
        measurement: &Measurement,
        given: &Given,
    ) -> &Command {
        if !self.fits(state) {
            return self.refuse_state(state);
        }
        let is_usable = self.measure(measurement, state);
        if state.estimate.modes.contains(Modes::BEGUN_AGAIN) {
            begin_again(&self.model, self.law.generator(), state, &mut self.terms);
        }
        self.find_ground(state);
        let is_valid = self.law.choose_setpoint(state, given.setpoint, &mut self.terms);
        let (preview, has_valid_preview) = given.preview.checked();
        let Self { model, aero, conventions, feedback, .. } = self;
        self.terms.update_model(model, aero, *conventions, *feedback, &state.estimate.robot);
        let descends = state.descent.is_active();
        self.detect(state);
        if descends && !state.descent.is_active() {
            self.law.resume(state, given.setpoint, &mut self.terms);
        }
        let Self { model, aero, law, policy, torques, terms, command, .. } = self;
        command.modes = state.estimate.modes;
        command.modes.insert_if(!is_valid, Modes::SETPOINT_IGNORED);
        command.modes.insert_if(!has_valid_preview, Modes::PREVIEW_IGNORED);
        command.joint_torque.copy_from(&state.joint_torque);
        state.acting.friction.fill(0.0);
        if is_usable {
            law.solve(model, aero, state, &preview, terms, command);
            steer::steer(policy.as_mut(), given.residual, state, terms, command);
            state.inner_loop.modes = command.modes;
            torques.solve(state, terms, command);
        } else {
            command.modes.insert(Modes::MEASUREMENT_IGNORED);
            command.set_hold(command.modes);
            state.inner_loop.modes = command.modes;
        }
        command.set_throttle(&self.jets, &state.estimate, self.time_step);
        self.predict(state);
        let (acceleration, torque) = (&state.acting.acceleration, self.command.joint_torque.as_slice());
        self.origin.advance();
        let robot = &state.estimate.robot.state;
        state.inner_loop.begin(self.origin, robot, torque, acceleration.rows_range(6..));
        &self.command
    }

    /// One tick of the torques between two ticks of the law: joint torques for new measurements of the joints, with
    /// model, thrust rates and joint velocities of the last tick of the law. To be called `controller.torque.steps − 1`
    /// times after each of those, at equal times, with the state of that tick.
    ///
    /// Joints that are not measured are predicted. A tick without an answer of the QP, or with a measurement of other
    /// sizes, keeps the torques and has another mode; the next one is as usual. With the state of another controller, or one with which this
    /// controller did not tick last, the command holds ([`Modes::STATE_IGNORED`]).
    pub fn tick_torques(&mut self, state: &mut ControllerState, measured: &JointMeasurement) -> &Command {
        if !state.inner_loop.origin.is(self.origin) {
            return self.refuse_state(state);
        }
        let Self { torques, joints, terms, command, torque_steps, .. } = self;
        let is_sized =
            [measured.position, measured.velocity].iter().all(|of| of.len() == state.posture.len());
        let nothing = JointMeasurement { position: &[], velocity: &[] };
        joints.update(&mut state.inner_loop, if is_sized { measured } else { &nothing });
        state.inner_loop.ticks += 1;
        command.modes = state.inner_loop.modes;
        command.modes.insert_if(!is_sized, Modes::MEASUREMENT_IGNORED);
        if command.modes.contains(Modes::MEASUREMENT_IGNORED) {
            return &self.command;
        }
        let velocity = std::mem::take(&mut state.inner_loop.velocity);
        torques.solve_again(velocity.as_slice(), state, terms, command);
        state.inner_loop.velocity = velocity;
        let left = torque_steps.saturating_sub(state.inner_loop.ticks);
        let share = f64::from(left) / f64::from(*torque_steps);
        self.change_torques(state, share);
        &self.command
    }

    /// Holds: this state is not the one with which the controller ticks.
    fn refuse_state(&mut self, state: &ControllerState) -> &Command {
        self.command.set_hold(Modes::STATE_IGNORED);
        if state.estimate.robot.thrust.len() == self.n_jets() {
            self.command.set_throttle(&self.jets, &state.estimate, self.time_step);
        }
        &self.command
    }

    /// Checks that a command can act in place of the last one.
    ///
    /// # Errors
    /// [`BadCommand`].
    pub fn check_command(&self, thrust_rate: &[f64], joint_torque: &[f64]) -> Result<(), BadCommand> {
        let is_sized = thrust_rate.len() == self.n_jets() && joint_torque.len() == self.model.joints.len();
        let of_joints = self.model.joints.iter().map(|joint| greatest::TORQUE * joint.torque_max);
        let can_act = joint_torque.iter().zip(of_joints).all(|(torque, most)| torque.abs() <= most);
        let is_accepted = is_sized && can_act && self.channels.accept_rates(thrust_rate);
        if is_accepted { Ok(()) } else { Err(BadCommand) }
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
        self.check_command(thrust_rate, joint_torque)?;
        if !self.fits(state) {
            return Err(BadCommand);
        }
        if !state.inner_loop.origin.is(self.origin) {
            self.origin.advance(); // the model is now that of this state
        }
        self.replace_acting(state, thrust_rate, joint_torque);
        self.command.thrust_rate.copy_from_slice(thrust_rate);
        self.command.joint_torque.copy_from_slice(joint_torque);
        self.command.set_throttle(&self.jets, &state.estimate, self.time_step);
        Ok(())
    }

    /// Adds a user-defined objective to the momentum QP; not to be called in a tick.
    ///
    /// # Errors
    /// As [`MomentumQp::add`].
    pub fn add_task(&mut self, task: Arc<dyn Task>) -> Result<(), BuildError> {
        self.terms.momentum_qp.add(task)
    }

    /// Sets the policy whose residual is added to the answer of the law, or replaces it; not to be called in a tick.
    pub fn set_policy(&mut self, policy: Policy) {
        self.policy = Some(policy);
    }

    /// What its states consist of.
    fn sizes(&self) -> Sizes {
        Sizes {
            joints: self.model.joints.len(),
            jets: self.n_jets(),
            foot_forces: self.terms.contact.force_of_torques.len(),
            unknowns: self.terms.momentum_qp.problem.len(),
            plan: self.law.predictive().map(PredictiveLaw::sizes),
            estimator: self.estimator.as_ref().map(Estimator::sizes),
            observes: [self.observer.is_some(), self.wind.is_some()],
            detectors: self.detectors.sizes(),
        }
    }

    /// Whether a state is one of a controller with the same sizes.
    fn fits(&self, state: &ControllerState) -> bool {
        state.sizes == self.sizes()
    }

    /// The generator of its set-points.
    #[must_use]
    pub fn setpoint_generator(&self) -> &SetpointGenerator {
        self.law.generator()
    }

    /// Linearised model and horizon of the last plan of a predictive law. For benchmarks.
    #[doc(hidden)]
    #[must_use]
    pub fn prediction(&self) -> Option<(&Linearised, &Horizon)> {
        self.law.predictive().map(PredictiveLaw::prediction)
    }

    /// Knots that the nonlinear plan of the last tick expanded. For tests.
    #[doc(hidden)]
    #[must_use]
    pub fn expanded_knots(&self) -> usize {
        self.law.predictive().map_or(0, PredictiveLaw::expanded)
    }

    /// The controller's model of the robot; without jets if it does not use them.
    #[must_use]
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// Number of thrusts in a measurement and of thrust rates in a command.
    #[must_use]
    pub fn n_jets(&self) -> usize {
        self.command.thrust_rate.len()
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

/// Centre of mass, and centroidal inertia in body axes, of the robot in a state; `None` if they overflow or the inertia
/// cannot be inverted.
fn reference(
    model: &RobotModel,
    robot: &RobotState,
    kinematics: &mut Kinematics,
    dynamics: &mut Dynamics,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    kinematics.update(model, robot);
    dynamics.update(model, robot, kinematics);
    let rotation = &robot.base.rotation;
    let (com, inertia) = (kinematics.com, rotation.transpose() * dynamics.centroidal_inertia * rotation);
    inertia.try_inverse()?;
    inertia.iter().chain(&com).all(|x| x.is_finite()).then_some((com, inertia))
}

/// Height of the centre of mass above the base origin of the robot in its posture, upright \[m\]: it may lean.
fn stance(com: &Vector3<f64>, robot: &RobotState) -> f64 {
    robot.base.rotation.column(2).dot(&(com - robot.base.position))
}

/// Takes the measurement of this tick for the reference of the flight, as [`Controller::start`] does (M141).
fn begin_again(
    model: &RobotModel,
    generator: &SetpointGenerator,
    state: &mut ControllerState,
    terms: &mut Terms,
) {
    let Terms { kinematics, dynamics, .. } = terms;
    let robot = &state.estimate.robot.state;
    if let Some((com, inertia_0_b)) = reference(model, robot, kinematics, dynamics) {
        state.setpoint = generator.start(com, &robot.base.rotation);
        state.posture.copy_from(&robot.joint_position);
        (state.setpoint.ground, state.stance) = (f64::NEG_INFINITY, stance(&com, robot));
        state.inertia_0_b = inertia_0_b;
        state.velocity_error_integral.fill(0.0);
        state.torque_is_known = false;
        state.plan.discard();
        state.descent.is_blind = false;
    }
}
