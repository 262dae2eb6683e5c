//! Engines that fail and sensors that are wrong, each law by itself.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, experiment};
use flight_core::control::engines::{DescentConfig, EngineState, EnginesConfig, Finding};
use flight_core::robot::JointKind;
use flight_io::load_robot;
use nalgebra::Vector6;

const STEP: f64 = 0.01;
const CONFIG: EnginesConfig =
    EnginesConfig { time_constant: 0.5, deviation_max: 15.0, confirmation: 0.05, descent: None };

fn column() -> Vector6<f64> {
    Vector6::new(0.1, -0.2, 0.97, 0.05, 0.3, -0.1)
}

/// A deviation of `a` newtons per tick: `a (1 − e^{−kΔt/τ}) / (1 − e^{−Δt/τ})` after k ticks.
#[test]
fn deviations_are_summed_and_forgotten() {
    let mut engine = EngineState::default();
    for tick in 1..=40 {
        let _ = engine.update(&CONFIG, STEP, (100.0, 0.3), &column(), Some(&Vector6::zeros()));
        let expected = 0.3 * (-f64::from(tick) * STEP / 0.5).exp_m1() / (-STEP / 0.5).exp_m1();
        assert_within!((engine.deviation - expected).abs(), 1e-12, "tick {tick}");
    }
}

/// 20 N at once are suspect for five ticks and then bound the thrust on their side; 14 N never do.
#[test]
fn a_thrust_that_is_not_reached_bounds_the_engine_after_its_confirmation() {
    let everything = (0.0, f64::INFINITY);
    for (size, found, range) in [
        (20.0, Some(6), (100.0, f64::INFINITY)),
        (-20.0, Some(6), (0.0, 100.0)),
        (14.0, None, everything),
        (-14.0, None, everything),
    ] {
        let mut engine = EngineState::default();
        let findings: Vec<_> = (1..=20)
            .map(|tick| {
                let innovation = if tick == 1 { size } else { 0.0 };
                engine.update(&CONFIG, STEP, (100.0, innovation), &column(), Some(&Vector6::zeros()))
            })
            .collect();
        let first = findings.iter().position(|finding| *finding == Finding::OutOfReach);
        assert_eq!(first.map(|tick| tick + 1), found, "{size} N");
        assert_eq!(engine.range, range, "{size} N");
        assert!(!engine.is_lost(&CONFIG));
    }
}

/// An engine that is asked for more than 80 N without giving it, then for less, keeps its thrust: it is lost. So is one
/// that fades away.
#[test]
fn an_engine_whose_bounds_meet_is_lost() {
    let none = Vector6::zeros();
    let mut stuck = EngineState::default();
    for tick in 0..100 {
        let _ =
            stuck.update(&CONFIG, STEP, (80.0, if tick < 50 { -1.0 } else { 1.0 }), &column(), Some(&none));
        assert_eq!(stuck.is_lost(&CONFIG), stuck.range == (80.0, 80.0), "tick {tick}");
    }
    assert_eq!(stuck.range, (80.0, 80.0));
    let (mut fading, mut thrust) = (EngineState::default(), 100.0);
    for _ in 0..50 {
        thrust -= 2.0;
        let _ = fading.update(&CONFIG, STEP, (thrust, -2.0), &column(), Some(&none));
    }
    assert_eq!(fading.range, (0.0, thrust));
    assert!(fading.is_lost(&CONFIG));
}

/// A sensor that says too much by `d` puts `−a d` into the momentum: from half of that on it is the sensor.
#[test]
fn the_momentum_shows_a_wrong_sensor() {
    for deviation in [30.0, -30.0] {
        let out = Finding::OutOfReach;
        for (share, expected) in [(0.45, out), (0.55, Finding::WrongSensor), (-0.9, out)] {
            let mut engine = EngineState::default();
            let mut found = Finding::Nothing;
            for tick in 1..=6 {
                let innovation = if tick == 1 { deviation } else { 0.0 };
                let residual = column() * (-share * deviation * (-f64::from(tick - 1) * STEP / 0.5).exp());
                found = engine.update(&CONFIG, STEP, (100.0, innovation), &column(), Some(&residual));
            }
            assert_eq!(found, expected, "{deviation} N, {share}");
        }
    }
}

/// Without a momentum that is measured nothing is judged, and the confirmation begins anew when it is back.
#[test]
fn nothing_is_judged_without_a_momentum() {
    let mut engine = EngineState::default();
    let mut update = |innovation: f64, residual: Option<&Vector6<f64>>| {
        engine.update(&CONFIG, STEP, (100.0, innovation), &column(), residual)
    };
    assert_eq!(update(-30.0, None), Finding::Nothing);
    for _ in 0..10 {
        assert_eq!(update(0.0, None), Finding::Nothing);
    }
    let none = Vector6::zeros();
    let findings: Vec<_> = (0..6).map(|_| update(0.0, Some(&none))).collect();
    assert_eq!(findings[..5], [Finding::Nothing; 5]);
    assert_eq!(findings[5], Finding::OutOfReach);
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
    let cases: [(&str, Change); 9] = [
        ("controller.engines.time_constant", |engines, _| engines.time_constant = 0.0),
        ("controller.engines.deviation_max", |engines, _| engines.deviation_max = f64::NAN),
        ("controller.engines.confirmation", |engines, _| engines.confirmation = -0.1),
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
