//! Every term of an engine of the shaft's speed (M176), by hand or by its own simulation.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, at, experiment, random_state, rng};
use flight_core::Measurement;
use flight_core::control::Estimate;
use flight_core::control::acting::Acting;
use flight_core::control::detect::engines::{EngineMonitor, EngineSample, Engines, EnginesConfig, Shown};
use flight_core::control::engine_condition::{EngineCondition, EngineFinding};
use flight_core::control::limits::Descent;
use flight_core::control::measure::channels::{Channels, ChannelsConfig};
use flight_core::jets::{
    EngineDynamics, EngineModel, JetDynamics, JetModel, Shaft, ShaftConfig, ThrustRateController,
};
use flight_core::robot::RobotModel;
use flight_io::load_robot;
use nalgebra::Vector3;

const NUMBERS: ShaftConfig = ShaftConfig {
    idle: 0.3,
    ramps: [0.1, 0.2],
    lags: [1.2, 1.6],
    accelerations: [0.15, 0.4],
    exponent: 2.0,
    square_share: 0.25,
};
const DT: f64 = 0.01;

fn shaft_of(change: impl FnOnce(&mut ShaftConfig)) -> Shaft {
    let mut k = NUMBERS;
    change(&mut k);
    Shaft::new("simulator.jets.shaft", k, 200.0).unwrap()
}

fn shaft() -> Shaft {
    shaft_of(|_| ())
}

/// The robot, whose first engine is this one.
fn robot() -> RobotModel {
    let mut robot = load_robot(&experiment("test2_observer").robot).unwrap();
    robot.feet.clear();
    robot.jets[0].engine = EngineModel::Shaft(shaft());
    robot
}

/// Tick in which the monitor finds, from the speed alone, an engine whose ramps are `scale` times those known, and which
/// stops in a tick.
fn found(scale: f64, stop: usize) -> Option<usize> {
    let robot = robot();
    let config = EnginesConfig { deviation_max: 12.0, descent: None };
    let monitor = Engines::new(&config, &robot, [1.0; 2], JetDynamics::Throttled);
    let known = JetModel { thrust_min: 0.0, engine: Some(EngineModel::Shaft(shaft())) };
    let model = EngineModel::Shaft(shaft_of(|k| k.ramps = k.ramps.map(|ramp| scale * ramp)));
    let mut engine = EngineDynamics::new(model, 110.0, 0.0);
    let mut throttle = ThrustRateController::new(model.steady_throttle(110.0));
    let (mut monitors, mut rate) = (vec![EngineMonitor::default(); 4], 0.0);
    (0..1200).find(|tick| {
        let command = if tick / 150 % 2 == 0 { 80.0 } else { -80.0 };
        let (predicted, next) = known.advance(engine.thrust, rate, command, DT);
        rate = next;
        engine.step(throttle.update(&model, engine.thrust, engine.thrust_rate, command), DT);
        if *tick >= stop {
            engine.thrust = 0.0;
        }
        let (thrust, innovation) = (engine.thrust, engine.thrust - predicted);
        let healthy = EngineSample { thrust, innovation: 0.0, is_measured: true, is_of_speed: true, command };
        let sample = |jet| if jet == 0 { EngineSample { innovation, ..healthy } } else { healthy };
        let (conditions, mut findings) = ([EngineCondition::default(); 4], [EngineFinding::Nothing; 4]);
        monitor.update(&mut monitors, &conditions, DT, sample, Shown::Between, &mut findings);
        matches!(findings[0], EngineFinding::OutOfReach { .. })
    })
}

#[test]
fn an_engine_that_stops_is_found_by_its_speed_after_the_confirmation() {
    for stop in [200, 333] {
        assert_eq!(found(1.0, stop), Some(stop + 3));
    }
}

#[test]
fn ramps_that_differ_by_a_third_are_those_of_healthy_engines_and_no_others() {
    for healthy in [0.7, 1.0, 1.3] {
        assert_eq!(found(healthy, usize::MAX), None, "{healthy}");
    }
    for ill in [0.1, 2.5] {
        assert!(found(ill, usize::MAX).is_some(), "{ill}");
    }
}

#[test]
fn a_measured_speed_gives_the_thrust_and_a_sensor_that_of_the_others() {
    let robot = robot();
    let sample = at(0.0, &random_state(&mut rng(3), &robot), &[f64::NAN, 90.0, 5.0, 110.0]);
    let jets = robot.jet_models(JetDynamics::Throttled);
    let channels = Channels::new(ChannelsConfig::default(), &robot, jets, DT, true);
    let nothing = f64::NAN;
    let (first, second, third) =
        ([0.8, nothing, nothing, nothing], [0.7, nothing, nothing, nothing], [0.8; 4]);
    let with = |speed: [f64; 4]| Measurement { shaft_speed: speed.to_vec(), ..sample.clone() };
    let start = |speed| channels.start(&with(speed), Estimate::new(&robot, 4, DT));
    let (mut state, mut used) = start(first).unwrap();
    let acting = Acting::new(robot.joints.len(), 4, robot.feet.len());
    channels.update(&mut state, &with(second), Vector3::zeros(), &acting, &mut Descent::default(), &mut used);
    assert_eq!(used.robot.thrust, [shaft().thrust(0.7), 90.0, 5.0, 110.0]);
    let refusal = start(third).unwrap_err().to_string();
    assert!(refusal.contains("`shaft_speed` holds 0.8"), "{refusal}");
}

#[test]
fn thrust_has_a_square_and_a_cube() {
    assert_within!((shaft().thrust(1.0) - 200.0).abs(), 1e-12);
    assert_within!((shaft().thrust(0.5) - 200.0 * 0.25 * (0.25 + 0.75 * 0.5)).abs(), 1e-12);
}

#[test]
fn a_thrust_has_one_speed() {
    for share in [0.0, 1e-3, 0.06, 0.5, 1.0] {
        let shaft = shaft_of(|k| k.square_share = share);
        for thrust in [1e-6, 0.3, 20.0, 120.0, 200.0, 260.0] {
            assert_within!((shaft.thrust(shaft.speed(thrust)) / thrust - 1.0).abs(), 1e-13);
        }
        assert!(shaft.speed(0.0).abs() < 1e-300 && shaft.speed(-1.0).abs() < 1e-300);
    }
}

#[test]
fn the_wanted_speed_moves_within_its_ramps() {
    let wanted = |from: f64, throttle: f64| shaft().step(0.6, from, throttle, DT).1;
    assert_within!((wanted(0.6, 100.0) - 0.601).abs(), 1e-15);
    assert_within!((wanted(0.6, 0.0) - 0.598).abs(), 1e-15);
    // A throttle of 40 % demands 0.3 + 0.7 · 0.4.
    assert_within!((wanted(0.5799, 40.0) - 0.58).abs(), 1e-15);
    assert_within!((wanted(0.9999, 130.0) - 1.0).abs(), 1e-15);
}

#[test]
fn the_shaft_follows_it_with_its_lags_as_fast_as_the_gas_allows() {
    let rate = |wanted: f64| (shaft().step(0.8, wanted, 100.0 * (wanted - 0.3) / 0.7, DT).0 - 0.8) / DT;
    assert_within!((rate(0.86) - 0.06 / 1.2).abs(), 1e-12);
    assert_within!((rate(0.72) + 0.08 / 1.6).abs(), 1e-12);
    assert_within!((rate(1.0) - 0.15 * 0.64).abs(), 1e-12);
    assert_within!((rate(0.3) + 0.4 * 0.64).max(-0.05), 1e-12); // 0.5/1.6 = 0.31 > 0.256
}

#[test]
fn the_thrust_rate_is_that_of_the_thrust() {
    let (speed, _, rate) = shaft().step(0.7, 0.75, 90.0, 1e-6);
    let change = (shaft().thrust(speed) - shaft().thrust(0.7)) / 1e-6;
    assert_within!((change - rate).abs(), 1e-3 * rate.abs());
}

#[test]
fn the_least_and_greatest_acceleration_are_those_of_the_ends_of_the_throttle() {
    for (thrust, ahead) in [(60.0, 0.02), (110.0, 0.0), (150.0, -0.03)] {
        let speed = shaft().speed(thrust);
        let from = speed + ahead;
        let rate = shaft().step(speed, from, 100.0 * (from - 0.3) / 0.7, 1e-9).2;
        let (least, greatest) = shaft().acceleration_range(thrust, rate);
        for (throttle, expected) in [(0.0, least), (100.0, greatest)] {
            let (n, w, after) = shaft().step(speed, from, throttle, 1e-5);
            let (_, _, later) = shaft().step(n, w, throttle, 1e-5);
            assert_within!(((later - after) / 1e-5 - expected).abs(), 2e-3 * expected.abs().max(1.0));
        }
    }
}

#[test]
fn lasting_inputs_end_at_the_rate_of_the_gas() {
    let thrust = 40.0; // n = 0.63: the gas gives 0.06 1/s, the ramp 0.1
    let engine = EngineModel::Shaft(shaft());
    let (least, greatest) = engine.rate_range(thrust);
    // At the rate of the gas a thrust accelerates by its curvature alone.
    let (_, last) = engine.lasting_range(thrust, greatest);
    let (_, ramp) = engine.acceleration_range(thrust, greatest);
    assert!(last > 0.0 && last < 0.5 * ramp, "{last} {ramp}");
    let (_, by_rate) = engine.steady_slopes(thrust, 1.0);
    assert_within!((by_rate + 1.0 / 1.2).abs(), 1e-15);
    assert_within!((engine.steady_slopes(thrust, -1.0).1 + 1.0 / 1.6).abs(), 1e-15);
    // Both ends of the rate are those of the gas, 0.15 up and 0.4 down at full speed.
    assert_within!((greatest / least + 0.15 / 0.4).abs(), 1e-12);
}

/// The controller's prediction against the engine behind its throttle loop: steps of the command, up and down.
#[test]
fn the_prediction_is_that_of_the_engine() {
    let model = EngineModel::Shaft(shaft());
    let jet = JetModel { thrust_min: 0.0, engine: Some(model) };
    let mut engine = EngineDynamics::new(model, 110.0, 0.0);
    let mut controller = ThrustRateController::new(model.steady_throttle(110.0));
    for tick in 0..400 {
        let command = match tick / 100 {
            0 => 15.0,
            1 => -20.0,
            2 => 200.0,
            _ => -200.0,
        };
        let (predicted, rate) = jet.advance(engine.thrust, engine.thrust_rate, command, DT);
        let throttle = controller.update(&model, engine.thrust, engine.thrust_rate, command);
        assert!((0.0..=100.0).contains(&throttle));
        engine.step(throttle, DT);
        assert_within!((engine.thrust - predicted).abs(), 0.02, "tick {tick}");
        assert_within!((engine.thrust_rate - rate).abs(), 1.0, "tick {tick}");
    }
}

#[test]
fn a_stopped_engine_stays_where_it_is() {
    let mut engine = EngineDynamics::new(EngineModel::Shaft(shaft()), 100.0, 0.0);
    engine.thrust = 0.0;
    engine.step(100.0, DT);
    assert!(engine.thrust.abs() < 1e-12 && engine.thrust_rate.abs() < 1e-12);
    assert_eq!(engine.model().acceleration_range(0.0, 0.0), (0.0, 0.0));
}

#[test]
fn a_steady_throttle_holds_its_thrust() {
    let model = EngineModel::Shaft(shaft());
    let mut engine = EngineDynamics::new(model, 130.0, 0.0);
    for _ in 0..200 {
        engine.step(model.steady_throttle(130.0), DT);
    }
    assert_within!((engine.thrust - 130.0).abs(), 1e-10);
}
