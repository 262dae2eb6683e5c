//! The guard of a controller: the channels of the measurement, and the stages that are configured.
//!
//! ```text
//!                 measure                       judge                                  predict
//! channels        missing values predicted                                             acceleration (M101)
//! wind_observer   its wind, for the measured                                           the next wind
//! feet                                          whether they carry load, M114
//! observer                                      unmodelled wrench of the momentum
//! engines                                       limits of thrusts, wrong sensors
//! joints          length of their ways          which do not follow their torques      commanded displacements
//! latency         measured joints and thrusts   whether commands are late
//! supervisor                                    whether the flight strays
//! estimator       its state, for the measured   without what wrong sensors measured    stores the command
//! ```

use super::channels::{Channels, ChannelsState};
use super::engines::{EngineSample, EngineState, Engines};
use super::estimator::Estimator;
use super::joints::{self, JointsConfig, JointsState};
use super::latency::{self, LatencyMonitor};
use super::observer::{ObserverConfig, ObserverState, Sample};
use super::supervisor::{Errors, SupervisorConfig};
use super::wind_observer::WindObserver;
use crate::control::command::Command;
use crate::control::law::contact::{WRENCH, add_wrenches};
use crate::control::law::limits::{JointCondition, Limits};
use crate::control::measurement::{BadStart, Measurement, UsedMeasurement};
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::kinematics::RobotState;
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{DVector, Vector6};
use std::fmt::Debug;

/// What the stages work on in a tick.
#[derive(Debug)]
pub struct Tick<'a> {
    /// The controller's model of the robot.
    pub robot: &'a RobotModel,
    /// Channels of the measurement.
    pub channels: &'a mut Channels,
    /// State of the controller.
    pub state: &'a mut ControllerState,
    /// Values of the tick as far as they are computed.
    pub terms: &'a mut Terms,
}

/// An optional part of the guard. A tick calls it in three places; where a stage has no function, it does nothing.
pub trait Stage: Debug + Send + Sync {
    /// Name of the stage, unique within a controller.
    fn name(&self) -> &'static str;
    /// Sets the stage's own part of the state of a controller that starts in `robot` with these thrusts \[N\].
    fn start(&self, _state: &mut ControllerState, _robot: &RobotState, _thrust: &[f64]) {}
    /// Whether its part of a state has the sizes of this stage.
    fn fits(&self, _state: &ControllerState) -> bool {
        true
    }
    /// Before the model is computed: improves the measurement.
    fn measure(&mut self, _tick: &mut Tick) {}
    /// After the model: compares it with the measurement.
    fn judge(&mut self, _tick: &mut Tick) {}
    /// After the command: what it lets expect, for the next tick.
    fn predict(&mut self, _tick: &mut Tick, _command: &Command) {}
}

/// Channels and stages of one controller, with their workspace.
#[derive(Debug)]
pub struct Guard {
    channels: Channels,
    /// In the order of the list above.
    stages: Vec<Box<dyn Stage>>,
    /// Limits of the law while the stages find nothing.
    usual: Limits,
    acceleration: DVector<f64>,
}

impl Guard {
    /// A guard with these stages, in the order in which a tick calls them; `usual` are the limits of the law while they
    /// find nothing.
    #[must_use]
    pub fn new(channels: Channels, stages: Vec<Box<dyn Stage>>, usual: Limits, robot: &RobotModel) -> Self {
        Self { channels, stages, usual, acceleration: DVector::zeros(6 + robot.joints.len()) }
    }

    /// Names of the stages.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.stages.iter().map(|stage| stage.name())
    }

    /// Channels of a controller that starts with this measurement.
    ///
    /// # Errors
    /// As [`Channels::start`].
    pub fn start_channels(&mut self, measurement: &Measurement) -> Result<ChannelsState, BadStart> {
        self.channels.start(measurement)
    }

    /// Sets the parts of the stages in the state of a controller that starts in `robot`.
    pub fn start(&self, state: &mut ControllerState, robot: &RobotState) {
        let thrust = self.channels.thrust(&state.channels).to_vec();
        state.stages = self.names().collect();
        for stage in &self.stages {
            stage.start(state, robot, &thrust);
        }
    }

    /// Whether a state has the parts and sizes of this guard.
    #[must_use]
    pub fn fits(&self, state: &ControllerState) -> bool {
        self.channels.fit_state(&state.channels)
            && self.names().eq(state.stages.iter().copied())
            && self.stages.iter().all(|stage| stage.fits(state))
    }

    /// Processes a measurement and advances the time; returns whether the measurement has the sizes of this robot.
    pub fn measure(
        &mut self,
        measurement: &Measurement,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
    ) -> bool {
        let Self { channels, stages, .. } = self;
        let is_usable = channels.fit(measurement);
        if is_usable {
            terms.estimates.read(measurement, state.wind.as_ref());
            let measurement = Measurement { wind: terms.estimates.wind, ..*measurement };
            channels.update(&mut state.channels, &measurement, &mut terms.measurement);
        } else {
            channels.update_unmeasured(&mut state.channels, measurement.time, &mut terms.measurement);
        }
        let mut tick = Tick { robot, channels, state, terms };
        for stage in stages {
            stage.measure(&mut tick);
        }
        is_usable
    }

    /// Compares the model of this tick with its measurement.
    pub fn judge(&mut self, robot: &RobotModel, state: &mut ControllerState, terms: &mut Terms) {
        terms.limits.copy_from(&self.usual);
        let mut tick = Tick { robot, channels: &mut self.channels, state, terms };
        for stage in &mut self.stages {
            stage.judge(&mut tick);
        }
    }

    /// Stores what the command of this tick lets expect in the next.
    pub fn predict(
        &mut self,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
        command: &Command,
    ) {
        self.predict_acceleration(robot, state, terms, command);
        let mut tick = Tick { robot, channels: &mut self.channels, state, terms };
        for stage in &mut self.stages {
            stage.predict(&mut tick, command);
        }
    }

    /// Predicts the acceleration under the command, for the channels of the next tick (M101):
    /// `ν̇ = M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a + J_cᵀ f_c + S τ + ŵ − h)`, with the observed wrench `ŵ` on the base.
    fn predict_acceleration(
        &mut self,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
        command: &Command,
    ) {
        terms.reduce_torque(command.joint_torque.as_slice());
        let Terms { measurement, kinematics, inverse_mass, free_acceleration, momentum, contact, .. } = terms;
        let (acceleration, acting) = (&mut self.acceleration, &terms.acting_torque);
        acceleration.fill(0.0);
        if inverse_mass.is_known {
            let wrench = &momentum.unmodelled_wrench;
            let arm = kinematics.com - kinematics.bodies[0].i_from_b.position;
            let (force, moment) = parts(wrench);
            acceleration.fixed_rows_mut::<3>(0).copy_from(&force);
            acceleration.fixed_rows_mut::<3>(3).copy_from(&(moment + arm.cross(&force)));
            acceleration.rows_mut(6, acting.len()).copy_from(acting);
            // The wrenches that keep the feet at rest, because those of an impact last for less than a tick.
            let wrenches = contact.force_of_torques.as_slice().chunks_exact(WRENCH);
            for ((foot, sole), wrench) in robot.feet.iter().zip(&contact.soles).zip(wrenches) {
                let (body, wrench) = (foot.frame.body, Vector6::from_column_slice(wrench));
                kinematics.add_generalised_wrench(body, &sole.position, &wrench, acceleration);
            }
            inverse_mass.multiply_in_place(acceleration);
            *acceleration += &*free_acceleration;
        }
        let known = &mut state.channels;
        known.acceleration.copy_from(acceleration);
        known.commanded_in.copy_from(&measurement.state);
        known.joint_torque.copy_from(&command.joint_torque);
        known.thrust_rate.copy_from(&command.thrust_rate);
        known.foot_wrenches.copy_from(&contact.force_of_torques);
    }

    /// Corrects what was predicted: the torques of `command` act for a `share` of the tick in place of the last ones.
    pub fn change_torques(
        &mut self,
        state: &mut ControllerState,
        terms: &mut Terms,
        command: &Command,
        share: f64,
    ) {
        let ControllerState { channels: last, between, estimator, contact, .. } = state;
        let is_used = terms.inverse_mass.is_known && !contact.is_active; // under load, as in `replace_command`
        let change = &mut self.acceleration;
        change.fill(0.0);
        for (joint, torque) in command.joint_torque.iter().enumerate() {
            let more = torque - between.torque[joint];
            between.torque[joint] = *torque;
            if is_used {
                last.joint_torque[joint] += share * more;
                change[6 + joint] = terms.limits.joints[joint].share() * more;
            }
        }
        if !is_used {
            return;
        }
        terms.inverse_mass.multiply_in_place(change);
        last.acceleration.axpy(share, change, 1.0);
        between.acceleration += change.rows_range(6..);
        if let Some(memory) = estimator {
            terms.reduce_torque(last.joint_torque.as_slice());
            memory.replace_command(last.thrust_rate.as_slice(), terms.acting_torque.as_slice());
        }
    }

    /// Corrects what was predicted: other thrust rates \[N/s\] and torques \[N m\] than those of the last command act. While
    /// the feet carry load, other torques change the load on the feet more than the motion of the robot: only the
    /// thrust rates are used.
    pub fn replace_command(
        &mut self,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
        thrust_rate: &[f64],
        joint_torque: &[f64],
    ) {
        let Terms { kinematics, dynamics, inverse_mass, limits, .. } = terms;
        let (last, acceleration) = (&mut state.channels, &mut self.acceleration);
        if !state.contact.is_active {
            // ν̇ is linear in the torques: it changes by M⁻¹ S (τ′ − τ). The state may be that of another tick than the
            // controller's last one.
            kinematics.update(robot, &last.commanded_in);
            dynamics.update(robot, &last.commanded_in, kinematics);
            inverse_mass.update(&dynamics.mass_matrix);
            if inverse_mass.is_known {
                acceleration.fill(0.0);
                let torques = joint_torque.iter().zip(&last.joint_torque).zip(&limits.joints);
                for (entry, ((new, old), found)) in acceleration.as_mut_slice()[6..].iter_mut().zip(torques) {
                    *entry = found.share() * (new - old);
                }
                inverse_mass.multiply_in_place(acceleration);
                last.acceleration += &*acceleration;
            }
            last.joint_torque.copy_from_slice(joint_torque);
        }
        last.thrust_rate.copy_from_slice(thrust_rate);
        state.between.replace_torque(joint_torque, last.acceleration.rows_range(6..));
        if let Some(memory) = &mut state.estimator {
            terms.reduce_torque(last.joint_torque.as_slice());
            memory.replace_command(last.thrust_rate.as_slice(), terms.acting_torque.as_slice());
        }
    }
}

impl Stage for WindObserver {
    fn name(&self) -> &'static str {
        "wind observer"
    }

    fn start(&self, state: &mut ControllerState, _: &RobotState, _: &[f64]) {
        state.wind = Some(WindObserver::start(self));
    }

    fn predict(&mut self, tick: &mut Tick, _: &Command) {
        let Terms { measurement, kinematics, dynamics, momentum, contact, .. } = &*tick.terms;
        if let Some(wind) = &mut tick.state.wind {
            self.update(wind, measurement, kinematics, &dynamics.momentum, &momentum.a_t, &contact.soles);
        }
    }
}

/// Decides whether the feet carry load, and adds them to the momentum.
#[derive(Debug, Clone)]
pub struct Feet {
    /// Time between two ticks \[s\].
    pub time_step: f64,
}

impl Stage for Feet {
    fn name(&self) -> &'static str {
        "feet"
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { contact: feet, channels, observer, setpoint: following, .. } = &mut *tick.state;
        let Terms { measurement, setpoint, kinematics, dynamics, momentum, contact, .. } = &mut *tick.terms;
        let climb = setpoint.com_position.z - kinematics.com.z;
        // During a descent the robot must not take off.
        let climb = if channels.is_descending { climb.min(0.0) } else { climb };
        let are_measured = !measurement.modes.contains(Modes::FEET_PREDICTED);
        let unmodelled = observer.wrench[2] + observer.residual[2];
        let carry_unknown = contact.carry_unknown(feet, are_measured, climb, unmodelled, measurement.elapsed);
        if carry_unknown {
            // The observed wrench is the load of the feet.
            *observer = ObserverState::default();
            if are_measured {
                tick.channels.reject_feet(channels, measurement);
            }
        }
        contact.update(
            feet,
            tick.robot,
            kinematics,
            dynamics,
            &measurement.foot_wrenches,
            climb,
            -momentum.rate_estimate[2],
            carry_unknown,
            self.time_step,
        );
        contact.force_of_torques.copy_from(&feet.force);
        // Predicted wrenches of loaded feet are not a measurement of the acting forces.
        measurement.has_momentum &= !(feet.is_active && measurement.modes.contains(Modes::FEET_PREDICTED));
        add_wrenches(
            &contact.soles,
            &measurement.foot_wrenches,
            &kinematics.com,
            &mut momentum.measured_rate,
        );
        if feet.is_active {
            momentum.add_contact(tick.robot, kinematics, dynamics, &contact.soles, &feet.force);
            if let Some(height) = contact.stand_height() {
                following.keep_above(kinematics.com.z - height);
            }
        }
    }
}

impl Stage for ObserverConfig {
    fn name(&self) -> &'static str {
        "observer"
    }

    fn judge(&mut self, tick: &mut Tick) {
        let (observer, Terms { measurement, dynamics, momentum, .. }) =
            (&mut tick.state.observer, &mut *tick.terms);
        let sample = Sample { momentum: dynamics.momentum, rate: momentum.measured_rate };
        momentum.add_unmodelled(if measurement.has_momentum {
            observer.update(self, measurement.elapsed, sample)
        } else {
            observer.hold()
        });
    }
}

impl Stage for Engines {
    fn name(&self) -> &'static str {
        "engines"
    }

    fn start(&self, state: &mut ControllerState, _: &RobotState, _: &[f64]) {
        state.engines = Engines::start(self);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { engines, observer, channels, contact, .. } = &mut *tick.state;
        let Terms { measurement, momentum, limits, .. } = &mut *tick.terms;
        let UsedMeasurement { thrust, thrust_innovation, sensor_error, elapsed, has_momentum, modes, .. } =
            &mut *measurement;
        let is_measured = !modes.contains(Modes::THRUST_MODELLED);
        let samples = |jet: usize| EngineSample {
            thrust: thrust[jet],
            innovation: thrust_innovation[jet],
            is_measured,
            command: channels.thrust_rate[jet],
        };
        let residual = has_momentum.then_some((&momentum.a_t, &observer.residual));
        self.update(engines, *elapsed, samples, residual, sensor_error);
        for (jet, error) in sensor_error.iter().enumerate() {
            if let Some(error) = error {
                tick.channels.reject_sensor(channels, jet, *error);
            }
        }
        if engines.iter().any(EngineState::is_limited) {
            measurement.modes.insert(Modes::ENGINE_LIMITED);
        }
        channels.is_descending |= self.limit(engines, contact.is_active, limits);
    }
}

/// Finds joints that do not follow their torques, and bounds what the law demands of them.
#[derive(Debug, Clone)]
pub struct Joints {
    config: JointsConfig,
    time_step: f64,
    /// Residual of the moment beyond which something pushes the robot \[N m\].
    moment_max: f64,
    /// Stops of the joints, lower and upper \[rad, m\].
    stops: Vec<(f64, f64)>,
    unexplained: DVector<f64>,
}

impl Joints {
    /// The stage for the joints of `robot`, with ticks every `time_step` \[s\], beside this observer.
    #[must_use]
    pub fn new(
        config: JointsConfig,
        observer: Option<&ObserverConfig>,
        robot: &RobotModel,
        time_step: f64,
    ) -> Self {
        let stops: Vec<_> = robot.joints.iter().map(|joint| joint.stops).collect();
        let moment_max = observer.map_or(f64::INFINITY, |observer| joints::PUSH_SHARE * observer.moment_max);
        Self { config, time_step, moment_max, unexplained: DVector::zeros(stops.len()), stops }
    }
}

impl Stage for Joints {
    fn name(&self) -> &'static str {
        "joints"
    }

    fn start(&self, state: &mut ControllerState, robot: &RobotState, _: &[f64]) {
        state.joints = Some(JointsState::new(&robot.joint_position));
    }

    fn fits(&self, state: &ControllerState) -> bool {
        state.joints.as_ref().is_some_and(|joints| joints.fits(self.unexplained.len()))
    }

    fn measure(&mut self, tick: &mut Tick) {
        let Some(joints) = &mut tick.state.joints else { return };
        let used = &tick.terms.measurement;
        if used.modes.contains(Modes::BEGUN_AGAIN) {
            joints.begin_again(&used.state.joint_position);
        }
        let is_measured = !used.modes.contains(Modes::JOINTS_PREDICTED);
        joints.measure(&used.state.joint_position, is_measured, used.elapsed);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { joints, engines, channels, contact, observer, velocity_error_integral, .. } =
            &mut *tick.state;
        let Some(joints) = joints else { return };
        let Terms { measurement: used, inverse_mass, limits, .. } = &mut *tick.terms;
        let is_comparable = used.has_momentum && inverse_mass.is_known && !contact.is_active;
        let is_pushed = parts(&observer.residual).1.norm() > self.moment_max;
        if is_comparable && !is_pushed && !engines.iter().any(|engine| engine.is_doubted) {
            let last = channels.commanded_in.joint_velocity();
            let predicted = channels.acceleration.rows(6, self.unexplained.len());
            for (joint, velocity) in used.state.joint_velocity().iter().enumerate() {
                self.unexplained[joint] = (velocity - last[joint]) / used.elapsed - predicted[joint];
            }
            joints.judge(
                &self.config,
                &joints::Sample {
                    dt: used.elapsed,
                    unexplained: &self.unexplained,
                    gain: &inverse_mass.joint_gain,
                    torque: &channels.joint_torque,
                    stops: &self.stops,
                },
            );
        } else {
            joints.hold();
        }
        limits.joints.copy_from_slice(&joints.found);
        for (joint, found) in joints.found.iter().enumerate() {
            limits.joint_velocity[joint] = found.velocity_max(limits.joint_velocity[joint]);
            if matches!(found, JointCondition::Stuck | JointCondition::Free) {
                velocity_error_integral[joint] = 0.0; // it follows no velocity
            }
        }
        used.modes.insert(joints::modes(&joints.found));
    }

    fn predict(&mut self, tick: &mut Tick, command: &Command) {
        if let Some(joints) = &mut tick.state.joints {
            joints.command(&command.joint_velocity, self.time_step);
        }
    }
}

impl Stage for LatencyMonitor {
    fn name(&self) -> &'static str {
        "latency"
    }

    fn start(&self, state: &mut ControllerState, robot: &RobotState, thrust: &[f64]) {
        state.latency = Some(LatencyMonitor::start(self, &robot.joint_position, thrust.len()));
    }

    fn fits(&self, state: &ControllerState) -> bool {
        state.latency.as_ref().is_some_and(|latency| LatencyMonitor::fits(self, latency))
    }

    fn measure(&mut self, tick: &mut Tick) {
        let Some(latency) = &mut tick.state.latency else { return };
        let used = &tick.terms.measurement;
        let accepted = |mode| !used.modes.contains(mode) && !used.modes.contains(Modes::BEGUN_AGAIN);
        let position = accepted(Modes::JOINTS_PREDICTED).then(|| used.state.joint_position.as_slice());
        let thrust = accepted(Modes::THRUST_MODELLED).then_some(&used.thrust[..]);
        LatencyMonitor::measure(self, latency, position, thrust, used.elapsed);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { latency, channels, contact, .. } = &mut *tick.state;
        let Some(latency) = latency else { return };
        tick.terms.reduce_torque(channels.joint_torque.as_slice());
        let Terms { measurement: used, inverse_mass, limits, acting_torque, .. } = &mut *tick.terms;
        let is_comparable = used.has_momentum
            && inverse_mass.is_known
            && !contact.is_active
            && !used.modes.contains(Modes::FEET_PREDICTED)
            && !limits.joints.contains(&JointCondition::Stuck);
        let sample = latency::Sample {
            acceleration: &channels.acceleration.as_slice()[6..],
            gain: &inverse_mass.joint_gain,
            torque: acting_torque,
            thrust_rate: channels.thrust_rate.as_slice(),
        };
        self.compare(latency, &sample, is_comparable);
        let measured = self.measured(latency);
        if self.is_late(latency, measured, used.elapsed) {
            used.modes.insert(Modes::LATE);
        }
        tick.terms.measured_latency = measured;
    }
}

impl Stage for SupervisorConfig {
    fn name(&self) -> &'static str {
        "supervisor"
    }

    fn judge(&mut self, tick: &mut Tick) {
        let Terms { measurement, due, kinematics, dynamics, .. } = &mut *tick.terms;
        let errors = Errors::ahead(self.horizon, &measurement.state, kinematics, dynamics, due);
        if self.update(&mut tick.state.exceeded, measurement.elapsed, &errors) {
            measurement.modes.insert(Modes::STRAYING);
            tick.state.channels.is_descending |= self.descend;
        }
    }
}

impl Stage for Estimator {
    fn name(&self) -> &'static str {
        "estimator"
    }

    fn start(&self, state: &mut ControllerState, robot: &RobotState, thrust: &[f64]) {
        state.estimator = Some(Estimator::start(self, robot, thrust));
    }

    fn fits(&self, state: &ControllerState) -> bool {
        state.estimator.as_ref().is_some_and(|memory| Estimator::fits(self, memory))
    }

    fn measure(&mut self, tick: &mut Tick) {
        let (Some(memory), channels) = (&mut tick.state.estimator, &mut *tick.channels) else { return };
        let Terms { estimates, measurement: used, .. } = &mut *tick.terms;
        channels.select_accepted(&tick.state.channels, &mut estimates.reading);
        if used.pause > 0.0 || used.modes.contains(Modes::BEGUN_AGAIN) {
            memory.restart();
        }
        self.update(memory, &mut estimates.reading, used.elapsed, &mut used.thrust_innovation);
        channels.replace(&mut estimates.reading, used);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let Some(memory) = &mut tick.state.estimator else { return };
        for (jet, error) in tick.terms.measurement.sensor_error.iter().enumerate() {
            if let Some(error) = error {
                memory.correct_thrust(jet, *error);
            }
        }
    }

    fn predict(&mut self, tick: &mut Tick, command: &Command) {
        let Some(memory) = &mut tick.state.estimator else { return };
        let Terms { momentum, measurement: used, contact, acting_torque, .. } = &*tick.terms;
        memory.command(
            command.thrust_rate.as_slice(),
            acting_torque.as_slice(),
            &momentum.unmodelled_wrench,
            &used.wind,
            contact.force_of_torques.as_slice(),
        );
    }
}
