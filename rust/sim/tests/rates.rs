//! Torques that are computed more often than the momentum law decides.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_says, assert_within, at, experiment, robot};
use flight_core::Controller;
use flight_core::control::estimate::estimator::{EstimatorConfig, LatencyConfig};
use flight_core::control::estimate::joint_tracker::{InnerLoop, JointMeasurement, JointTracker};
use flight_core::control::measure::channels::ChannelsConfig;
use flight_core::control::{ControllerState, Modes};
use flight_sim::sensors::EncoderConfig;
use flight_sim::{ActuationConfig, Outcome, Scenario, ScenarioConfig, SensorsConfig};
use std::ops::ControlFlow;

const PERIOD: f64 = 0.001;

/// Position and velocity of a joint at rest after one update from these, whose measurements are zero.
fn updated(tracker: &JointTracker, position: f64, velocity: f64, measured: [f64; 2]) -> [f64; 2] {
    let mut joints = InnerLoop::new(1);
    (joints.position[0], joints.velocity[0]) = (position, velocity);
    let [at, speed] = measured;
    tracker.update(&mut joints, &JointMeasurement { position: &[at], velocity: &[speed] });
    [joints.position[0], joints.velocity[0]]
}

/// Errors of a joint whose position alone is measured decay with two equal poles.
#[test]
fn positions_alone_find_the_velocities() {
    let time = 0.02;
    let config = EstimatorConfig { joint_observer: Some(time), ..EstimatorConfig::default() };
    let tracker = JointTracker::new(Some(&config), ChannelsConfig::default(), PERIOD);
    let [a, c] = updated(&tracker, 1.0, 0.0, [0.0, f64::NAN]);
    let [b, d] = updated(&tracker, 0.0, 1.0, [0.0, f64::NAN]);
    let pole = (-PERIOD / time).exp();
    assert_within!((a + d - 2.0 * pole).abs(), 1e-12, because "rounding");
    assert_within!((a * d - b * c - pole * pole).abs(), 1e-12, because "rounding");
}

#[test]
fn what_is_not_measured_is_predicted() {
    let tracker = JointTracker::new(None, ChannelsConfig::default(), PERIOD);
    assert_eq!(updated(&tracker, 1.0, 2.0, [3.0, 4.0]), [3.0, 4.0]);
    assert_eq!(updated(&tracker, 1.0, 2.0, [f64::NAN, 1e300]), [1.0 + PERIOD * 2.0, 2.0]);
    let mut joints = InnerLoop::new(1);
    joints.acceleration[0] = 5.0;
    tracker.update(&mut joints, &JointMeasurement { position: &[f64::NAN], velocity: &[f64::NAN] });
    assert_eq!((joints.velocity[0], joints.position[0]), (PERIOD * 5.0, PERIOD * (PERIOD * 5.0)));
}

/// A controller after its first tick, in the initial state of its flight.
fn ticked(config: &ScenarioConfig) -> (Controller, ControllerState) {
    let mut controller = config.controller(robot("ironcub_mk1")).unwrap();
    let state = config.simulator.initial.state();
    let measurement = at(0.0, &state, &config.simulator.initial.thrust);
    let mut memory = controller.start(&measurement).unwrap();
    controller.tick(&mut memory, &measurement);
    (controller, memory)
}

/// A joint that is faster than commanded is braked: its torque is the one of the tick with that velocity, as the rest of
/// the model is held.
#[test]
fn torques_follow_the_measured_velocities() {
    let mut config = experiment("test2_observer");
    config.controller.law.torque.steps = 10;
    config.controller.law.torque.torque_rate_max = Some(1e6);
    let rest = config.simulator.initial.joint_position.clone();
    let torque_at = |speed: f64| {
        let (mut controller, mut state) = ticked(&config);
        let mut velocity = vec![0.0; rest.len()];
        velocity[12] = speed;
        let command =
            controller.tick_torques(&mut state, &JointMeasurement { position: &rest, velocity: &velocity });
        assert_eq!(command.modes, Modes::default());
        command.joint_torque.clone()
    };
    let change = (torque_at(0.1) - torque_at(0.0))[12];
    assert!(change < -1e-3, "{change}");
}

#[test]
fn a_state_of_another_tick_is_refused() {
    let mut config = experiment("test2_observer");
    config.controller.law.torque.steps = 10;
    let rest = config.simulator.initial.joint_position.clone();
    let velocity = vec![0.0; rest.len()];
    let measured = JointMeasurement { position: &rest, velocity: &velocity };
    let (mut controller, mut state) = ticked(&config);
    let mut other = state.clone();
    assert_eq!(controller.tick_torques(&mut state, &measured).modes, Modes::default());
    let too_few = JointMeasurement { position: &rest[1..], velocity: &velocity };
    assert!(controller.tick_torques(&mut state, &too_few).modes.contains(Modes::MEASUREMENT_IGNORED));
    let seen = config.simulator.initial.state();
    controller.tick(&mut state, &at(0.01, &seen, &config.simulator.initial.thrust));
    assert_eq!(controller.tick_torques(&mut other, &measured).modes, Modes::STATE_IGNORED);
    // Both ticks hold the same torques; the model is that of the last one.
    let (_, before) = ticked(&config);
    let [held, last] = [(); 2].map(|()| {
        let mut state = before.clone();
        controller.tick(&mut state, &at(0.01, &seen, &[]));
        state
    });
    assert_eq!(controller.tick_torques(&mut held.clone(), &measured).modes, Modes::STATE_IGNORED);
    let modes = controller.tick_torques(&mut last.clone(), &measured).modes;
    assert!(!modes.contains(Modes::STATE_IGNORED));
}

/// A measurement of other sizes measures nothing: the torques stay for its tick, and the next one is as usual.
#[test]
fn a_measurement_of_other_sizes_costs_one_tick() {
    let mut config = experiment("test2_observer");
    config.controller.law.torque.steps = 10;
    let rest = config.simulator.initial.joint_position.clone();
    let mut velocity = vec![0.0; rest.len()];
    velocity[12] = 0.1;
    let measured = JointMeasurement { position: &rest, velocity: &velocity };
    let too_few = JointMeasurement { position: &rest[1..], velocity: &velocity };
    let (mut controller, mut state) = ticked(&config);
    let torque = controller.command().joint_torque.clone();
    let command = controller.tick_torques(&mut state, &too_few);
    assert_eq!((command.modes, &command.joint_torque), (Modes::MEASUREMENT_IGNORED, &torque));
    let command = controller.tick_torques(&mut state, &measured);
    assert_eq!(command.modes, Modes::default());
    assert!(command.joint_torque[12] < torque[12]);
}

/// TEST2 with torques at 1 kHz, 3 to 4 ms late, without and with the sensors and the estimator of a robot.
#[test]
fn a_flight_with_torques_at_a_kilohertz() {
    for (name, most) in [("test2_observer", 4.0), ("test2_sensors_mpc", 3.0)] {
        let mut config = experiment(name);
        config.simulator.duration = 6.0;
        config.simulator.substeps = 10;
        config.controller.law.torque.steps = 10;
        config.simulator.actuation =
            Some(ActuationConfig { torque_delay: 0.003, jitter: 0.001, seed: 1, ..Default::default() });
        if let Some(estimator) = &mut config.controller.law.estimator {
            (estimator.latency.torque, estimator.latency.thrust) = (0.008, 0.008);
        }
        let flight = Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap();
        assert_eq!(flight.outcome, Outcome::Completed, "{name}: {:?}", flight.loss);
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, most, because "margin of the flight", "{name}: {rotation} deg");
    }
}

#[test]
fn rates_that_do_not_fit_are_refused_by_name() {
    let mut config = experiment("test2_observer");
    config.controller.law.torque.steps = 10;
    let refused = |config: &ScenarioConfig| Scenario::new(config).unwrap_err();
    assert_says(&refused(&config), &["simulator.substeps is 1", "multiple of controller.torque.steps, 10"]);
    config.simulator.substeps = 20;
    assert!(Scenario::new(&config).is_ok());
    let joints = EncoderConfig { delay: 0.01, ..EncoderConfig::default() };
    config.simulator.sensors = Some(SensorsConfig { joints, ..SensorsConfig::default() });
    assert_says(&refused(&config), &["simulator.sensors.joints.delay is 0.01"]);
    config.simulator.sensors = None;
    config.controller.law.torque.steps = 200;
    config.simulator.substeps = 200;
    assert_says(&refused(&config), &["controller.torque.steps` is 200"]);
}

/// Prediction and set-point are of one time: a robot that follows its set-point at 7 m/s with a latency of 0.03 s, 0.2 m
/// later, is not 0.1 m off.
#[test]
fn a_latency_is_no_error_of_the_flight() {
    let mut config = experiment("test2_mpc");
    config.simulator.duration = 32.0;
    let late = ActuationConfig { torque_delay: 0.03, thrust_delay: 0.03, ..Default::default() };
    config.simulator.actuation = Some(late);
    let latency = LatencyConfig { torque: 0.03, thrust: 0.03 };
    config.controller.law.estimator = Some(EstimatorConfig { latency, ..Default::default() });
    config.controller.law.fault_detection.tracking_error.as_mut().unwrap().position = 0.1;
    let flight = Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap();
    assert_eq!(flight.outcome, Outcome::Completed, "{:?}", flight.loss);
    let modes = flight.log.series("degraded_modes").unwrap();
    assert!(modes.data.iter().all(|modes| *modes == 0.0));
}
