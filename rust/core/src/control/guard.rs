//! The guard of the law: which measurements are used, what replaces the others, and what is known of disturbances,
//! engines and sensors. It consists of the channels of the measurement and the parts that are configured. A part knows
//! nothing of the others: it is given what it reads, and the guard alone writes what it finds into limits, modes and
//! measurement.
//!
//! ```text
//!                 measure                       detect                                 predict
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

pub mod channels;
pub mod engines;
pub mod estimator;
mod feet;
pub mod joints;
pub mod latency;
pub mod observer;
mod prediction;
pub mod supervisor;
pub mod wind_observer;

use super::command::Command;
use super::config::ControllerConfig;
use super::law::contact::ContactState;
use super::law::setpoint::SetpointState;
use super::limits::{JointCondition, Limits};
use super::measurement::{BadStart, Measurement, UsedMeasurement};
use super::modes::Modes;
use super::terms::Terms;
use crate::aero::AeroModel;
use crate::error::BuildError;
use crate::robot::RobotModel;
use crate::timing::Exceeded;
use channels::{Channels, ChannelsState};
use engines::{EngineSample, EngineState, Engines};
use estimator::{Estimator, EstimatorState};
use joints::residual::JointResidual;
use joints::{JointsConfig, JointsState};
use latency::{LatencyMonitor, LatencySample, LatencyState};
use nalgebra::DVector;
use observer::{MomentumSample, ObserverConfig, ObserverState};
use supervisor::{Errors, SupervisorConfig};
use wind_observer::{WindObserver, WindState};

/// The guard of one controller, with its workspace.
#[derive(Debug)]
pub struct Guard {
    channels: Channels,
    wind: Option<WindObserver>,
    has_feet: bool,
    observer: Option<ObserverConfig>,
    engines: Option<Engines>,
    joints: Option<(JointsConfig, JointResidual)>,
    latency: Option<LatencyMonitor>,
    supervisor: Option<SupervisorConfig>,
    estimator: Option<Estimator>,
    time_step: f64,
    /// Limits of the law while nothing is found.
    usual: Limits,
    acceleration: DVector<f64>,
}

/// What the guard keeps from tick to tick; of a part that is not configured, nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct GuardState {
    /// Predictions and acceptance of the measurement's channels.
    pub(super) channels: ChannelsState,
    /// Wind estimate.
    pub(super) wind: Option<WindState>,
    /// The observed wrench, its residual and the last accepted measurement.
    pub(super) observer: Option<ObserverState>,
    /// Monitor state of each engine.
    pub(super) engines: Option<Vec<EngineState>>,
    /// Detection of faulty joints.
    pub(super) joints: Option<JointsState>,
    /// Measurement of latencies.
    pub(super) latency: Option<LatencyState>,
    /// For how long the supervisor's limits have been exceeded.
    pub(super) supervisor: Option<Exceeded>,
    /// State estimator.
    pub(super) estimator: Option<EstimatorState>,
}

impl Guard {
    /// Builds channels and configured parts. They contain the jets also where the law, whose `usual` limits these are,
    /// does not use them.
    ///
    /// # Errors
    /// As the parts.
    pub fn new(
        config: &ControllerConfig,
        robot: &RobotModel,
        aero: &AeroModel,
        usual: &Limits,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        let (of_estimator, dynamics) = (config.estimator.as_ref(), config.jet_dynamics);
        let new = |config| Estimator::new(config, robot.clone(), dynamics, aero.clone(), time_step);
        let estimator = of_estimator.map(new).transpose()?;
        let wind = config.wind_observer.map(|_| WindObserver::new(robot.clone(), aero.clone()));
        config.observer.map_or(Ok(()), |observer| observer.check(time_step))?;
        let shares = estimator.as_ref().map_or([1.0; 2], |estimator| estimator.momentum_shares);
        let engines = config.engines.map(|engines| Engines::new(&engines, usual, robot, shares, dynamics));
        let latency = config.latency_monitor.map(|monitor| {
            let sizes = (robot.joints.len(), robot.jets.len());
            LatencyMonitor::new(monitor, of_estimator, config.torque.steps, sizes.0, sizes.1, time_step)
        });
        let jets = robot.jet_models(dynamics);
        let measures_joint_velocity = of_estimator.is_none_or(|config| config.joint_observer.is_none());
        Ok(Self {
            channels: Channels::new(&config.channels, robot, jets, time_step, measures_joint_velocity),
            wind: wind.transpose()?,
            has_feet: config.contact.is_some(),
            observer: config.observer,
            engines,
            joints: config.joints.map(|joints| (joints, JointResidual::new(robot))),
            latency,
            supervisor: config.supervisor,
            estimator,
            time_step,
            usual: usual.clone(),
            acceleration: DVector::zeros(6 + robot.joints.len()),
        })
    }

    /// State of a flight that starts with this measurement.
    ///
    /// # Errors
    /// As [`Channels::start`].
    pub fn start(&mut self, measurement: &Measurement) -> Result<GuardState, BadStart> {
        let channels = self.channels.start(measurement)?;
        let (robot, thrust) = (measurement.state, self.channels.thrust(&channels));
        Ok(GuardState {
            wind: self.wind.as_ref().map(WindObserver::start),
            observer: self.observer.map(|_| ObserverState::default()),
            engines: self.engines.as_ref().map(Engines::start),
            joints: self.joints.as_ref().map(|_| JointsState::new(&robot.joint_position)),
            latency: self.latency.as_ref().map(|of| of.start(&robot.joint_position, thrust.len())),
            supervisor: self.supervisor.map(|_| Exceeded::default()),
            estimator: self.estimator.as_ref().map(|of| of.start(robot, thrust)),
            channels,
        })
    }

    /// Whether a state has the parts and sizes of this guard.
    #[must_use]
    pub fn fits(&self, state: &GuardState) -> bool {
        fn same<A, B>(part: Option<&A>, state: Option<&B>, fits: impl Fn(&A, &B) -> bool) -> bool {
            part.is_some() == state.is_some() && part.zip(state).is_none_or(|(part, state)| fits(part, state))
        }
        let joints = self.acceleration.len() - 6;
        self.channels.fit_state(&state.channels)
            && self.wind.is_some() == state.wind.is_some()
            && self.observer.is_some() == state.observer.is_some()
            && self.engines.is_some() == state.engines.is_some()
            && same(self.joints.as_ref(), state.joints.as_ref(), |_, state| state.fits(joints))
            && same(self.latency.as_ref(), state.latency.as_ref(), LatencyMonitor::fits)
            && self.supervisor.is_some() == state.supervisor.is_some()
            && same(self.estimator.as_ref(), state.estimator.as_ref(), Estimator::fits)
    }

    /// Processes a measurement and advances the time; returns whether the measurement has the sizes of this robot.
    pub fn measure(&mut self, measurement: &Measurement, state: &mut GuardState, terms: &mut Terms) -> bool {
        let (channels, Terms { estimates, measurement: used, .. }) = (&mut self.channels, terms);
        let is_usable = channels.fit(measurement);
        if is_usable {
            estimates.read(measurement, state.wind.as_ref());
            let measurement = Measurement { wind: estimates.wind, ..*measurement };
            channels.update(&mut state.channels, &measurement, used);
        } else {
            channels.update_unmeasured(&mut state.channels, measurement.time, used);
        }
        let begins_again = used.modes.contains(Modes::BEGUN_AGAIN);
        let has_joints = !used.modes.contains(Modes::JOINTS_PREDICTED);
        let has_thrusts = !used.modes.contains(Modes::THRUST_MODELLED);
        let (position, elapsed) = (&used.state.joint_position, used.elapsed);
        if let Some(joints) = &mut state.joints {
            if begins_again {
                joints.begin_again(position);
            }
            joints.measure(position, has_joints, elapsed);
        }
        if let Some((monitor, latency)) = self.latency.as_ref().zip(state.latency.as_mut()) {
            let position = (has_joints && !begins_again).then_some(position.as_slice());
            let thrust = (has_thrusts && !begins_again).then_some(&used.thrust[..]);
            monitor.measure(latency, position, thrust, elapsed);
        }
        if let Some((estimator, memory)) = self.estimator.as_mut().zip(state.estimator.as_mut()) {
            channels.select_accepted(&state.channels, &mut estimates.reading);
            if used.pause > 0.0 || begins_again {
                memory.restart();
            }
            let (innovation, rate) = (&mut used.thrust_innovation, &mut used.thrust_rate);
            estimator.update(memory, &mut estimates.reading, elapsed, innovation, rate);
            channels.replace(&mut estimates.reading, used);
        }
        is_usable
    }

    /// Compares the model of this tick with its measurement.
    pub fn detect(
        &mut self,
        robot: &RobotModel,
        state: &mut GuardState,
        contact: &mut ContactState,
        followed: &mut SetpointState,
        terms: &mut Terms,
    ) {
        terms.limits.copy_from(&self.usual);
        if self.has_feet {
            self.place_feet(robot, state, contact, followed, terms);
        }
        if let Some((config, observer)) = self.observer.as_ref().zip(state.observer.as_mut()) {
            let Terms { measurement: used, dynamics, momentum, .. } = terms;
            let sample = MomentumSample { momentum: dynamics.momentum, rate: momentum.measured_rate };
            observer.observe(config, used.sampling(), used.elapsed, sample);
            momentum.add_unmodelled(observer.wrench);
        }
        self.limit_thrusts(state, contact, terms);
        self.limit_joints(state, contact, terms);
        self.measure_latency(state, contact, terms);
        let Terms { measurement: used, due, kinematics, dynamics, .. } = terms;
        if let Some((config, exceeded)) = self.supervisor.as_ref().zip(state.supervisor.as_mut()) {
            let errors = Errors::ahead(config.horizon, &used.state, kinematics, dynamics, due);
            if config.update(exceeded, used.elapsed, &errors) {
                used.modes.insert(Modes::STRAYING);
            }
        }
        if let Some(memory) = &mut state.estimator {
            for (jet, error) in used.sensor_error.iter().enumerate() {
                if let Some(error) = error {
                    memory.correct_thrust(jet, *error);
                }
            }
        }
    }

    /// Limits of the thrusts, and sensors that are no longer used.
    fn limit_thrusts(&self, state: &mut GuardState, contact: &ContactState, terms: &mut Terms) {
        let GuardState { engines: found, observer, channels, .. } = state;
        let Some((engines, found)) = self.engines.as_ref().zip(found.as_mut()) else { return };
        let Terms { measurement, momentum, limits, .. } = terms;
        let is_between = measurement.is_between();
        let UsedMeasurement { thrust, thrust_innovation, sensor_error, elapsed, has_momentum, modes, .. } =
            measurement;
        let is_measured = !modes.contains(Modes::THRUST_MODELLED);
        let samples = |jet: usize| EngineSample {
            thrust: thrust[jet],
            innovation: thrust_innovation[jet],
            is_measured,
            is_of_speed: self.channels.is_of_speed[jet],
            command: channels.thrust_rate[jet],
        };
        let residual = observer.as_ref().filter(|_| *has_momentum).map(|of| (&momentum.a_t, &of.residual));
        engines.update(found, *elapsed, samples, residual, is_between && observer.is_some(), sensor_error);
        for (jet, error) in sensor_error.iter().enumerate() {
            if let Some(error) = error {
                self.channels.reject_sensor(channels, jet, *error);
            }
        }
        if found.iter().any(EngineState::is_limited) {
            modes.insert(Modes::ENGINE_LIMITED);
        }
        channels.is_descending |= engines.limit(found, contact.is_active, limits);
    }

    /// Limits of the joints that do not follow their torques.
    fn limit_joints(&mut self, state: &mut GuardState, contact: &ContactState, terms: &mut Terms) {
        let Some((config, model)) = &mut self.joints else { return };
        let Some(joints) = &mut state.joints else { return };
        let (used, last) = (&terms.measurement, &state.channels);
        if used.has_momentum && terms.inverse_mass.is_known && !contact.is_active {
            joints.update(config, &model.sample(terms, last));
        } else {
            joints.interrupt();
        }
        let Terms { measurement: used, limits, .. } = terms;
        limits.joints.copy_from_slice(&joints.found);
        for (joint, found) in joints.found.iter().enumerate() {
            limits.joint_velocity[joint] = found.velocity_max(limits.joint_velocity[joint]);
        }
        if joints.found.iter().any(|found| *found != JointCondition::Healthy) {
            used.modes.insert(Modes::JOINT_LIMITED);
        }
    }

    /// Whether commands are late; the estimator then uses the measured latency of the torques.
    fn measure_latency(&mut self, state: &mut GuardState, contact: &ContactState, terms: &mut Terms) {
        let GuardState { latency, channels: last, estimator, .. } = state;
        let Some((monitor, latency)) = self.latency.as_mut().zip(latency.as_mut()) else { return };
        terms.reduce_torque(last.joint_torque.as_slice());
        let Terms { measurement: used, inverse_mass, limits, acting_torque, .. } = terms;
        let is_comparable = (used.has_momentum || used.is_between())
            && inverse_mass.is_known
            && !contact.is_active
            && !used.modes.contains(Modes::FEET_PREDICTED)
            && !limits.joints.contains(&JointCondition::Stuck);
        let sample = LatencySample {
            acceleration: &last.acceleration.as_slice()[6..],
            gain: &inverse_mass.joint_gain,
            torque: acting_torque,
            thrust_rate: last.thrust_rate.as_slice(),
        };
        monitor.compare(latency, &sample, is_comparable);
        let measured = monitor.measured(latency);
        let late = monitor.are_late(latency, measured, used.elapsed);
        if late.contains(&true) {
            used.modes.insert(Modes::LATE);
        }
        if let (true, Some(estimator), Some(torque)) = (late[0], estimator, measured[0]) {
            estimator.use_torque_latency(torque);
        }
        terms.measured_latency = measured;
    }

    /// Stores what the command of this tick lets expect in the next.
    pub fn predict(
        &mut self,
        robot: &RobotModel,
        state: &mut GuardState,
        terms: &mut Terms,
        command: &Command,
    ) {
        self.predict_acceleration(robot, state, terms, command);
        let Terms { measurement: used, kinematics, dynamics, momentum, contact, acting_torque, .. } = terms;
        if let Some((observer, wind)) = self.wind.as_mut().zip(state.wind.as_mut()) {
            observer.update(wind, used, kinematics, &dynamics.momentum, &momentum.a_t, &contact.soles);
        }
        if let Some(joints) = &mut state.joints {
            joints.command(&command.joint_velocity, self.time_step);
        }
        if let Some(memory) = &mut state.estimator {
            let (rates, torques) = (command.thrust_rate.as_slice(), acting_torque.as_slice());
            let (unmodelled, feet) = (&momentum.unmodelled_wrench, contact.force_of_torques.as_slice());
            memory.command(rates, torques, unmodelled, &used.wind, feet);
        }
    }
}
