//! Engines that fail and sensors that are wrong, each law by itself.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, experiment};
use flight_core::control::guard::engines::{DescentConfig, EngineState, EnginesConfig, sensor_error};
use flight_core::robot::JointKind;
use flight_io::load_robot;
use nalgebra::Vector6;

const STEP: f64 = 0.01;
const CONFIG: EnginesConfig =
    EnginesConfig { time_constant: 0.5, deviation_max: 15.0, confirmation: 0.05, descent: None };

/// The shipped descent, in which an engine with a range below 30 of 120 N is lost.
fn descent() -> DescentConfig {
    let engines = experiment("test2_observer").controller.law.engines.unwrap();
    DescentConfig { range_share_min: 0.25, ..engines.descent.unwrap() }
}

/// What a tick finds: whether the sensor is wrong, and whether the engine is limited.
const NOTHING: (bool, bool) = (false, false);
const WRONG_SENSOR: (bool, bool) = (true, false);
const OUT_OF_REACH: (bool, bool) = (false, true);

/// A tick with a momentum that is measured and says that the sensor is wrong by so much \[N\].
fn update(engine: &mut EngineState, thrust: f64, innovation: f64, sensor_error: f64) -> (bool, bool) {
    let is_wrong = engine.update(&CONFIG, STEP, (thrust, innovation), 1.0, Some(sensor_error));
    (is_wrong, engine.is_limited())
}

/// A deviation of `a` newtons per tick: `a (1 − e^{−kΔt/τ}) / (1 − e^{−Δt/τ})` after k ticks.
#[test]
fn deviations_are_summed_and_forgotten() {
    let mut engine = EngineState::default();
    for tick in 1..=40 {
        let _ = update(&mut engine, 100.0, 0.3, 0.0);
        let expected = 0.3 * (-f64::from(tick) * STEP / 0.5).exp_m1() / (-STEP / 0.5).exp_m1();
        assert_within!((engine.deviation - expected).abs(), 1e-12, "tick {tick}");
    }
}

/// 20 N at once are beyond 15 N, as late as the residual is, from the third tick on, are suspect for five ticks, and then
/// bound the thrust on their side; 14 N never do.
#[test]
fn a_thrust_that_is_not_reached_bounds_the_engine_after_its_confirmation() {
    let everything = (0.0, f64::INFINITY);
    for (size, found, range) in [
        (20.0, Some(8), (100.0, f64::INFINITY)),
        (-20.0, Some(8), (0.0, 100.0)),
        (14.0, None, everything),
        (-14.0, None, everything),
    ] {
        let mut engine = EngineState::default();
        let findings: Vec<_> = (1..=20)
            .map(|tick| update(&mut engine, 100.0, if tick == 1 { size } else { 0.0 }, 0.0))
            .collect();
        let first = findings.iter().position(|finding| *finding != NOTHING);
        assert_eq!(first.map(|tick| tick + 1), found, "{size} N");
        assert!(findings[first.unwrap_or(20)..].iter().all(|finding| *finding == OUT_OF_REACH), "{size} N");
        assert_eq!(engine.range, range, "{size} N");
        assert!(!engine.is_lost(&descent(), 120.0));
    }
}

/// An engine that is asked for more than 80 N without giving it, then for less, keeps its thrust: it is lost. So is one
/// that fades, once it gives less than 30 N.
#[test]
fn an_engine_whose_bounds_are_close_together_is_lost() {
    let mut stuck = EngineState::default();
    for tick in 0..100 {
        let _ = update(&mut stuck, 80.0, if tick < 50 { -1.0 } else { 1.0 }, 0.0);
        assert_eq!(stuck.is_lost(&descent(), 120.0), stuck.range == (80.0, 80.0), "tick {tick}");
    }
    assert_eq!(stuck.range, (80.0, 80.0));
    let (mut fading, mut thrust) = (EngineState::default(), 100.0);
    for _ in 0..50 {
        thrust -= 2.0;
        let _ = update(&mut fading, thrust, -2.0, 0.0);
        assert_eq!(fading.is_lost(&descent(), 120.0), thrust < 30.0, "{thrust} N");
    }
    assert_eq!(fading.range, (0.0, thrust));
}

/// A deviation after lags with shares `a` and `b` is, a step of `d` being forgotten by `f` per tick,
/// `d Σ a (1 − a)^i b (1 − b)^j f^l` over `i + j + l = k − 1`; it is compared with what the momentum says.
#[test]
fn a_deviation_is_as_late_as_the_momentum() {
    let (share, deviation) = (0.2_f64, 40.0);
    let (forgotten, residual) = ((-STEP / CONFIG.time_constant).exp(), -(-STEP / 0.02_f64).exp_m1());
    let late = |tick: i32| {
        let mut sum = 0.0;
        for i in 0..tick {
            for j in 0..tick - i {
                sum += share
                    * (1.0 - share).powi(i)
                    * residual
                    * (1.0 - residual).powi(j)
                    * forgotten.powi(tick - 1 - i - j);
            }
        }
        deviation * sum
    };
    let first = (1..100).find(|tick| late(*tick) > CONFIG.deviation_max).unwrap() + 5;
    for (part, expected) in [(0.49, OUT_OF_REACH), (0.51, WRONG_SENSOR)] {
        let mut engine = EngineState::default();
        for tick in 1..=first {
            let innovation = if tick == 1 { deviation } else { 0.0 };
            let is_wrong = engine.update(&CONFIG, STEP, (100.0, innovation), share, Some(part * late(tick)));
            let found = (is_wrong, engine.is_limited());
            assert_eq!(found, if tick == first { expected } else { NOTHING }, "tick {tick}");
        }
    }
}

/// A sensor that says too much by `d` puts `−a d` into the momentum, of which moments are compared.
#[test]
fn the_momentum_shows_by_how_much_a_sensor_is_wrong() {
    let column = Vector6::new(0.1, -0.2, 0.97, 0.05, 0.3, -0.1);
    assert_within!((sensor_error(&column, &(-30.0 * column)) - 30.0).abs(), 1e-13);
    let (force, across) =
        (Vector6::new(9.0, 8.0, 7.0, 0.0, 0.0, 0.0), Vector6::new(0.0, 0.0, 0.0, 0.3, -0.05, 0.0));
    assert_eq!(sensor_error(&column, &(force + across)), 0.0);
}

/// Through the centre of mass a jet has an arm of rounding errors, whose quotient with a residual says nothing.
#[test]
fn the_sensor_of_a_jet_without_an_arm_is_not_judged() {
    let residual = Vector6::new(0.0, 0.0, 30.0, 1e-16, 0.0, 0.0);
    for (arm, error) in [(0.0, 0.0), (-1e-17, 0.0), (-0.0099, 0.0), (-0.0101, 1e-16 / 0.0101)] {
        let found = sensor_error(&Vector6::new(0.0, 0.0, 1.0, arm, 0.0, 0.0), &residual);
        assert_within!((found - error).abs(), 1e-28, "an arm of {arm} m");
    }
}

/// Only what the momentum shows, and shows on the same side, is a sensor.
#[test]
fn the_momentum_shows_a_wrong_sensor() {
    for deviation in [30.0, -30.0] {
        for (share, expected) in
            [(0.9, WRONG_SENSOR), (0.0, OUT_OF_REACH), (-0.9, OUT_OF_REACH), (f64::NAN, OUT_OF_REACH)]
        {
            let mut engine = EngineState::default();
            let found = (1..=100)
                .map(|tick| {
                    update(&mut engine, 100.0, if tick == 1 { deviation } else { 0.0 }, share * deviation)
                })
                .find(|found| *found != NOTHING);
            assert_eq!(found, Some(expected), "{deviation} N, {share}");
        }
    }
}

/// Without a momentum that is measured nothing is judged, and lags and confirmation begin anew when it is back.
#[test]
fn nothing_is_judged_without_a_momentum() {
    let mut engine = EngineState::default();
    let mut update = |innovation: f64, sensor_error: Option<f64>| {
        (engine.update(&CONFIG, STEP, (100.0, innovation), 1.0, sensor_error), engine.is_limited())
    };
    assert_eq!(update(-30.0, None), NOTHING);
    for _ in 0..10 {
        assert_eq!(update(0.0, None), NOTHING);
    }
    let findings: Vec<_> = (0..8).map(|_| update(0.0, Some(0.0))).collect();
    let found = findings.iter().position(|finding| *finding == OUT_OF_REACH);
    assert!(findings[..found.unwrap()].iter().all(|finding| *finding == NOTHING));
    assert!(found.unwrap() > 5, "{findings:?}");
}

/// On the way down revolute joints are as fast as the descent says where their own limits are less; sliding ones are not:
/// degrees and newton metres are not theirs.
#[test]
fn the_limits_of_a_descent_are_those_of_revolute_joints() {
    let descent = experiment("test2_observer").controller.law.engines.unwrap().descent.unwrap();
    let mut joint = load_robot(&experiment("test2").robot).unwrap().joints[0].clone();
    let (fast, strong) = (descent.joint_velocity_max_deg.to_radians(), descent.torque_rate_max);
    for (kind, own, expected) in [
        (JointKind::Revolute, 0.5, 1.0),
        (JointKind::Revolute, 2.0, 2.0),
        (JointKind::Prismatic, 0.5, 0.5),
        (JointKind::Prismatic, 2.0, 2.0),
    ] {
        (joint.kind, joint.velocity_max, joint.torque_rate_max) = (kind, own * fast, own * strong);
        assert_eq!(descent.velocity_max(&joint), expected * fast);
        assert_eq!(descent.torque_rate_max(&joint), expected * strong);
    }
}

/// Each number of `controller.engines` that means nothing is refused by its key.
#[test]
fn numbers_that_mean_nothing_are_refused_by_key() {
    type Change = fn(&mut EnginesConfig, &mut DescentConfig);
    let cases: [(&str, Change); 10] = [
        ("controller.engines.time_constant", |engines, _| engines.time_constant = 0.0),
        ("controller.engines.deviation_max", |engines, _| engines.deviation_max = f64::NAN),
        ("controller.engines.confirmation", |engines, _| engines.confirmation = -0.1),
        ("controller.engines.descent.range_share_min", |_, descent| descent.range_share_min = 0.0),
        ("controller.engines.descent.momentum.kp_linear", |_, descent| descent.momentum.kp_linear[2] = -0.1),
        ("controller.engines.descent.momentum.ko", |_, descent| descent.momentum.ko = 0.0),
        ("controller.engines.descent.momentum.c0", |_, descent| descent.momentum.c0 = -1.0),
        ("controller.engines.descent.joint_velocity_max_deg", |_, descent| {
            descent.joint_velocity_max_deg = 0.0;
        }),
        ("controller.engines.descent.torque_rate_max", |_, descent| descent.torque_rate_max = f64::INFINITY),
        ("controller.engines.descent.torque_rate_max", |_, descent| descent.torque_rate_max = 0.0),
    ];
    let shipped = experiment("test2_observer").controller.law.engines.unwrap();
    shipped.check().unwrap();
    for (key, change) in cases {
        let (mut engines, mut descent) = (shipped, shipped.descent.unwrap());
        change(&mut engines, &mut descent);
        engines.descent = Some(descent);
        let message = engines.check().unwrap_err().to_string();
        assert!(message.starts_with(&format!("{key} is ")), "{key}: {message}");
    }
}
