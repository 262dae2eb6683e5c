//! The closed-loop flight: the loop that connects plant and controller.
//!
//! At tick k, t = k h:
//!
//! ```text
//! observe   kinematics and aerodynamic forces at x_k in the wind of t
//! control   thrust rates and torques from (x_k, T_k, wind), held until the next tick
//! record    and stop if the flight is lost
//! advance   x_{k+1} from x_k, T_k and the torques;  T_{k+1} = T_k + h Ṫ*
//! ```
//!
//! This is the published order of execution with its unit delays written out: the published physics block is first in a
//! tick and uses the outputs of the tick before. Equation M77 of `docs/model`; the end of a flight is M80.

use crate::config::{
    AeroKinematics, DivergenceConfig, DynamicsBackend, Engine, FallConfig, Integrator, ScenarioConfig,
};
use crate::disturbances::{Disturbances, Outages, Sample, WindEstimator};
use crate::jets::JetsConfig;
use crate::log::FlightLog;
use crate::outcome::{FlightResult, Loss, LossReason, Outcome};
use crate::plant::Plant;
use crate::sensors::Sensors;
use crate::signals::{TickRow, TrackingErrors, WorldRow};
use crate::summary::Summary;
use crate::wind::Wind;
use flight_core::aero::LeverArm;
use flight_core::control::law::between::JointMeasurement;
use flight_core::control::{Controller, ControllerState, Given, Measurement, Modes, Preview};
use flight_core::error::{BuildError, check};
use flight_core::robot::RobotModel;
use flight_io::{load_changed, load_robot};
use nalgebra::{Vector3, Vector6};
use serde::Serialize;
use serde_json::{Value, json};
use std::ops::ControlFlow;
use std::path::Path;

/// A flight that is ready to start.
#[derive(Debug)]
pub struct Scenario {
    plant: Plant,
    controller: Controller,
    wind: Wind,
    /// Wind that the controller receives in place of the simulated one.
    controller_wind: Option<Wind>,
    /// Errors of the measured wind; `None` without errors.
    wind_estimator: Option<WindEstimator>,
    /// Sensors of the robot's state; `None` if they are exact.
    sensors: Option<Sensors>,
    /// Outages of all measurements.
    outages: Outages,
    /// Measurement of a tick.
    sample: Sample,
    /// Thrust rates of the tick \[N/s\].
    thrust_rate: Vec<f64>,
    /// Wrenches of the controller's feet: zero, because there is no ground.
    foot_wrenches: Vec<Vector6<f64>>,
    time_step: f64,
    n_ticks: usize,
    fall: FallConfig,
    divergence: DivergenceConfig,
    course_error: f64,
}

/// A flight was stopped by the caller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

impl Scenario {
    /// Builds plant and controller.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part of the configuration.
    pub fn new(config: &ScenarioConfig) -> Result<Self, BuildError> {
        let robot = load_robot(&config.robot)?;
        Self::with_robot(config, robot)
    }

    /// Builds a flight with a robot that is already loaded; the path in the configuration is not read.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part of the configuration.
    pub fn with_robot(config: &ScenarioConfig, robot: RobotModel) -> Result<Self, BuildError> {
        let time_step = config.simulator.time_step;
        let disturbances = &config.disturbances;
        let torque_steps = config.controller.law.torque.steps;
        let plant = Plant::with_torque_steps(robot.clone(), &config.simulator, disturbances, torque_steps)?;
        if let Some(sensors) = config.simulator.sensors.as_ref().filter(|_| torque_steps > 1) {
            let expected = "0 with controller.torque.steps above 1: joints are measured between two ticks";
            check("simulator.sensors.joints.delay", sensors.joints.delay, |delay| delay == 0.0, expected)?;
        }
        FlightLog::check(&robot, config.simulator.duration, time_step)?;
        let (wind, n_ticks) = (Wind::new(&config.wind)?, config.simulator.n_ticks());
        let controller_wind = disturbances.controller_wind.as_ref();
        let controller_wind =
            controller_wind.map(|wind| Wind::from_table(wind, "disturbances.controller_wind")).transpose()?;
        let given = controller_wind.as_ref().unwrap_or(&wind);
        let estimator = |estimate| {
            let times = (0..=n_ticks).map(|tick| tick as f64 * time_step);
            let sum: Vector3<f64> = times.map(|time| given.velocity(time)).sum();
            WindEstimator::new(estimate, time_step, sum / (n_ticks + 1) as f64)
        };
        let sample = Sample {
            state: plant.state().clone(),
            thrust: plant.jets().thrust_feedback().to_vec(),
            wind: Vector3::zeros(),
        };
        let sensors = config.simulator.sensors.as_ref();
        let sensors = sensors
            .map(|sensors| Sensors::new(sensors, time_step, robot.joints.len(), robot.jets.len()))
            .transpose()?;
        let outages = Outages::new(&disturbances.outages, &robot.jets)?;
        let controller = config.controller(robot)?;
        Ok(Self {
            plant,
            foot_wrenches: vec![Vector6::zeros(); controller.model().feet.len()],
            thrust_rate: vec![0.0; sample.thrust.len()],
            sample,
            sensors,
            wind_estimator: disturbances.wind_estimate.as_ref().map(estimator).transpose()?,
            outages,
            controller,
            wind,
            controller_wind,
            time_step,
            n_ticks,
            fall: config.simulator.fall.clone(),
            divergence: config.simulator.divergence.clone(),
            course_error: config.simulator.course_error,
        })
    }

    /// Checks that the configuration can be flown by its own engine, and returns its [warnings](Self::warnings); reads
    /// the robot's files.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part.
    pub fn check(config: &ScenarioConfig) -> Result<Vec<String>, BuildError> {
        let mut of_this_engine = config.clone();
        match config.engine {
            Engine::Rust => {}
            Engine::Jax => of_this_engine.simulator.dynamics = DynamicsBackend::Tree, // both can be flown
            Engine::Mujoco => {
                check_mujoco(config)?;
                let robot = load_robot(&config.robot)?;
                config.simulator.check(&robot)?;
                // Simulated by MuJoCo only.
                of_this_engine.simulator.ground = None;
                return Self::with_robot(&of_this_engine, robot).map(|scenario| scenario.warnings());
            }
        }
        Self::new(&of_this_engine).map(|scenario| scenario.warnings())
    }

    /// What can be flown but is probably not meant: key, value and what was expected.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let rotation = &self.plant.state().base.rotation;
        let beyond = self.controller.setpoint_generator().pitch_beyond_limits(rotation);
        let warning = beyond.map(|(pitch, [low, high])| {
            format!(
                "simulator.initial.base_rpy_deg has a nose-down pitch of {pitch:.3} deg; expected one within \
                 controller.setpoint.nose_down_limits_deg, {low} to {high}, into which the set-point turns at once"
            )
        });
        warning.into_iter().collect()
    }

    /// Number of ticks after the one at time zero.
    #[must_use]
    pub fn n_ticks(&self) -> usize {
        self.n_ticks
    }

    /// Flies to the end, or until the flight is lost. `progress(tick, n_ticks)` is called every tick and can stop the
    /// flight.
    ///
    /// # Errors
    /// [`Interrupted`] if `progress` stopped the flight.
    pub fn run(
        self,
        mut progress: impl FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<FlightResult, Interrupted> {
        let mut flight = self.begin();
        while !flight.has_ended() {
            let tick = flight.tick;
            if flight.step() && progress(tick, flight.n_ticks()).is_break() {
                return Err(Interrupted);
            }
        }
        Ok(flight.result())
    }

    /// The flight before its first tick.
    #[must_use]
    pub fn begin(self) -> Flight {
        let log = FlightLog::new(self.plant.robot(), self.n_ticks + 1);
        Flight { scenario: self, log, state: None, loss: None, tick: 0 }
    }

    /// Reason why the flight is lost at this tick, if it is.
    fn loss_reason(&self, wind: &Vector3<f64>, errors: &TrackingErrors) -> Option<LossReason> {
        self.divergence(wind).or_else(|| {
            if !errors.rotation.is_finite() || !errors.com.is_finite() {
                Some(LossReason::NotFinite)
            } else if errors.rotation > self.fall.rotation_error_deg.to_radians() {
                Some(LossReason::RotationError(errors.rotation))
            } else if errors.com > self.fall.com_error {
                Some(LossReason::ComError(errors.com))
            } else {
                None
            }
        })
    }

    /// Reason why the state is physically impossible, if it is.
    fn divergence(&self, wind: &Vector3<f64>) -> Option<LossReason> {
        let (state, thrusts, robot) = (self.plant.state(), self.plant.jets().thrust(), self.plant.robot());
        let limits = &self.divergence;
        let is_finite = state.is_finite() && thrusts.iter().chain(wind).all(|number| number.is_finite());
        let speed = state.base_linear_velocity().norm().max(wind.norm());
        let joints = || robot.joints.iter().zip(state.joint_position.iter());
        let excess =
            joints().map(|(joint, position)| (joint.stops.0 - position).max(position - joint.stops.1));
        let excess = excess.fold(f64::NEG_INFINITY, f64::max);
        let fastest =
            state.joint_velocity().iter().fold(0.0, |fastest: f64, velocity| fastest.max(velocity.abs()));
        let is_too_strong = robot
            .jets
            .iter()
            .zip(thrusts)
            .any(|(jet, thrust)| *thrust > limits.thrust_ratio * jet.thrust_max);
        [
            (!is_finite, LossReason::NotFinite),
            (speed > limits.speed, LossReason::Speed(limits.speed)),
            (
                state.base_angular_velocity().norm() > limits.angular_velocity,
                LossReason::AngularVelocity(limits.angular_velocity),
            ),
            (fastest > limits.joint_velocity, LossReason::JointVelocity(limits.joint_velocity)),
            (excess > limits.joint_excess, LossReason::JointPosition(limits.joint_excess)),
            (is_too_strong, LossReason::Thrust(limits.thrust_ratio)),
        ]
        .into_iter()
        .find_map(|(is_beyond, reason)| is_beyond.then_some(reason))
    }
}

/// A flight in progress.
#[derive(Debug)]
pub struct Flight {
    scenario: Scenario,
    log: FlightLog,
    /// `None` before the first tick.
    state: Option<ControllerState>,
    loss: Option<Loss>,
    /// Index of the next tick.
    tick: usize,
}

impl Flight {
    /// Flies one tick; `false` if the flight is lost in it or had ended before.
    pub fn step(&mut self) -> bool {
        if self.has_ended() {
            return false;
        }
        let Scenario {
            plant,
            controller,
            wind,
            controller_wind,
            wind_estimator,
            sensors,
            outages,
            sample,
            foot_wrenches,
            time_step,
            ..
        } = &mut self.scenario;
        let time = self.tick as f64 * *time_step;
        let profile = &*wind;
        let wind = profile.velocity(time);
        plant.observe(&wind);
        let given = controller_wind.as_ref().map_or(wind, |wind| wind.velocity(time));
        let estimate = wind_estimator.as_mut().map_or(given, |estimator| estimator.update(&given));
        let truth = (plant.state(), plant.jets().thrust_feedback());
        let (seen, thrust) = sensors.as_mut().map_or(truth, |sensors| {
            let reading = sensors.read(truth.0, truth.1);
            (&reading.state, &reading.thrust)
        });
        sample.state.copy_from(seen);
        sample.thrust.copy_from_slice(thrust);
        sample.wind = estimate;
        outages.spoil(time, sample);
        let Sample { state: seen, thrust, wind: given } = &*sample;
        let measurement = Measurement { time, state: seen, thrust, wind: *given, foot_wrenches };
        if self.state.is_none() {
            self.state = controller.start(&measurement).ok();
        }
        let Some(state) = &mut self.state else {
            let reason = self.scenario.divergence(&wind).unwrap_or(LossReason::NotFinite);
            self.loss = Some(Loss { time, reason });
            return false;
        };
        let ahead = sensors.as_mut().map_or(&[][..], |sensors| sensors.look_ahead(profile, time));
        let preview = Preview { wind: ahead, ..Preview::default() };
        controller.tick_with(state, &measurement, &Given { preview, ..Given::default() });
        let (terms, command) = (controller.terms(), controller.command());
        if self.tick == 0 || command.modes.contains(Modes::BEGUN_AGAIN) {
            self.log.joint_setpoint = state.posture().as_slice().to_vec();
        }
        let errors = TrackingErrors::new(plant, &terms.setpoint);
        let world = WorldRow { wind, plant, errors };
        self.log.push(&TickRow { measurement, terms, command }, Some(&world));
        self.loss = self.scenario.loss_reason(&wind, &errors).map(|reason| Loss { time, reason });
        if self.loss.is_some() {
            return false;
        }
        let Scenario { plant, controller, sensors, outages, sample, thrust_rate, time_step, .. } =
            &mut self.scenario;
        thrust_rate.copy_from_slice(controller.command().thrust_rate.as_slice());
        let period = *time_step / f64::from(plant.torque_steps());
        plant.advance_in_steps(thrust_rate, &wind, *time_step, |part, robot, torque| {
            if part > 0 {
                let after = f64::from(part) * period;
                let truth = (robot.joint_position.as_slice(), robot.joint_velocity());
                let (position, velocity) =
                    sensors.as_mut().map_or(truth, |sensors| sensors.read_joints(robot, after));
                sample.state.joint_position.as_mut_slice().copy_from_slice(position);
                sample.state.velocity.as_mut_slice()[6..].copy_from_slice(velocity);
                outages.spoil(time + after, sample);
                let position = sample.state.joint_position.as_slice();
                controller.tick_torques(
                    state,
                    &JointMeasurement { position, velocity: sample.state.joint_velocity() },
                );
            }
            torque.copy_from_slice(controller.command().joint_torque.as_slice());
        });
        self.tick += 1;
        true
    }

    /// Whether the last tick has been flown or the flight is lost.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.loss.is_some() || self.tick > self.scenario.n_ticks
    }

    /// Number of ticks after the one at time zero.
    #[must_use]
    pub fn n_ticks(&self) -> usize {
        self.scenario.n_ticks
    }

    /// Log of the ticks flown so far.
    #[must_use]
    pub fn log(&self) -> &FlightLog {
        &self.log
    }

    /// The simulated robot.
    #[must_use]
    pub fn robot(&self) -> &RobotModel {
        self.scenario.plant.robot()
    }

    /// Changes the wind from the next tick on. With `mean_only` the mean remains that of the configured wind.
    pub fn set_wind(&mut self, wind: Wind) {
        self.scenario.wind = wind;
    }

    /// Time and reason of the loss, if the flight was lost.
    #[must_use]
    pub fn loss(&self) -> Option<Loss> {
        self.loss
    }

    /// Figures of merit of the ticks flown so far.
    #[must_use]
    pub fn summary(&self) -> Summary {
        // Physically impossible numbers are in the log, but not in the figures of merit.
        let is_excluded = self.loss.is_some_and(|loss| loss.reason.outcome() == Outcome::Diverged);
        Summary::new(&self.log, self.log.len().saturating_sub(usize::from(is_excluded)))
    }

    /// Outcome of the flight; before its end, as if it ended now.
    #[must_use]
    pub fn outcome(&self, summary: &Summary) -> Outcome {
        let is_off_course = summary.max_com_error > self.scenario.course_error;
        let flown = if is_off_course { Outcome::OffCourse } else { Outcome::Completed };
        self.loss.map_or(flown, |loss| loss.reason.outcome())
    }

    /// Result of the flight.
    #[must_use]
    pub fn result(self) -> FlightResult {
        let summary = self.summary();
        FlightResult { outcome: self.outcome(&summary), loss: self.loss, log: self.log, summary }
    }
}

/// As [`load_scenario`](crate::load_scenario), with `changes` of dotted keys, and with a check that its engine can fly
/// it, which returns [warnings](Scenario::warnings).
///
/// # Errors
/// As [`load_changed`] and [`Scenario::check`].
pub fn load_flyable(
    path: &Path,
    changes: &[(String, Value)],
) -> Result<(ScenarioConfig, Vec<String>), BuildError> {
    let mut warnings = Vec::new();
    let check = |config: &_| Scenario::check(config).map(|found| warnings = found);
    load_changed(path, changes, check).map(|config| (config, warnings))
}

/// Refuses what MuJoCo does not simulate.
fn check_mujoco(config: &ScenarioConfig) -> Result<(), BuildError> {
    let ScenarioConfig { simulator, disturbances, .. } = config;
    if simulator.ground.is_none() {
        let expected = "a table, as in configs/experiments/take_off.toml: engine = \"mujoco\" flies nothing that \
                        has no ground under it; \"rust\" and \"jax\" do";
        return Err(BuildError::bad_value("simulator.ground", "absent", expected));
    }
    if config.controller.law.contact.is_none() {
        let expected = "a table: without feet the controller cannot stand on simulator.ground";
        return Err(BuildError::bad_value("controller.contact", "absent", expected));
    }
    let (initial, none) = (&simulator.initial, Disturbances::default());
    check_only("simulator.integrator", &simulator.integrator, &Integrator::default())?;
    check_only("simulator.lever_arm", &simulator.lever_arm, &LeverArm::default())?;
    check_only("simulator.kinematics", &simulator.kinematics, &AeroKinematics::default())?;
    check_only("simulator.jets.dynamics", &simulator.jets.dynamics(), &JetsConfig::Ideal {}.dynamics())?;
    check_only("simulator.initial.base_velocity", &initial.base_velocity, &[0.0; 6])?;
    check_only("simulator.initial.free_fall_tick", &initial.free_fall_tick, &false)?;
    if let Some(motors) = &simulator.motors {
        check_only("simulator.motors.time_constant", &motors.time_constant, &0.0)?;
        check_only("simulator.motors.elasticity", &motors.elasticity, &None)?;
    }
    check_only("simulator.fuel", &simulator.fuel, &None)?;
    check_only("simulator.sensors", &simulator.sensors, &None)?;
    check_only("simulator.actuation", &simulator.actuation, &None)?;
    check_only("controller.torque.steps", &config.controller.law.torque.steps, &1)?;
    check_only("disturbances.wind_estimate", &disturbances.wind_estimate, &none.wind_estimate)?;
    check_only("disturbances.aero", &disturbances.aero, &none.aero)?;
    check_only("disturbances.jets", &disturbances.jets, &none.jets)?;
    check_only("disturbances.joints", &disturbances.joints, &none.joints)?;
    check_only("disturbances.outages", &disturbances.outages, &none.outages)?;
    check_only("disturbances.pushes", &disturbances.pushes, &none.pushes)
}

/// Refuses every value but the one that MuJoCo simulates.
fn check_only<T: PartialEq + Serialize>(key: &str, value: &T, simulated: &T) -> Result<(), BuildError> {
    if value == simulated {
        return Ok(());
    }
    let simulated = match json!(simulated) {
        Value::Null => "none".to_owned(),
        simulated => simulated.to_string(),
    };
    let expected = format!("{simulated}: engine = \"mujoco\" simulates nothing else");
    Err(BuildError::bad_value(key, json!(value), expected))
}
