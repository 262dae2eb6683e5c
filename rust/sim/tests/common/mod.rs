//! What several tests start from: the files of `configs/`, random states, batches of flights.

#![allow(dead_code, reason = "no test binary needs everything")]
#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

pub mod counting;
pub mod engines;
pub mod measured;
pub mod network;

#[allow(unused_imports, reason = "no test binary needs everything")]
pub(crate) use measured::{assert_within, difference, relative};

use flight_core::control::estimate::estimator::{EstimatorConfig, FilterConfig};
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::{ControllerState, Given};
use flight_core::spatial::{Pose, rotation_from_wxyz};
use flight_core::{Command, Controller, Measurement, RobotModel, RobotState};
use flight_io::load_robot;
use flight_sim::disturbances::{Outage, OutageChannel, OutageKind};
use flight_sim::{FlightResult, Plant, ScenarioConfig, Sensors, fly_batch, load_scenario};
use nalgebra::{DVector, Vector3};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use std::fmt::Display;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Tick of every flight here \[s\].
pub const TIME_STEP: f64 = 0.01;

/// A file or folder of `configs/`.
pub fn configs(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs").join(name)
}

pub fn robot(name: &str) -> RobotModel {
    load_robot(&configs("robot").join(name).with_extension("toml")).unwrap()
}

/// Two robots that differ in everything: 23 joints and 4 jets, 5 joints and 3 jets.
pub fn both_robots() -> [RobotModel; 2] {
    [robot("ironcub_mk1"), robot("sparrow")]
}

pub fn experiment(name: &str) -> ScenarioConfig {
    load_scenario(&configs("experiments").join(name).with_extension("toml")).unwrap()
}

/// A flight of every controller that `configs/` has: of those whose robot and controller are alike, the first by name.
pub fn every_controller() -> Vec<(String, ScenarioConfig)> {
    let files = std::fs::read_dir(configs("experiments")).unwrap().map(|file| file.unwrap().path());
    let mut names: Vec<_> =
        files.map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    names.sort();
    let mut found: Vec<(String, ScenarioConfig)> = Vec::new();
    for name in names {
        let config = experiment(&name);
        let is_alike = |of: &ScenarioConfig| of.robot == config.robot && of.controller == config.controller;
        if !found.iter().any(|(_, of)| is_alike(of)) {
            found.push((name, config));
        }
    }
    found
}

/// The platform's flight for another robot, without its initial state.
pub fn hover_of(robot: &RobotModel) -> ScenarioConfig {
    let mut scenario = experiment("platform_hover");
    let law = &mut scenario.controller.law;
    let for_each_jet = |number: f64| robot.jets.iter().map(|jet| (jet.name.clone(), number)).collect();
    law.weights.thrust_rate = for_each_jet(0.01);
    law.bounds.thrust_rate_max = for_each_jet(100.0);
    law.posture_gain = robot.groups.iter().map(|group| (group.name.clone(), 20.0)).collect();
    scenario
}

/// A state estimator that takes all measurements alike.
pub fn uniform_estimator(channel: FilterConfig) -> EstimatorConfig {
    EstimatorConfig {
        base_position: channel,
        base_rotation: channel,
        base_linear_velocity: channel,
        base_angular_velocity: channel,
        joint_position: channel,
        joint_velocity: channel,
        thrust: channel,
        ..EstimatorConfig::default()
    }
}

/// Wrenches of feet that carry 200 N each, foot after foot.
pub fn loaded(feet: usize) -> DVector<f64> {
    DVector::from_fn(6 * feet, |row, _| if row % 6 == 2 { 200.0 } else { 0.0 })
}

/// An outage of a whole channel; a wrong one is wrong by 1.
pub fn outage(channel: OutageChannel, kind: OutageKind, start: f64, duration: Option<f64>) -> Outage {
    Outage { channel, jet: None, start, duration, kind, error: 1.0 }
}

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

pub fn random_vector(rng: &mut ChaCha8Rng, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-size..size))
}

/// Zero mean, unit variance.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random_range(-0.5..0.5)).sum()
}

/// Any attitude, joints within ±1.5 rad, velocities up to 3 m/s and 3 rad/s.
pub fn random_state(rng: &mut ChaCha8Rng, robot: &RobotModel) -> RobotState {
    let mut state = RobotState::zero(robot.joints.len());
    let wxyz = [(); 4].map(|()| rng.random_range(-1.0..1.0_f64));
    state.base = Pose { rotation: rotation_from_wxyz(&wxyz), position: random_vector(rng, 2.0) };
    state.joint_position.iter_mut().for_each(|s| *s = rng.random_range(-1.5..1.5));
    state.velocity.iter_mut().for_each(|v| *v = rng.random_range(-3.0..3.0));
    state
}

/// Tick of a flight at a time \[s\].
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few thousand, at least zero")]
pub fn tick_at(time: f64) -> usize {
    (time / TIME_STEP).round() as usize
}

/// The state after moving on for a time at its own velocity.
pub fn move_state(state: &RobotState, time: f64) -> RobotState {
    let mut moved = state.clone();
    moved.advance_pose(time);
    moved
}

/// A measurement in still air, without feet.
pub fn at(time: f64, state: &RobotState, thrust: &[f64]) -> Measurement {
    Measurement { time, state: state.clone(), thrust: thrust.to_vec(), ..Measurement::zero(0, 0, 0) }
}

/// What sensors read of a robot.
pub fn read(sensors: &mut Sensors, state: &RobotState, thrust: &[f64]) -> Measurement {
    let mut said = at(0.0, state, thrust);
    sensors.read(&mut said);
    said
}

/// The refusal has all of these words.
#[track_caller]
pub fn assert_says(refusal: &dyn Display, words: &[&str]) {
    let message = refusal.to_string();
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
}

/// Flies all configurations, on all cores.
pub fn fly(flights: &[ScenarioConfig]) -> Vec<FlightResult> {
    fly_batch(flights, None, || ControlFlow::Continue(()), |result| result).unwrap()
}

/// A controller and the state of its flight, which begins with the first tick.
pub struct Running {
    pub controller: Controller,
    pub state: Option<ControllerState>,
}

impl Running {
    pub fn new(controller: Controller) -> Self {
        Self { controller, state: None }
    }

    pub fn tick(&mut self, measurement: &Measurement) -> &Command {
        self.tick_with(measurement, &Given::default())
    }

    pub fn tick_towards(&mut self, measurement: &Measurement, setpoint: &Setpoint) -> &Command {
        self.tick_with(measurement, &Given { setpoint: Some(setpoint), ..Given::default() })
    }

    pub fn tick_with(&mut self, measurement: &Measurement, given: &Given) -> &Command {
        let Self { controller, state } = self;
        let state = state.get_or_insert_with(|| controller.start(measurement).unwrap());
        controller.tick_with(state, measurement, given)
    }

    pub fn state(&self) -> &ControllerState {
        self.state.as_ref().unwrap()
    }
}

impl std::ops::Deref for Running {
    type Target = Controller;

    fn deref(&self) -> &Controller {
        &self.controller
    }
}

/// Plant and controller of a flight, for tests that want to see inside a tick.
pub struct Loop {
    pub plant: Plant,
    pub controller: Running,
    pub tick: usize,
}

impl Loop {
    pub fn new(config: &ScenarioConfig) -> Self {
        let robot = load_robot(&config.robot).unwrap();
        Self::with_robot(config, robot)
    }

    pub fn with_robot(config: &ScenarioConfig, robot: RobotModel) -> Self {
        let plant =
            Plant::new(robot.clone(), &config.simulator, &config.disturbances, &config.controller.law)
                .unwrap();
        let controller = config.controller(robot).unwrap();
        Self { plant, controller: Running::new(controller), tick: 0 }
    }

    /// Plant and controller see the same state in the same wind.
    pub fn observe(&mut self, wind: &Vector3<f64>) {
        self.plant.observe(wind);
        let time = self.tick as f64 * TIME_STEP;
        let thrust = self.plant.jets().thrust_feedback();
        self.controller.tick(&Measurement { wind: *wind, ..at(time, self.plant.state(), thrust) });
    }

    /// An exact measurement of the plant.
    pub fn sample(&self, wind: Vector3<f64>) -> Measurement {
        let time = self.tick as f64 * TIME_STEP;
        Measurement { wind, ..at(time, self.plant.state(), self.plant.jets().thrust()) }
    }

    /// The plant follows the last command.
    pub fn advance(&mut self, wind: &Vector3<f64>) {
        let command = self.controller.command();
        self.plant.advance(command.joint_torque.as_slice(), command.thrust_rate.as_slice(), wind, TIME_STEP);
        self.tick += 1;
    }

    /// Ticks for some seconds; afterwards plant and controller are between observing and advancing.
    pub fn run(&mut self, seconds: f64, wind: impl Fn(f64) -> Vector3<f64>) {
        let end = self.tick + tick_at(seconds);
        loop {
            let wind = wind(self.tick as f64 * TIME_STEP);
            self.observe(&wind);
            if self.tick == end {
                break;
            }
            self.advance(&wind);
        }
    }
}
