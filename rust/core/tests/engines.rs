//! Engines that fail and sensors that are wrong, each law by itself.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, experiment};
use flight_core::control::detect::engines::{
    DescentConfig, EngineMonitor, EngineSample, Engines, EnginesConfig, Shown, explains,
};
use flight_core::control::engine_condition::{
    EVERYTHING, EngineCondition, EngineFinding, EngineLimits, EngineState,
};
use flight_core::control::limits::Limits;
use flight_core::jets::{EngineDynamics, JetDynamics, ThrustRateController};
use flight_core::robot::JointKind;
use flight_io::load_robot;
use nalgebra::{Matrix6xX, Vector6};

const STEP: f64 = 0.01;
const CONFIG: EnginesConfig = EnginesConfig { deviation_max: 15.0, descent: None };

/// The shipped descent, in which an engine with a range below 30 of 120 N is lost.
fn descent() -> DescentConfig {
    let engines = experiment("test2_observer").controller.law.fault_detection.engines.unwrap();
    DescentConfig { range_fraction_min: 0.25, ..engines.descent.unwrap() }
}

/// What a tick finds: whether the sensor is wrong, and whether the engine is limited.
const NOTHING: (bool, bool) = (false, false);
const WRONG_SENSOR: (bool, bool) = (true, false);
const OUT_OF_REACH: (bool, bool) = (false, true);

/// The monitors of the robot's first jets, which push upwards, on arms of 0.3 m to the front and to the back in turn.
struct Monitors {
    engines: Engines,
    each: Vec<EngineMonitor>,
    conditions: Vec<EngineCondition>,
    a_t: Matrix6xX<f64>,
}

impl Monitors {
    fn new(jets: usize, momentum_share: f64) -> Self {
        let config = experiment("test2_observer");
        let mut robot = load_robot(&config.robot).unwrap();
        robot.jets.truncate(jets);
        let engines = Engines::new(&CONFIG, &robot, [momentum_share; 2], JetDynamics::Ideal);
        let column = |jet: usize| Vector6::new(0.0, 0.0, 1.0, 0.0, 0.3 - 0.6 * (jet % 2) as f64, 0.0);
        let a_t = Matrix6xX::from_columns(&(0..jets).map(column).collect::<Vec<_>>());
        let (each, conditions) =
            (vec![EngineMonitor::default(); jets], vec![EngineCondition::default(); jets]);
        Self { engines, each, conditions, a_t }
    }

    /// A tick with these samples; the momentum is measured and has the residual of sensors that are wrong by so much \[N\].
    fn tick(&mut self, samples: &[EngineSample], sensor_errors: Option<&[f64]>) -> Vec<(bool, bool)> {
        self.tick_between(samples, sensor_errors, false)
    }

    /// The same; a tick without a measured momentum may be between two with one.
    fn tick_between(
        &mut self,
        samples: &[EngineSample],
        sensor_errors: Option<&[f64]>,
        is_between: bool,
    ) -> Vec<(bool, bool)> {
        let residual = sensor_errors.map(|errors| {
            self.a_t.column_iter().zip(errors).map(|(column, error)| -*error * column).sum::<Vector6<f64>>()
        });
        let shown = match &residual {
            Some(residual) => Shown::Measured { a_t: &self.a_t, residual, covered: STEP },
            None if is_between => Shown::Between,
            None => Shown::Nothing,
        };
        let mut findings = vec![EngineFinding::Nothing; samples.len()];
        self.engines.update(&mut self.each, &self.conditions, STEP, |jet| samples[jet], shown, &mut findings);
        let measured = if residual.is_some() { STEP } else { 0.0 };
        let all = self.conditions.iter_mut().zip(findings).zip(samples);
        all.map(|((engine, finding), sample)| {
            let error = engine.advance(finding, sample.thrust, measured);
            (error.is_some(), !engine.works())
        })
        .collect()
    }
}

/// A jet that is commanded to keep its thrust.
fn held(thrust: f64, innovation: f64) -> EngineSample {
    EngineSample { thrust, innovation, is_measured: true, is_of_speed: false, command: 0.0 }
}

/// A tick of one monitor with a momentum that is measured and says that the sensor is wrong by so much \[N\].
fn update(monitor: &mut Monitors, thrust: f64, innovation: f64, sensor_error: f64) -> (bool, bool) {
    monitor.tick(&[held(thrust, innovation)], Some(&[sensor_error]))[0]
}

/// A deviation of `a` newtons per tick: `a (1 − e^{−kΔt/τ}) / (1 − e^{−Δt/τ})` after k ticks.
#[test]
fn deviations_are_summed_and_forgotten() {
    let mut engine = Monitors::new(1, 1.0);
    for tick in 1..=40 {
        let _ = update(&mut engine, 100.0, 0.3, 0.0);
        let expected = 0.3 * (-f64::from(tick) * STEP / 0.5).exp_m1() / (-STEP / 0.5).exp_m1();
        assert_within!((engine.each[0].deviation - expected).abs(), 1e-12, "tick {tick}");
    }
}

/// 20 N at once are beyond 15 N, as late as the residual is, from the third tick on, are suspect for three ticks, and then
/// bound the thrust on their side; 14 N never do.
#[test]
fn a_thrust_that_is_not_reached_bounds_the_engine_after_its_confirmation() {
    let everything = EVERYTHING;
    for (size, found, range) in [
        (20.0, Some(6), (100.0, f64::INFINITY)),
        (-20.0, Some(6), (0.0, 100.0)),
        (14.0, None, everything),
        (-14.0, None, everything),
    ] {
        let mut engine = Monitors::new(1, 1.0);
        let findings: Vec<_> = (1..=20)
            .map(|tick| update(&mut engine, 100.0, if tick == 1 { size } else { 0.0 }, 0.0))
            .collect();
        let first = findings.iter().position(|finding| *finding != NOTHING);
        assert_eq!(first.map(|tick| tick + 1), found, "{size} N");
        assert!(findings[first.unwrap_or(20)..].iter().all(|finding| *finding == OUT_OF_REACH), "{size} N");
        assert_eq!(engine.conditions[0].reaches, range, "{size} N");
        assert!(!engine.conditions[0].is_lost(&descent(), 120.0));
    }
}

/// An engine that is asked for more than 80 N without giving it, then for less, keeps its thrust: it is lost. So is one
/// that fades, once it gives less than 30 N.
#[test]
fn an_engine_whose_bounds_are_close_together_is_lost() {
    let mut stuck = Monitors::new(1, 1.0);
    for tick in 0..100 {
        let _ = update(&mut stuck, 80.0, if tick < 50 { -1.0 } else { 1.0 }, 0.0);
        let engine = stuck.conditions[0];
        assert_eq!(engine.is_lost(&descent(), 120.0), engine.reaches == (80.0, 80.0), "tick {tick}");
    }
    assert_eq!(stuck.conditions[0].reaches, (80.0, 80.0));
    let (mut fading, mut thrust) = (Monitors::new(1, 1.0), 100.0);
    for _ in 0..50 {
        thrust -= 2.0;
        let _ = update(&mut fading, thrust, -2.0, 0.0);
        assert_eq!(fading.conditions[0].is_lost(&descent(), 120.0), thrust < 30.0, "{thrust} N");
    }
    assert_eq!(fading.conditions[0].reaches, (0.0, thrust));
}

/// A deviation after lags with shares `a` and `b` is, a step of `d` being forgotten by `f` per tick,
/// `d Σ a (1 − a)^i b (1 − b)^j f^l` over `i + j + l = k − 1`; it is compared with what the momentum says.
#[test]
fn a_deviation_is_as_late_as_the_momentum() {
    let (share, deviation) = (0.2_f64, 40.0);
    let (forgotten, residual) = ((-STEP / 0.5_f64).exp(), -(-STEP / 0.02_f64).exp_m1());
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
    let first = (1..100).find(|tick| late(*tick) > CONFIG.deviation_max).unwrap() + 3;
    for (part, expected) in [(0.49, OUT_OF_REACH), (0.51, WRONG_SENSOR)] {
        let mut engine = Monitors::new(1, share);
        for tick in 1..=first {
            let innovation = if tick == 1 { deviation } else { 0.0 };
            let found = update(&mut engine, 100.0, innovation, part * late(tick));
            assert_eq!(found, if tick == first { expected } else { NOTHING }, "tick {tick}");
        }
    }
}

/// Sensors that say too much put `−Σ a d` into the momentum: half of it is not enough, and forces count less than
/// moments.
#[test]
fn wrong_sensors_explain_the_momentum() {
    let wrench = Vector6::new(3.0, -6.0, 97.0, 0.5, 3.0, -1.0);
    for (share, expected) in [(-1.0, true), (-0.51, true), (-0.49, false), (0.0, false), (1.0, false)] {
        assert_eq!(explains(&wrench, &(share * wrench)), expected, "{share}");
    }
    let push = Vector6::new(0.0, 0.0, -1000.0, 0.0, 0.0, 0.0);
    let (up, turn) = (Vector6::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0), Vector6::new(0.0, 0.0, 0.0, 0.3, 0.0, 0.0));
    assert!(explains(&up, &push));
    assert!(!explains(&turn, &push));
    assert!(!explains(&(30.0 * up + 30.0 * turn), &(-20.0 * up)), "the moment is not there");
    assert!(!explains(&Vector6::repeat(f64::NAN), &push));
}

/// All sensors say 25 N too much at once: their moments cancel, their forces do not.
#[test]
fn a_common_step_is_of_the_sensors_where_the_force_shows_it() {
    for (shown, expected) in [(25.0, WRONG_SENSOR), (0.0, OUT_OF_REACH)] {
        let mut engines = Monitors::new(4, 1.0);
        let found = (1..=20)
            .map(|tick| {
                let sample = held(100.0, if tick == 1 { 25.0 } else { 0.0 });
                engines.tick(&[sample; 4], Some(&[shown; 4]))
            })
            .find(|found| found.iter().any(|found| *found != NOTHING));
        assert_eq!(found, Some(vec![expected; 4]), "{shown} N");
    }
}

/// An engine whose throttle is at its stop follows 100 N/s late, by more than the limit: it does what it can. So does a
/// jet that follows at once. A sensor that is wrong after that is found.
#[test]
fn an_engine_that_follows_as_fast_as_it_can_is_not_limited() {
    let robot = load_robot(&experiment("test2_observer").robot).unwrap();
    let model = robot.jets[0].engine;
    for lags in [true, false] {
        let mut monitor = Monitors::new(1, 1.0);
        let mut engine = EngineDynamics::new(model, 60.0, 0.0);
        let mut throttle = ThrustRateController::new(model.steady_throttle(60.0));
        let (mut farthest, mut before) = (0.0_f64, 60.0);
        for tick in 0..300 {
            let command = if tick % 100 < 50 { 100.0 } else { -100.0 };
            if lags {
                let rate = engine.thrust_rate;
                engine.step(throttle.update(&model, engine.thrust, rate, command), STEP);
            } else {
                engine.thrust += STEP * command;
            }
            let innovation = engine.thrust - (before + STEP * command);
            before = engine.thrust;
            let sample =
                EngineSample { thrust: before, innovation, is_measured: true, is_of_speed: false, command };
            assert_eq!(monitor.tick(&[sample], Some(&[0.0])), [NOTHING], "tick {tick}, lags: {lags}");
            farthest = farthest.max(monitor.each[0].deviation.abs());
        }
        assert_eq!(farthest > CONFIG.deviation_max, lags, "{farthest} N");
        let mut found = NOTHING;
        for tick in 0..60 {
            let innovation = if tick == 0 { 40.0 } else { 0.0 };
            found = update(&mut monitor, before, innovation, 40.0);
            if found != NOTHING {
                break;
            }
        }
        assert_eq!(found, WRONG_SENSOR, "lags: {lags}");
    }
}

/// Only what the momentum shows, and shows on the same side, is a sensor.
#[test]
fn the_momentum_shows_a_wrong_sensor() {
    for deviation in [30.0, -30.0] {
        for (share, expected) in
            [(0.9, WRONG_SENSOR), (0.0, OUT_OF_REACH), (-0.9, OUT_OF_REACH), (f64::NAN, OUT_OF_REACH)]
        {
            let mut engine = Monitors::new(1, 1.0);
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
    let mut engine = Monitors::new(1, 1.0);
    let mut update = |innovation: f64, sensor_error: Option<f64>| {
        engine.tick(&[held(100.0, innovation)], sensor_error.as_ref().map(std::slice::from_ref))[0]
    };
    assert_eq!(update(-30.0, None), NOTHING);
    for _ in 0..10 {
        assert_eq!(update(0.0, None), NOTHING);
    }
    let findings: Vec<_> = (0..8).map(|_| update(0.0, Some(0.0))).collect();
    let found = findings.iter().position(|finding| *finding == OUT_OF_REACH);
    assert!(findings[..found.unwrap()].iter().all(|finding| *finding == NOTHING));
    assert!(found.unwrap() > 3, "{findings:?}");
}

/// A thrust that is not reached is found at the first measurement after its confirmation, of one in every five ticks.
#[test]
fn a_momentum_with_a_rate_of_its_own_judges_when_it_is_measured() {
    for (is_between, found) in [(true, Some(10)), (false, None)] {
        let mut engine = Monitors::new(1, 1.0);
        let first = (1..=40).find(|tick| {
            let sample = [held(100.0, if *tick == 1 { 20.0 } else { 0.0 })];
            let measured = (tick % 5 == 0).then_some(&[0.0][..]);
            engine.tick_between(&sample, measured, is_between)[0] == OUT_OF_REACH
        });
        assert_eq!(first, found);
    }
}

/// An engine that runs has at least its least thrust, also if it was found to reach less; one that stopped has what is
/// left of it.
#[test]
fn the_least_thrust_is_that_of_a_running_engine() {
    let config = experiment("test2_observer");
    let mut robot = load_robot(&config.robot).unwrap();
    robot.jets.iter_mut().for_each(|jet| jet.thrust_min = 11.0);
    let mut limits = Limits::new(config.controller.law.momentum, &robot);
    let engines = EngineLimits::new(None, &limits, &robot);
    let limited = |reaches| EngineCondition { state: EngineState::Limited, reaches, ..Default::default() };
    let conditions =
        [EngineCondition::default(), limited((0.0, 80.0)), limited((0.0, 2.0)), limited((60.0, 90.0))];
    assert!(!engines.limit(&conditions, false, &mut limits), "without a descent none is lost");
    assert_eq!(limits.works, [true, false, false, false]);
    assert_eq!(limits.thrust, [(11.0, 160.0), (11.0, 80.0), (2.0, 2.0), (60.0, 90.0)]);
}

/// On the way down revolute joints are as fast as the descent says where their own limits are less; sliding ones are not:
/// degrees and newton metres are not theirs.
#[test]
fn the_limits_of_a_descent_are_those_of_revolute_joints() {
    let descent =
        experiment("test2_observer").controller.law.fault_detection.engines.unwrap().descent.unwrap();
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

/// Without momentum only a sensor that lacks three quarters of the thrust, and more than twice the limit of 15 N, counts,
/// after 0.05 s; what 40 N more or less say of an engine says nothing.
#[test]
fn without_momentum_only_a_stop_is_found() {
    for (thrust, before, found) in [
        (0.0, 100.0, Some(6)),
        (24.0, 100.0, Some(6)),
        (26.0, 100.0, None),
        (60.0, 100.0, None),
        (140.0, 100.0, None),
        (0.0, 29.0, None),
        (0.0, 31.0, Some(6)),
    ] {
        let mut engine = Monitors::new(1, 1.0);
        let first = (1..=8).find(|tick| {
            let innovation = if *tick == 1 { thrust - before } else { 0.0 };
            engine.tick(&[held(thrust, innovation)], None)[0] == OUT_OF_REACH
        });
        assert_eq!(first, found, "{thrust} of {before} N");
        if found.is_some() {
            let EngineCondition { state, reaches, is_sensor_used, .. } = engine.conditions[0];
            assert_eq!((state, reaches, is_sensor_used), (EngineState::Unconfirmed, (0.0, thrust), true));
        }
    }
}

/// Between two measurements of the momentum it is waited for; several sensors that say so at once are wrong.
#[test]
fn a_stop_without_momentum_is_that_of_one_engine_in_a_gap() {
    let (stopped, works) = (|first| held(0.0, if first { -100.0 } else { 0.0 }), held(100.0, 0.0));
    let mut between = Monitors::new(2, 1.0);
    for tick in 0..15 {
        assert_eq!(between.tick_between(&[stopped(tick == 0), works], None, true), [NOTHING; 2]);
    }
    assert_eq!(between.tick(&[stopped(false), works], None), [OUT_OF_REACH, NOTHING], "it has lasted");
    let mut both = Monitors::new(2, 1.0);
    for tick in 0..15 {
        assert_eq!(both.tick(&[stopped(tick == 0); 2], None), [NOTHING; 2]);
    }
}

/// Momentum that is measured again shows the thrust of an engine that works: three ticks revoke the stop, and the sensor is not
/// used any more. Eleven ticks without that keep it, for good.
#[test]
fn momentum_revokes_a_stop_that_was_found_without_it_or_keeps_it() {
    for (shown, ticks, state) in [
        (100.0, 3, EngineState::Works),
        (51.0, 3, EngineState::Works),
        (49.0, 11, EngineState::Limited),
        (0.0, 11, EngineState::Limited),
        (-100.0, 11, EngineState::Limited),
    ] {
        let mut engine = Monitors::new(1, 1.0);
        for tick in 0..10 {
            engine.tick(&[held(0.0, if tick == 0 { -100.0 } else { 0.0 })], None);
        }
        let lacked = engine.conditions[0].taken.thrust;
        assert_eq!(lacked, 100.0, "nothing is forgotten");
        // A sensor that says too little by so much.
        let error = -shown / 100.0 * lacked;
        let changed = (1..40).find(|_| {
            engine.tick(&[held(0.0, 0.0)], Some(&[error]));
            engine.conditions[0].state != EngineState::Unconfirmed
        });
        let EngineCondition { state: found, reaches, is_sensor_used, .. } = engine.conditions[0];
        assert_eq!((changed, found), (Some(ticks), state), "{shown} %");
        let is_revoked = state == EngineState::Works;
        assert_eq!((reaches == EVERYTHING, is_sensor_used), (is_revoked, !is_revoked));
    }
}

/// The table of transitions, row by row: every pair of state and finding, what it changes, and the correction of the thrust.
#[test]
#[allow(clippy::match_same_arms, reason = "a row of the table each")]
fn the_table_of_transitions() {
    use EngineFinding as Found;
    use EngineState::{Limited, Stopped, Unconfirmed, Works};
    let short = Found::OutOfReach { thrust: 70.0, is_short: true };
    let unseen = Found::StoppedUnseen { thrust: 1.0, lacks: 90.0 };
    let agreed = Found::Agreed { thrust: 60.0 };
    let wrong = Found::WrongSensor { error: 25.0 };
    let narrowed = (0.0, 80.0);
    let findings = [Found::Nothing, wrong, short, unseen, Found::Kept, Found::Given, agreed, Found::Missing];
    for (state, reaches) in
        [(Works, EVERYTHING), (Limited, narrowed), (Unconfirmed, (0.0, 1.0)), (Stopped, (0.0, 0.0))]
    {
        for finding in findings {
            let mut engine =
                EngineCondition { state, reaches, is_sensor_used: state != Stopped, ..Default::default() };
            (engine.taken.thrust, engine.taken.reaches, engine.since) = (95.0, narrowed, 3.0);
            let before = engine;
            let error = engine.advance(finding, 100.0, STEP);
            let least = reaches.0;
            let expected = match (state, finding) {
                (Works | Limited, Found::WrongSensor { .. }) => (state, reaches, false, Some(25.0)),
                (Works | Limited, Found::OutOfReach { .. }) => (Limited, (least, 70.0), true, None),
                (Works | Limited, Found::StoppedUnseen { .. }) => (Unconfirmed, (0.0, 1.0), true, None),
                (Works | Limited, Found::Missing) => (Stopped, (0.0, 0.0), false, Some(100.0)),
                (Unconfirmed, Found::Kept) => (Limited, (0.0, 1.0), true, None),
                (Unconfirmed, Found::Given) => (Limited, narrowed, false, Some(-95.0)),
                (Stopped, Found::Given) => (Limited, narrowed, true, Some(5.0)),
                (Stopped, Found::Agreed { .. }) => (Limited, narrowed, true, Some(40.0)),
                (Stopped, _) => (Stopped, (0.0, 0.0), false, Some(100.0)),
                _ => (before.state, before.reaches, before.is_sensor_used, None),
            };
            let found = (engine.state, engine.reaches, engine.is_sensor_used, error);
            assert_eq!(found, expected, "{state:?}, {finding:?}");
            let is_changed = found.0 != state || found.1 != reaches || found.2 != before.is_sensor_used;
            let since = if is_changed { (finding, 0.0) } else { (before.evidence, before.since + STEP) };
            assert_eq!((engine.evidence, engine.since), since, "{state:?}, {finding:?}");
        }
    }
    for one in findings {
        for other in findings {
            assert_eq!(one.or(other), other.or(one), "the order of detectors has no meaning");
        }
    }
}

/// An engine is lost as long as its condition says so: the limits of the descent, and no longer.
#[test]
fn an_engine_that_works_again_gives_the_usual_limits_back() {
    let config = experiment("test2_observer");
    let robot = load_robot(&config.robot).unwrap();
    let usual = Limits::new(config.controller.law.momentum, &robot);
    let engines = EngineLimits::new(Some(descent()), &usual, &robot);
    let mut conditions = [EngineCondition::default(); 4];
    let limits = |conditions: &[EngineCondition], is_standing| {
        let mut limits = usual.clone();
        (engines.limit(conditions, is_standing, &mut limits), limits)
    };
    let thrust = 100.0;
    conditions[2].advance(EngineFinding::Missing, thrust, STEP);
    let (is_lost, of_descent) = limits(&conditions, false);
    assert!(is_lost && !of_descent.holds_position && of_descent.thrust[2] == (0.0, 0.0));
    let (is_lost, standing) = limits(&conditions, true);
    assert!(is_lost && standing.holds_position && standing.thrust[2] == (0.0, 0.0));
    conditions[2].advance(EngineFinding::Given, 0.0, STEP);
    assert_eq!(limits(&conditions, false), (false, usual.clone()));
}

/// A sensor that is wrong for a while without momentum leaves nothing that would be judged when there is one again.
#[test]
fn an_error_that_comes_and_goes_without_momentum_is_no_engine() {
    for error in [40.0, -40.0] {
        let mut engine = Monitors::new(1, 1.0);
        for tick in 0..100 {
            let innovation = match tick {
                10 => error,
                60 => -error,
                _ => 0.0,
            };
            assert_eq!(engine.tick(&[held(60.0, innovation)], None), [NOTHING]);
        }
        assert_eq!(engine.each[0].deviation, 0.0);
        for _ in 0..20 {
            assert_eq!(engine.tick(&[held(60.0, 0.0)], Some(&[0.0])), [NOTHING]);
        }
    }
}
