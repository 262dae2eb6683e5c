//! The controller tick by tick: safe commands, bounds, feedback that can be left out, and refusals.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{
    Loop, Running, TIME_STEP, assert_within, at, experiment, rng, robot, tick_at, uniform_estimator,
};
use crate::setpoint::distance_to_rest;
use flight_core::control::config::Solver;
use flight_core::control::estimate::estimator::{EstimatorConfig, FilterConfig, LatencyConfig};
use flight_core::control::law::bounds::LimitedValues;
use flight_core::control::law::mission::Commands;
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::law::torque::limit_rate;
use flight_core::control::limits::JointCondition;
use flight_core::control::{BadCommand, Modes};
use flight_core::jets::JetDynamics;
use flight_core::qp::QpStatus;
use flight_core::spatial::{Pose, axis_angle};
use flight_core::{Command, Measurement, RobotState};
use flight_io::{AeroConfig, load_robot};
use flight_sim::{Plant, ScenarioConfig};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::RngExt;
use serde_json::json;

const WIND: [f64; 3] = [2.0, -9.0, 1.0];

fn wind() -> Vector3<f64> {
    Vector3::from(WIND)
}

fn controller(config: &ScenarioConfig) -> Running {
    let robot = load_robot(&config.robot).unwrap();
    Running::new(config.controller(robot).unwrap())
}

/// What tests do with a measurement.
pub trait Sample: Sized {
    fn start(config: &ScenarioConfig) -> Self;
    fn tick<'a>(&self, controller: &'a mut Running) -> &'a Command;
}

impl Sample for Measurement {
    /// The robot as its flight starts.
    fn start(config: &ScenarioConfig) -> Self {
        let robot = load_robot(&config.robot).unwrap();
        let plant =
            Plant::new(robot, &config.simulator, &config.disturbances, &config.controller.law).unwrap();
        Self { wind: wind(), ..at(0.0, plant.state(), plant.jets().thrust()) }
    }

    fn tick<'a>(&self, controller: &'a mut Running) -> &'a Command {
        controller.tick(self)
    }
}

/// Everything commanded, in one vector.
fn numbers(command: &Command) -> Vec<f64> {
    let Command { thrust_rate, joint_velocity, joint_torque, .. } = command;
    thrust_rate.iter().chain(joint_velocity).chain(joint_torque).copied().collect()
}

#[track_caller]
fn assert_equal(what: &str, a: &[f64], b: &[f64], tolerance: f64) {
    assert_eq!(a.len(), b.len(), "{what}");
    let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert_within!(worst, tolerance, "{what}: {worst:e} apart");
}

type Spoil = (&'static str, fn(&mut Measurement));

/// Every part of a measurement, spoilt.
const SPOILT: [Spoil; 15] = [
    ("a thrust too few", |sample| sample.thrust.truncate(3)),
    ("a thrust too many", |sample| sample.thrust.push(100.0)),
    ("a joint too few", |sample| {
        let mut state = RobotState::zero(22);
        state.base = sample.state.base;
        sample.state = state;
    }),
    ("time", |sample| sample.time = f64::NAN),
    ("infinite time", |sample| sample.time = f64::INFINITY),
    ("base position", |sample| sample.state.base.position.y = f64::NAN),
    ("base rotation", |sample| sample.state.base.rotation[(2, 1)] = f64::NAN),
    ("joint position", |sample| sample.state.joint_position[22] = f64::NAN),
    ("infinite joint position", |sample| sample.state.joint_position[0] = f64::NEG_INFINITY),
    ("base linear velocity", |sample| sample.state.velocity[0] = f64::NAN),
    ("base angular velocity", |sample| sample.state.velocity[5] = f64::NAN),
    ("joint velocity", |sample| sample.state.velocity[28] = f64::NAN),
    ("thrust", |sample| sample.thrust[3] = f64::NAN),
    ("infinite thrust", |sample| sample.thrust[0] = f64::INFINITY),
    ("wind", |sample| sample.wind.z = f64::NAN),
];

/// How many of them are of another robot.
const OF_ANOTHER_ROBOT: usize = 3;

/// A measurement that is not of this robot: nothing moves, torques stay, and the next good tick follows the set-point
/// of its time, as if the bad one had not been.
#[test]
fn bad_measurements_hold_the_last_torques() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let [second, third] = [0.01, 0.02].map(|time| Measurement { time, ..good.clone() });
    let mut undisturbed = controller(&config);
    good.tick(&mut undisturbed);
    // The integral of a tick that held is that of the tick before.
    let integral = undisturbed.state().velocity_error_integral().clone();
    second.tick(&mut undisturbed);
    let state = undisturbed.state().clone();
    let (posture, inertia) = (state.posture().clone(), *state.inertia_0_b());
    undisturbed.state = Some(state.with_posture_control(posture, inertia, integral).unwrap());
    let expected = third.tick(&mut undisturbed).clone();
    let setpoint = undisturbed.terms().setpoint;
    for (what, spoil) in &SPOILT[..OF_ANOTHER_ROBOT] {
        let mut controller = controller(&config);
        let torque = good.tick(&mut controller).joint_torque.clone();
        assert!(torque.amax() > 1.0);
        let mut bad = second.clone();
        spoil(&mut bad);
        let command = bad.tick(&mut controller);
        assert!(command.modes.contains(Modes::MEASUREMENT_IGNORED), "{what}");
        assert_eq!(command.thrust_rate.amax(), 0.0, "{what}");
        assert_eq!(command.joint_velocity.amax(), 0.0, "{what}");
        assert_eq!(command.joint_torque, torque, "{what}");
        for answer in [command.rates_qp, command.torque_qp] {
            assert_eq!(answer.status, QpStatus::NonFinite);
            assert!(answer.kkt.is_nan() && answer.iterations == 0);
        }
        let command = third.tick(&mut controller).clone();
        assert_eq!(command.modes, Modes::default(), "{what}");
        assert_eq!(controller.terms().setpoint, setpoint, "{what}");
        // The warm start differs, so the answers agree to the accuracy of the QP.
        let rates = (&command.thrust_rate - &expected.thrust_rate).amax();
        let velocities = (&command.joint_velocity - &expected.joint_velocity).amax();
        assert!(rates <= 1e-7 && velocities <= 1e-9, "{what}: {rates:e} N/s, {velocities:e} rad/s");
    }
}

/// During an outage the set-point moves on, so a climb that is interrupted ends where it would have ended.
#[test]
fn the_setpoint_moves_on_while_measurements_are_bad() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let fly = |outage: std::ops::Range<u32>| {
        let mut controller = controller(&config);
        for tick in 0..1800 {
            let mut sample = Measurement { time: f64::from(tick) * 0.01, ..good.clone() };
            if outage.contains(&tick) {
                sample.wind.x = f64::NAN;
                sample.time = if tick % 2 == 0 { f64::NAN } else { sample.time };
            }
            sample.tick(&mut controller);
        }
        controller.terms().setpoint
    };
    let (undisturbed, disturbed) = (fly(0..0), fly(1200..1300));
    let difference = (undisturbed.com_position - disturbed.com_position).amax();
    assert_eq!(difference, 0.0, "{difference} m");
    assert!(undisturbed.com_position.z > 5.0);
}

/// A bad first measurement starts nothing, and says what is wrong; the flight starts with the first good one.
#[test]
fn a_bad_first_measurement_starts_nothing() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let refused = |spoil: &dyn Fn(&mut Measurement)| {
        let mut bad = good.clone();
        spoil(&mut bad);
        controller(&config).controller.start(&bad).unwrap_err().to_string()
    };
    for (what, spoil) in &SPOILT[..OF_ANOTHER_ROBOT] {
        assert!(refused(spoil).contains("expected 23 joints, 4 thrusts, 0 feet"), "{what}");
    }
    for (what, spoil) in SPOILT[OF_ANOTHER_ROBOT..].iter().filter(|(what, _)| *what != "wind") {
        let (reason, name) = (refused(spoil), what.trim_start_matches("infinite ").replace(' ', "_"));
        assert!(reason.contains(&format!("`{name}` holds ")), "{what}: {reason}");
    }
    assert!(
        refused(&|sample| sample.state.base.rotation[(0, 0)] += 0.1)
            .contains("`base_rotation` is not a rotation")
    );
    assert!(refused(&|sample| sample.time = -0.5).contains("`time` holds -0.5; expected 0 to 1e9 s"));
    let reason = refused(&|sample| sample.state.base.position.fill(1e308));
    assert!(reason.contains("the inertia of the robot cannot be inverted"), "{reason}");
    let mut controller = controller(&config);
    good.tick(&mut controller);
    assert_eq!(controller.state().posture(), &good.state.joint_position);
}

/// A flight can begin without a measured wind: in still air until there is one, and degraded.
#[test]
fn a_flight_begins_without_a_wind() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let tick = |wind: Vector3<f64>| {
        let mut controller = controller(&config);
        let command = Measurement { wind, ..good.clone() }.tick(&mut controller).clone();
        (controller, command)
    };
    let (mut controller, unknown) = tick(Vector3::repeat(f64::NAN));
    let (_, still) = tick(Vector3::zeros());
    assert_eq!(unknown.modes, Modes::WIND_HELD);
    assert_eq!(numbers(&unknown), numbers(&still));
    let second = Measurement { time: 0.01, ..good.clone() };
    assert_eq!(second.tick(&mut controller).modes, Modes::default());
}

/// First thrusts and a first wind that are not accepted count as none, in the law as in an estimator.
#[test]
fn a_flight_begins_without_what_is_not_accepted() {
    let late = uniform_estimator(FilterConfig { delay: 3.0 * TIME_STEP, time_constant: 0.0 });
    for estimator in [None, Some(late)] {
        let mut config = experiment("test2");
        config.controller.law.estimator = estimator;
        let good = Measurement::start(&config);
        // Before the late one is the latest, what it says is used for nothing else.
        let commands = |thrust: f64, wind: f64| {
            let mut controller = controller(&config);
            let first = Measurement { thrust: vec![thrust; 4], wind: Vector3::y() * wind, ..good.clone() };
            let first = first.tick(&mut controller).clone();
            let mut all = vec![first.clone()];
            for tick in 1..=3 {
                let next = Measurement { time: f64::from(tick) * TIME_STEP, ..good.clone() };
                all.push(next.tick(&mut controller).clone());
            }
            (first.modes, all.iter().map(numbers).collect::<Vec<_>>())
        };
        let (modes, found) = commands(2201.0, -301.0);
        let (_, expected) = commands(0.0, 0.0);
        assert!(modes.contains(Modes::WIND_HELD) && modes.contains(Modes::THRUST_MODELLED));
        assert_eq!(found, expected);
    }
}

/// A base rotation that is none, a time before the flight or in a million years, a set-point that is none.
#[test]
fn what_is_no_rotation_or_time_is_predicted() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let spoilt: [Spoil; 5] = [
        ("stretched", |sample| sample.state.base.rotation *= 1.5),
        ("mirrored", |sample| sample.state.base.rotation.column_mut(0).neg_mut()),
        ("two signs", |sample| {
            sample.state.base.rotation[(0, 0)] *= -1.0;
            sample.state.base.rotation[(1, 0)] += 0.1;
        }),
        ("before", |sample| sample.time = -1e9),
        ("long after", |sample| sample.time = 1e18),
    ];
    for (what, spoil) in spoilt {
        let mut controller = controller(&config);
        good.tick(&mut controller);
        let mut bad = good.clone();
        spoil(&mut bad);
        let command = bad.tick(&mut controller);
        let expected = if bad.time == good.time { Modes::ROTATION_PREDICTED } else { Modes::CLOCK_PREDICTED };
        assert_eq!(command.modes, expected, "{what}");
        let rotation = &controller.terms().kinematics.bodies[0].i_from_b.rotation;
        assert_within!((rotation - good.state.base.rotation).amax(), 0.01, "{what}");
    }
    let mut controller = controller(&config);
    good.tick(&mut controller);
    let mut setpoint = controller.terms().setpoint;
    setpoint.rotation *= 5.0;
    let command = controller.tick_towards(&good, &setpoint);
    assert!(command.modes.contains(Modes::SETPOINT_IGNORED));
    // Finite, but its filter would overflow, and for good.
    let mut setpoint = Setpoint::at_rest(setpoint.com_position, good.state.base.rotation);
    for (speed, modes) in [(1e308, Modes::SETPOINT_IGNORED), (0.1, Modes::default())] {
        setpoint.angular_velocity_b.z = speed;
        assert_eq!(controller.tick_towards(&good, &setpoint).modes, modes, "{speed} rad/s");
    }
}

/// Without a set-point that is one the robot comes to rest from the last one on, and what is measured is used.
#[test]
fn without_a_set_point_the_last_one_comes_to_rest() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let mut controller = controller(&config);
    good.tick(&mut controller);
    let mut given = controller.terms().setpoint;
    (given.com_position.x, given.com_velocity) = (given.com_position.x + 0.1, Vector3::new(0.2, 0.0, 0.0));
    let none = Setpoint { com_jerk: Vector3::repeat(f64::NAN), ..given };
    let mut time = 0.0;
    let mut towards = |setpoint: &Setpoint| {
        time += TIME_STEP;
        let sample = Measurement { time, ..good.clone() };
        let modes = controller.tick_towards(&sample, setpoint).modes;
        assert_within!((controller.state().time() - time).abs(), 1e-15);
        (modes, controller.terms().setpoint)
    };
    assert_eq!(towards(&given), (Modes::default(), given));
    let (modes, first) = towards(&none);
    assert_eq!(modes, Modes::SETPOINT_IGNORED);
    let moved = (first.com_position - given.com_position - given.com_velocity * TIME_STEP).amax();
    assert_within!(moved, 1e-5, because "it goes on as it was, but for what a tick brakes");
    assert_eq!(first.rotation, given.rotation);
    let mut last = first;
    for _ in 0..2000 {
        last = towards(&none).1;
    }
    let rest = given.com_position + given.com_velocity / 0.2 * distance_to_rest(0.2, 0.015);
    assert_within!((last.com_position - rest).amax(), 1e-6, because "20 s are many smoothing times");
    assert_within!(last.com_velocity.amax(), 1e-6);
}

/// The centre of mass touches down where it was at the first tick; from the first measured height on, as high above the ground
/// as it is above the base that stands there.
#[test]
fn the_ground_is_where_the_height_says() {
    let config = experiment("robot");
    let mut controller = controller(&config);
    let first = Measurement::start(&config);
    first.tick(&mut controller);
    let com = controller.terms().kinematics.com.z;
    let base = first.state.base.position.z;
    assert!((com - base).abs() > 0.01);
    assert_within!((controller.state().touch_down() - com).abs(), 1e-12);
    for tick in 1..4 {
        let height = 2.5 - 1e-3 * f64::from(tick);
        Measurement { time: 0.01 * f64::from(tick), height, ..first.clone() }.tick(&mut controller);
        let above = controller.state().estimate().robot.state.base.position.z - height;
        assert_within!((controller.state().touch_down() - (above + com - base)).abs(), 1e-12, "{tick}");
    }
}

/// The ground sinks at once, and rises by 0.5 m/s, also between heights that are measured every third tick.
#[test]
fn the_ground_rises_slowly_and_sinks_at_once() {
    let config = experiment("robot");
    let mut controller = controller(&config);
    let first = Measurement::start(&config);
    let mut ground = |tick: u32, height: f64| {
        let mut sample = Measurement { time: 0.01 * f64::from(tick), height, ..first.clone() };
        sample.state.base.position.x += 1e-6 * f64::from(tick); // no sensor that repeats itself
        sample.tick(&mut controller);
        let state = controller.state();
        (state.touch_down(), state.estimate().robot.state.base.position.z - height)
    };
    let (start, above) = ground(0, 2.0);
    let stance = start - above;
    let risen = [ground(1, 1.96), ground(2, f64::NAN), ground(3, f64::NAN), ground(4, 1.9601)];
    for ((found, _), expected) in risen.into_iter().zip([0.005, 0.005, 0.005, 0.02]) {
        assert_within!((found - start - expected).abs(), 1e-12);
    }
    let (found, above) = ground(5, 2.1);
    assert_within!((found - above - stance).abs(), 1e-12, because "it sinks to what is measured");
    let (found, above) = (6..40).map(|tick| ground(tick, 2.05 + 1e-6 * f64::from(tick))).last().unwrap();
    assert_within!((found - above - stance).abs(), 1e-12, because "it rises no farther than to what is measured");
}

/// A landing is slow less than 2.5 m above the ground that is measured, or else that of the start.
#[test]
fn a_landing_asks_for_the_measured_ground() {
    let mut config = experiment("robot");
    config.mission.commands = Commands { land: vec![(0.0, 9.0)], ..Commands::default() };
    for (height, expected) in [(f64::NAN, -0.2), (2.4, -0.2), (2.6, -0.75)] {
        let mut controller = controller(&config);
        let first = Measurement { height, ..Measurement::start(&config) };
        first.tick(&mut controller);
        Measurement { time: 0.01, ..first }.tick(&mut controller);
        let speed = controller.state().setpoint().raw().velocity.z;
        assert_within!((speed - expected).abs(), 1e-12, "{height} m");
    }
}

/// A robot that has to go down follows no given set-point: it descends from the last one.
#[test]
fn on_the_way_down_no_set_point_is_followed() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let mut controller = controller(&config);
    good.tick(&mut controller);
    let given = Setpoint::at_rest(controller.terms().setpoint.com_position, good.state.base.rotation);
    let mut lost = good.clone();
    lost.state.base.position.fill(f64::NAN);
    let mut heights = vec![];
    for _ in 0..1000 {
        lost.time += TIME_STEP;
        controller.tick_towards(&lost, &given);
        let is_descending = controller.command().modes.contains(Modes::DESCENDING);
        assert_eq!(is_descending, lost.time > 3.0 + 0.5 * TIME_STEP, "{}", lost.time);
        if is_descending {
            heights.push(controller.terms().setpoint.com_position.z);
        } else {
            assert_eq!(controller.terms().setpoint, given);
        }
    }
    let speed = (heights[heights.len() - 2] - heights[heights.len() - 1]) / TIME_STEP;
    assert_within!((speed - config.controller.law.setpoint.descent_speed).abs(), 1e-3);
}

/// A measurement of another robot moves the time on by its own, or by a tick where that is no time.
#[test]
fn time_goes_on_without_a_measurement() {
    let config = experiment("test2");
    let good = Measurement::start(&config);
    let mut controller = controller(&config);
    good.tick(&mut controller);
    for (time, expected) in [(0.5, 0.5), (f64::NAN, 0.5 + TIME_STEP)] {
        let bad = Measurement { time, thrust: vec![], ..good.clone() };
        assert!(controller.tick(&bad).modes.contains(Modes::MEASUREMENT_IGNORED));
        assert_eq!(controller.state().time(), expected);
    }
}

/// While measurements are of another robot both predictions go on, under rates of zero and the last torques: what is
/// measured afterwards is no jump, and what is not is known.
#[test]
fn predictions_go_on_while_measurements_are_bad() {
    let blind = uniform_estimator(FilterConfig { delay: 0.0, time_constant: 1e9 });
    for estimator in [None, Some(blind)] {
        let mut config = experiment("test2");
        config.simulator.joint_stops = false;
        config.simulator.initial.base_velocity[0] = 7.5;
        config.controller.law.channels.jump = true;
        config.controller.law.estimator = estimator;
        let mut world = Loop::new(&config);
        world.run(0.1, |_| wind());
        let next = |world: &mut Loop| {
            world.advance(&wind());
            world.plant.observe(&wind());
            world.sample(wind())
        };
        let begin = world.plant.state().base.position;
        for _ in 0..10 {
            let sample = next(&mut world);
            let bad = Measurement { thrust: vec![], ..sample.clone() };
            assert!(world.controller.tick(&bad).modes.contains(Modes::MEASUREMENT_IGNORED));
        }
        let mut sample = next(&mut world);
        let moved = (sample.state.base.position - begin).norm();
        assert!(moved > 2.0 * 0.3, "{moved} m");
        sample.thrust.fill(f64::NAN);
        assert_eq!(world.controller.tick(&sample).modes, Modes::THRUST_MODELLED);
        let (used, truth) = (&world.controller.state().estimate(), world.plant.state());
        for (used, truth) in used.robot.thrust.iter().zip(world.plant.jets().thrust()) {
            assert_within!((used - truth).abs(), 1e-9);
        }
        // Velocities near 10 rad/s, by a mass matrix with a condition of 1e4.
        assert_within!((&used.robot.state.velocity - &truth.velocity).amax(), 1e-9);
    }
}

/// What acts in the place of a command is what both predictions follow: that of the channels, for a tick in which nothing
/// is measured, and that of an estimator, which hardly looks at what is.
#[test]
fn predictions_follow_a_replaced_command() {
    let estimator = uniform_estimator(FilterConfig { delay: 0.0, time_constant: 1e9 });
    for estimator in [None, Some(estimator)] {
        let mut config = experiment("test2");
        config.simulator.joint_stops = false;
        config.controller.law.estimator = estimator;
        let has_estimator = config.controller.law.estimator.is_some();
        let mut world = Loop::new(&config);
        world.run(0.05, |_| wind());
        let torque: Vec<f64> =
            world.controller.command().joint_torque.iter().map(|torque| 0.9 * torque + 0.1).collect();
        let rate: Vec<f64> =
            world.controller.command().thrust_rate.iter().map(|rate| 0.5 * rate - 3.0).collect();
        let Running { controller, state } = &mut world.controller;
        let before = state.clone().unwrap();
        let state = state.as_mut().unwrap();
        for wrong in [&rate[1..], &[f64::NAN; 4]] {
            assert_eq!(controller.replace_command(state, wrong, &torque), Err(BadCommand));
            assert_eq!(*state, before);
        }
        // Torques in N mm, and rates that no engine follows.
        let (thousandths, fast) = (torque.iter().map(|torque| 1000.0 * torque).collect::<Vec<_>>(), [1e5; 4]);
        for (rate, torque) in [(&rate[..], &thousandths[..]), (&fast, &torque)] {
            assert_eq!(controller.replace_command(state, rate, torque), Err(BadCommand));
            assert_eq!(*state, before);
        }
        controller.replace_command(state, &rate, &torque).unwrap();
        world.plant.advance(&torque, &rate, &wind(), TIME_STEP);
        world.tick += 1;
        let truth = world.plant.state();
        let mut sample = world.sample(wind());
        if !has_estimator {
            sample.state.velocity.fill(f64::NAN);
            sample.state.base.position.fill(f64::NAN); // or the velocity follows it
            sample.thrust.fill(f64::NAN);
        }
        world.controller.tick(&sample);
        let used = &world.controller.state().estimate();
        // Velocities near 10 rad/s, by a mass matrix with a condition of 1e4.
        assert_within!((&used.robot.state.velocity - &truth.velocity).amax(), 1e-9);
        for (used, truth) in used.robot.thrust.iter().zip(world.plant.jets().thrust()) {
            assert_within!((used - truth).abs(), 1e-9);
        }
    }
}

/// What acts in place of a command is a matter of the state alone: other ticks of the controller, or another controller,
/// change nothing, and neither does what was to act in its place before.
#[test]
fn a_replaced_command_belongs_to_its_state() {
    let config = experiment("test2_observer");
    let mut world = Loop::new(&config);
    world.run(0.05, |_| wind());
    let command = world.controller.command().clone();
    let torque: Vec<f64> = command.joint_torque.iter().map(|torque| torque + 5.0).collect();
    let (rate, before) = (command.thrust_rate.as_slice(), command.joint_torque.as_slice());
    let after_tick = world.controller.state().clone();
    let mut unmeasured = Measurement { time: (world.tick + 1) as f64 * TIME_STEP, ..world.sample(wind()) };
    unmeasured.state.velocity.fill(f64::NAN);
    unmeasured.state.base.position.fill(f64::NAN); // or the velocity follows it
    let predicted = |running: &mut Running, replacements: &[&[f64]]| {
        running.state = Some(after_tick.clone());
        for torque in replacements {
            let Running { controller, state } = &mut *running;
            controller.replace_command(state.as_mut().unwrap(), rate, torque).unwrap();
        }
        unmeasured.tick(running);
        running.state().estimate().robot.state.velocity.clone()
    };
    let as_commanded = predicted(&mut world.controller, &[]);
    let expected = predicted(&mut world.controller, &[&torque]);
    assert!((&expected - &as_commanded).amax() > 0.1);
    let mut fresh = controller(&config);
    assert_eq!(predicted(&mut fresh, &[&torque]), expected, "another controller");
    world.run(0.2, |_| wind());
    assert_eq!(predicted(&mut world.controller, &[&torque]), expected, "other ticks");
    let twice = predicted(&mut world.controller, &[&torque, before, &torque]);
    assert_within!((twice - &expected).amax(), 1e-9, because "up to 1e4 rad/s² for 10 ms, taken back once");
}

/// A controller that does not tick for 0.22 s on a climb, whose last command goes on acting, flies on: what it measures
/// then is neither a jump nor a failing engine.
#[test]
fn a_controller_that_pauses_flies_on() {
    let observed = experiment("test2_observer");
    let mut estimating = observed.clone();
    estimating.controller.law.estimator =
        Some(EstimatorConfig { joint_observer: Some(0.05), ..EstimatorConfig::default() });
    for mut config in [observed, estimating] {
        config.controller.law.fault_detection.tracking_error = None; // the set-point's attitude is another one
        let mut world = Loop::new(&config);
        world.run(1.0, |_| Vector3::zeros());
        world.advance(&Vector3::zeros());
        let start = Setpoint::at_rest(world.controller.terms().setpoint.com_position, Matrix3::identity());
        let (mut height, mut modes) = ([0.0_f64; 3], Vec::new());
        for tick in 0..300 {
            // Up, with a jerk that is 6 m/s³ for 0.4 s, −6 m/s³ for 0.8 s and 6 m/s³ for 0.4 s.
            let jerk = match tick {
                0..40 | 120..160 => 6.0,
                40..120 => -6.0,
                _ => 0.0,
            };
            let mut setpoint = start;
            setpoint.com_position.z += height[0];
            (setpoint.com_velocity.z, setpoint.com_acceleration.z) = (height[1], height[2]);
            setpoint.com_jerk.z = jerk;
            let [_, speed, acceleration] = height;
            height[0] += TIME_STEP * (speed + 0.5 * TIME_STEP * acceleration);
            height[1] += TIME_STEP * (acceleration + 0.5 * TIME_STEP * jerk);
            height[2] += TIME_STEP * jerk;
            if !(51..72).contains(&tick) {
                let sample = world.sample(Vector3::zeros());
                let command = world.controller.tick_towards(&sample, &setpoint);
                modes.extend(command.modes.names());
            }
            world.plant.observe(&Vector3::zeros());
            world.advance(&Vector3::zeros());
        }
        let terms = world.controller.terms();
        let error = (terms.setpoint.com_position - terms.kinematics.com).norm();
        assert!(error < 0.3 && modes == ["clock_predicted"], "{error} m, {} modes", modes.len());
    }
}

/// An observer of the joints finds their velocities from positions: a robot that begins at rest needs no others.
#[test]
fn an_observer_of_joints_needs_no_velocities() {
    let mut config = experiment("test2_sensors");
    config.simulator.sensors = None;
    let (mut measured, mut unmeasured) = (controller(&config), controller(&config));
    let mut world = Loop::new(&config);
    for tick in 0..20 {
        world.observe(&wind());
        let mut sample = world.sample(wind());
        if tick == 0 {
            sample.state.velocity.rows_range_mut(6..).fill(0.0);
        }
        let expected = sample.tick(&mut measured).clone();
        sample.state.velocity.rows_range_mut(6..).fill(f64::NAN);
        assert_eq!(numbers(sample.tick(&mut unmeasured)), numbers(&expected));
        assert!(expected.modes.is_empty());
        world.advance(&wind());
    }
    assert!(unmeasured.state().estimate().robot.state.velocity.rows_range(6..).amax() > 1e-3);
}

/// With estimators the law is given what they make of the measurement, and the state holds them.
#[test]
fn the_law_is_given_what_the_estimators_make() {
    let mut config = experiment("test2");
    let slow = FilterConfig { delay: 0.0, time_constant: 1e9 };
    let estimator = EstimatorConfig { base_position: slow, ..EstimatorConfig::default() };
    config.controller.law.estimator = Some(estimator);
    config.controller.law.wind_observer = true;
    let good = Measurement::start(&config);
    let mut controller = controller(&config);
    good.tick(&mut controller);
    assert_eq!(controller.state().estimate().robot.state.base.position, good.state.base.position);
    assert_eq!(controller.state().estimate().robot.wind, Vector3::zeros(), "the measured wind is not used");
    let wind = controller.state().wind().unwrap().wind();
    let mut moved = Measurement { time: TIME_STEP, ..good.clone() };
    moved.state.base.position.x += 0.1;
    moved.tick(&mut controller);
    let used = &controller.state().estimate();
    assert_within!((used.robot.state.base.position - good.state.base.position).amax(), 1e-2, because "a tick of the model");
    assert_eq!(used.robot.wind, wind, "that of the tick before");
}

/// What is predicted under a replaced command follows from the state alone: in another controller, which has not seen the tick
/// before, it has the same bits, also with friction of the drives and with late commands.
#[test]
fn a_replaced_command_continues_from_a_restored_state() {
    let mut config = experiment("test2_observer");
    let group = load_robot(&config.robot).unwrap().groups[0].name.clone();
    let law = &mut config.controller.law;
    law.torque.friction = Some([(group, 3.0)].into());
    law.estimator = Some(EstimatorConfig {
        latency: LatencyConfig { torque: 0.02, thrust: 0.02 },
        ..EstimatorConfig::default()
    });
    let mut flight = Loop::new(&config);
    flight.run(1.0, |_| wind());
    let (state, thrust_rate) =
        (flight.controller.state().clone(), flight.controller.command().thrust_rate.clone());
    let torque: Vec<f64> =
        flight.controller.command().joint_torque.iter().map(|torque| 0.9 * torque).collect();
    flight.advance(&wind());
    let (plant, tick) = (flight.plant.clone(), flight.tick);
    let mut another = Loop::new(&config);
    another.observe(&Vector3::zeros());
    let next = |flight: &mut Loop| {
        (flight.plant, flight.tick) = (plant.clone(), tick);
        let Running { controller, state: kept } = &mut flight.controller;
        controller.replace_command(kept.insert(state.clone()), thrust_rate.as_slice(), &torque).unwrap();
        flight.observe(&wind());
        (numbers(flight.controller.command()), flight.controller.state().clone())
    };
    assert_eq!(next(&mut flight), next(&mut another));
}

/// Where the flight begins again its plan does too, between two plans as well.
#[test]
fn a_flight_that_begins_again_plans_anew() {
    let config = experiment("test2_mpc");
    let first = Measurement::start(&config);
    let mut controller = controller(&config);
    let wrong = [5.0, 9.0, 0.0, 0.0, 0.0];
    let planned = wrong.map(|error| {
        let tick = controller.state.as_ref().map_or(0.0, |state| state.time() / TIME_STEP + 1.0);
        let mut sample = Measurement { time: TIME_STEP * tick, ..first.clone() };
        sample.state.base.position.x += error + 1e-6 * tick;
        sample.state.joint_position.add_scalar_mut(1e-4 * tick);
        let modes = sample.tick(&mut controller).modes;
        let is_new = controller.prediction().unwrap().0.rate_t == controller.terms().momentum.a_t;
        (modes.contains(Modes::BEGUN_AGAIN), is_new)
    });
    assert_eq!(planned, [(false, true), (false, false), (false, true), (true, true), (false, false)]);
}

/// Joints are compared with the tick before: neither the first one nor one with which the flight begins again has one, and the
/// velocity that they measure is no residual.
#[test]
fn a_first_velocity_is_no_residual_of_the_joints() {
    let mut config = experiment("test2_observer");
    config.controller.law.channels.jump = true;
    config.controller.law.fault_detection.joints = experiment("robot").controller.law.fault_detection.joints;
    let mut first = Measurement::start(&config);
    first.state.velocity.fill(0.3);
    let mut controller = controller(&config);
    let mut tick = 0.0;
    let compared = [0.0, 0.0, 9.0, 9.0, 9.0].map(|error| {
        let mut sample = Measurement { time: TIME_STEP * tick, ..first.clone() };
        sample.state.base.position.x += error + 1e-3 * tick;
        tick += 1.0;
        let modes = sample.tick(&mut controller).modes;
        let is_compared = controller.state().joints().unwrap().mean().amax() > 0.0;
        (modes.contains(Modes::BEGUN_AGAIN), is_compared)
    });
    assert_eq!(compared, [(false, false), (false, true), (false, true), (false, true), (true, false)]);
}

/// Where a flight begins again the ground is that of this tick's height, for the robot upright, however it leans; without a
/// height it is not known, and a landing is slow.
#[test]
fn a_flight_that_begins_again_keeps_its_height_and_stands_upright() {
    let config = experiment("test2_mpc");
    let lean = axis_angle(&Vector3::y(), 0.4);
    let ground = |height: f64| {
        let mut config = config.clone();
        config.mission.commands = Commands { land: vec![(0.0, 9.0)], ..Commands::default() };
        let mut first = Measurement::start(&config);
        first.state.base.rotation = lean * first.state.base.rotation;
        let mut controller = controller(&config);
        for (tick, error) in [5.0, 9.0, 0.0, 0.0].into_iter().enumerate() {
            let mut sample = Measurement { time: TIME_STEP * tick as f64, ..first.clone() };
            sample.state.base.position.x += error + 1e-6 * tick as f64;
            sample.height = if tick == 3 { height } else { f64::NAN };
            sample.tick(&mut controller);
        }
        assert!(controller.command().modes.contains(Modes::BEGUN_AGAIN));
        let Pose { position, rotation } = controller.state().estimate().robot.state.base;
        let stance = (rotation.transpose() * (controller.terms().kinematics.com - position)).z;
        let speed = controller.state().setpoint().raw().velocity.z;
        (controller.state().touch_down(), position.z + stance, speed)
    };
    for (height, landing) in [(1.25, -0.2), (5.0, -0.75)] {
        let (found, level, speed) = ground(height);
        assert_within!((found - (level - height)).abs(), 1e-12);
        assert_within!((speed - landing).abs(), 1e-12, "{height} m");
    }
    let (found, _, speed) = ground(f64::NAN);
    assert_eq!(found, f64::NEG_INFINITY);
    assert_within!((speed + 0.2).abs(), 1e-12, "a ground that is not known may be near");
}

/// What is not configured is not there: a state has no part of it, and is none of a controller with it, nor the other way
/// round.
#[test]
fn a_state_of_other_stages_is_refused() {
    let mut config = experiment("test2_observer");
    config.controller.law.estimator = Some(EstimatorConfig::default());
    config.controller.law.wind_observer = true;
    let forget: [fn(&mut ScenarioConfig); 5] = [
        |config| config.controller.law.fault_detection.engines = None,
        |config| {
            config.controller.law.fault_detection.engines = None;
            config.controller.law.disturbance_observer = None;
        },
        |config| config.controller.law.estimator = None,
        |config| config.controller.law.wind_observer = false,
        |config| config.controller.law.use_jets = false,
    ];
    for (number, forget) in forget.into_iter().enumerate() {
        let mut without = config.clone();
        forget(&mut without);
        let (mut with, mut without) = (controller(&config), controller(&without));
        let sample = Measurement::start(&config);
        for controller in [&mut with, &mut without] {
            assert_eq!(sample.tick(controller).modes, Modes::default(), "{number}");
        }
        std::mem::swap(&mut with.state, &mut without.state);
        for controller in [&mut with, &mut without] {
            let command = sample.tick(controller);
            assert_eq!((command.modes, command.thrust_rate.amax()), (Modes::STATE_IGNORED, 0.0), "{number}");
        }
    }
}

/// Throttles follow the thrust rates that act: also those that take the place of the law's, and the zeros of a tick that holds.
#[test]
fn throttles_follow_the_rates_that_act() {
    let mut config = experiment("test2_observer");
    config.controller.law.jet_dynamics = JetDynamics::Throttled;
    let (mut ticked, sample) = (controller(&config), Measurement::start(&config));
    let command = sample.tick(&mut ticked).clone();
    let Running { controller: law, state } = &mut ticked;
    let mut throttle = |rate: &[f64]| {
        law.replace_command(state.as_mut().unwrap(), rate, command.joint_torque.as_slice()).unwrap();
        law.command().throttle.clone()
    };
    let (faster, held) = (throttle(&[5.0; 4]), throttle(&[0.0; 4]));
    assert!(faster.iter().zip(&held).all(|(faster, held)| faster > held), "{faster} {held}");
    assert_eq!(throttle(command.thrust_rate.as_slice()), command.throttle);
    config.controller.law.disturbance_observer = None;
    config.controller.law.fault_detection.engines = None;
    let mut other = controller(&config);
    sample.tick(&mut other);
    ticked.state = other.state;
    let command = sample.tick(&mut ticked);
    assert_eq!((command.modes, &command.throttle), (Modes::STATE_IGNORED, &held));
}

/// A controller that does not use jets commands no thrust rate, whatever thrust is measured.
#[test]
fn without_jets_no_thrust_rate_is_commanded() {
    let mut config = experiment("test2");
    config.controller.law.use_jets = false;
    let mut controller = controller(&config);
    let mut sample = Measurement::start(&config);
    for thrust in [0.0, 100.0, 300.0] {
        sample.thrust.fill(thrust);
        let command = sample.tick(&mut controller);
        assert_eq!((command.thrust_rate.len(), command.thrust_rate.amax()), (4, 0.0), "{thrust} N");
        assert_eq!(controller.terms().momentum.a_t.ncols(), 0);
    }
    // Nor one that acted once in the place of a command.
    let torque = vec![0.0; controller.model().joints.len()];
    let Running { controller: law, state } = &mut controller;
    law.replace_command(state.as_mut().unwrap(), &[5.0; 4], &torque).unwrap();
    assert_eq!(sample.tick(&mut controller).thrust_rate.amax(), 0.0);
}

/// A momentum QP that overflows has no answer: thrust rates and joint velocities are the values within
/// their bounds that are nearest to zero, and the torques still brake the joints.
#[test]
fn without_a_momentum_answer_nothing_moves() {
    let mut config = experiment("test2");
    config.controller.law.weights.momentum = 1e305;
    for solver in [Solver::ActiveSet, Solver::Clarabel] {
        config.controller.law.qp.solver = solver;
        let mut controller = controller(&config);
        let mut sample = Measurement::start(&config);
        sample.state.velocity[6 + 3] = 0.4;
        let knee = controller.model().joint_index("l_knee").unwrap();
        assert!(sample.state.joint_position[knee] > 0.0, "beyond its limit");
        let command = sample.tick(&mut controller).clone();
        assert!(command.modes.contains(Modes::MOMENTUM_HELD));
        assert_eq!(command.rates_qp.status, QpStatus::NonFinite);
        assert_eq!(command.thrust_rate.amax(), 0.0);
        let upper = controller.terms().momentum_qp.problem.upper[4 + knee];
        assert!(upper < 0.0, "beyond its limit a joint must come back");
        for (joint, velocity) in command.joint_velocity.iter().enumerate() {
            let upper = controller.terms().momentum_qp.problem.upper[4 + joint];
            assert_eq!(*velocity, upper.min(0.0), "joint {joint}");
        }
        // s̈* = −K_D ṡ of the moving joint
        assert_eq!(command.torque_qp.status, QpStatus::Solved);
        let braking = controller.terms().torque_qp.acceleration_desired[3];
        assert_within!((braking + 20.0 * 0.4).abs(), 1e-12, "{braking}");
    }
}

/// Tasks that leave some motions without a cost: every method refuses, and nothing moves.
#[test]
fn a_singular_momentum_qp_is_said_to_be_one() {
    let mut config = experiment("test2");
    let weights = &mut config.controller.law.weights;
    (weights.joint_velocity, weights.posture, weights.symmetry) = (0.0, 0.0, 0.0);
    weights.thrust_rate.values_mut().for_each(|weight| *weight = 0.0);
    (weights.momentum, weights.angular_momentum) = (1e15, 1.5e16);
    for solver in [Solver::ActiveSet, Solver::Clarabel] {
        config.controller.law.qp.solver = solver;
        let command = Measurement::start(&config).tick(&mut controller(&config)).clone();
        assert!(command.modes.contains(Modes::MOMENTUM_HELD));
        assert_eq!(command.rates_qp.status, QpStatus::NotPositiveDefinite);
        assert_eq!(command.torque_qp.status, QpStatus::Solved);
        assert_eq!(command.thrust_rate.amax(), 0.0);
        // Refused before the first iteration.
        assert_eq!(command.rates_qp.iterations, 0);
        assert!(command.rates_qp.kkt.is_nan());
    }
}

/// A torque QP that overflows has no answer: torques stay, thrusts and joints are commanded as ever.
#[test]
fn without_a_torque_answer_torques_stay() {
    let mut config = experiment("test2");
    let start = Measurement::start(&config);
    for solver in [Solver::ActiveSet, Solver::Clarabel] {
        config.controller.law.qp.solver = solver;
        let mut sound = controller(&config);
        start.tick(&mut sound);
        let mut spoilt_config = config.clone();
        spoilt_config.controller.law.torque.weight_acceleration = 1e306;
        let mut controller = controller(&spoilt_config);
        let command = start.tick(&mut controller);
        assert!(command.modes.contains(Modes::TORQUE_HELD));
        assert_eq!(command.torque_qp.status, QpStatus::NonFinite);
        assert_eq!(command.joint_torque.amax(), 0.0, "torques before the first answer");
        let expected = sound.command();
        assert_eq!(command.thrust_rate, expected.thrust_rate);
        assert_eq!(command.joint_velocity, expected.joint_velocity);
        assert!(!controller.state().torque_is_known());
    }
}

/// Flies a configuration beside another on the same measurements and compares what they command.
fn compare(
    config: &ScenarioConfig,
    other: &ScenarioConfig,
    seconds: f64,
    wind: Vector3<f64>,
    tolerance: f64,
) {
    let mut flight = Loop::new(config);
    let mut beside = controller(other);
    for _ in 0..tick_at(seconds) {
        flight.observe(&wind);
        let time = flight.tick as f64 * 0.01;
        let thrust = flight.plant.jets().thrust().to_vec();
        let state = flight.plant.state();
        beside.tick(&Measurement { wind, ..at(time, state, &thrust) });
        let (a, b) = (flight.controller.command(), beside.command());
        assert_eq!((a.modes, b.modes), (Modes::default(), Modes::default()));
        assert_equal(&format!("at {time} s"), &numbers(a), &numbers(b), tolerance);
        flight.advance(&wind);
    }
}

/// Clarabel as the solver of every tick commands the same, to 1e-6.
#[test]
fn clarabel_commands_the_same() {
    let config = experiment("test2");
    let mut other = config.clone();
    other.controller.law.qp.solver = Solver::Clarabel;
    compare(&config, &other, 1.0, wind(), 1e-6);
    // In a struggle, with many bounds active.
    let config = experiment("test1");
    let mut other = config.clone();
    other.controller.law.qp.solver = Solver::Clarabel;
    compare(&config, &other, 1.5, Vector3::new(-25.0, 30.0, 0.0), 1e-6);
}

/// Bounds on the rate of one value.
fn rate_bounds(value: f64, limits: (f64, f64), rate_max: f64, steepness: f64) -> (f64, f64) {
    let values = LimitedValues {
        value: vec![value],
        least: vec![limits.0],
        greatest: vec![limits.1],
        rate_max: vec![rate_max],
        steepness: vec![steepness],
    };
    let (mut lower, mut upper) = ([f64::NAN], [f64::NAN]);
    values.write_bounds(&mut lower, &mut upper);
    (lower[0], upper[0])
}

/// A rate fades out where its value meets a limit, is zero on it and points back beyond it; lower and
/// upper bound never cross.
#[test]
fn rate_bounds_fade_out_at_the_limits() {
    let limits = (0.0, 160.0);
    let bounds = |thrust| rate_bounds(thrust, limits, 100.0, 2.0);
    assert_eq!(bounds(80.0), (-100.0, 100.0));
    assert_eq!(bounds(0.0), (0.0, 100.0));
    assert_eq!(bounds(160.0), (-100.0, 0.0));
    let (lower, upper) = bounds(0.5);
    assert!((lower + 100.0 * 1_f64.tanh()).abs() < 1e-12 && upper == 100.0);
    let (lower, upper) = bounds(159.5);
    assert!(lower == -100.0 && (upper - 100.0 * 1_f64.tanh()).abs() < 1e-12);
    assert!(bounds(-0.1).0 > 0.0 && bounds(160.1).1 < 0.0, "the way back");
    let mut rng = rng(1);
    for _ in 0..10_000 {
        let lower = rng.random_range(-2.0..2.0);
        let limits = (lower, lower + rng.random_range(0.0..2.0));
        let (low, high) = rate_bounds(rng.random_range(-9.0..9.0), limits, 0.8, rng.random_range(0.1..50.0));
        assert!(low <= high && low.abs() <= 0.8 && high.abs() <= 0.8);
    }
}

/// At zero and at full thrust, and with a joint beyond its limit, the commands are within the bounds of the tick.
#[test]
fn commands_obey_their_bounds_at_the_limits() {
    let config = experiment("test2");
    let start = Measurement::start(&config);
    let mut rng = rng(2);
    for thrusts in
        [[0.0; 4], [160.0, 160.0, 220.0, 220.0], [0.0, 160.0, 0.0, 220.0], [-0.3, 160.3, -0.3, 220.3]]
    {
        let mut controller = controller(&config);
        start.tick(&mut controller);
        let mut sample = Measurement { thrust: thrusts.to_vec(), ..start.clone() };
        // Right hip: pitch below its -17.5 deg, roll above its 45 deg; and everything moves.
        (sample.state.joint_position[17], sample.state.joint_position[18]) = (-0.4, 0.9);
        sample.state.velocity = DVector::from_fn(29, |_, _| rng.random_range(-1.0..1.0));
        let command = sample.tick(&mut controller).clone();
        assert_eq!(command.modes, Modes::default());
        let problem = &controller.terms().momentum_qp.problem;
        let bounds_of_tick = |unknown: usize| (problem.lower[unknown], problem.upper[unknown]);
        for (jet, rate) in command.thrust_rate.iter().enumerate() {
            let full = if jet < 2 { 160.0 } else { 220.0 };
            let (lower, upper) = rate_bounds(thrusts[jet], (0.0, full), 100.0, 2.0);
            assert_eq!(bounds_of_tick(jet), (lower, upper));
            assert!((lower..=upper).contains(rate), "jet {jet}: {rate} outside [{lower}, {upper}]");
        }
        let robot = controller.model();
        for (joint, velocity) in command.joint_velocity.iter().enumerate() {
            let s = sample.state.joint_position[joint];
            let (lower, upper) = rate_bounds(s, robot.joints[joint].limits, 45_f64.to_radians(), 5.0);
            assert_eq!(bounds_of_tick(4 + joint), (lower, upper));
            assert!((lower..=upper).contains(velocity), "{}", robot.joints[joint].name);
        }
        assert!(command.joint_velocity[17] > 0.0, "below its limit it comes back");
        assert!(command.joint_velocity[18] < 0.0, "above its limit it comes back");
        assert!(command.joint_torque.amax() <= 50.0);
    }
}

/// Thrusts of engines that run end at their least one, and return to it from below.
#[test]
fn thrust_rates_fade_out_at_the_least_thrust() {
    let config = experiment("test2");
    let mut robot = load_robot(&config.robot).unwrap();
    robot.jets.iter_mut().for_each(|jet| jet.thrust_min = 11.0);
    let mut controller = Running::new(config.controller(robot).unwrap());
    let start = Measurement::start(&config);
    start.tick(&mut controller);
    let thrust = vec![11.0, 11.4, 10.8, 90.0];
    Measurement { thrust: thrust.clone(), ..start }.tick(&mut controller);
    let problem = &controller.terms().momentum_qp.problem;
    for (jet, thrust) in thrust.into_iter().enumerate() {
        let full = if jet < 2 { 160.0 } else { 220.0 };
        let bounds = rate_bounds(thrust, (11.0, full), 100.0, 2.0);
        assert_eq!((problem.lower[jet], problem.upper[jet]), bounds, "jet {jet}");
    }
    assert_eq!(problem.lower[0], 0.0);
    assert!(problem.lower[2] > 0.0, "the way back");
}

/// The rate limiter moves each torque by at most rate × step towards its target; the first answer is taken
/// as it is.
#[test]
fn torques_move_by_at_most_three_newton_metres() {
    let mut torque = DVector::from_column_slice(&[0.0, 1.0, -1.0]);
    limit_rate(&mut torque, &[10.0, 1.5, -20.0], [300.0; 3], 0.01);
    assert_eq!(torque.as_slice(), [3.0, 1.5, -4.0]);

    let config = experiment("test2");
    let mut controller = controller(&config);
    let mut sample = Measurement::start(&config);
    sample.state.velocity[6 + 4] = 2.0;
    let mut last = sample.tick(&mut controller).joint_torque.clone();
    assert_eq!(last, controller.terms().unlimited_torque, "the first answer is taken as it is");
    let mut rng = rng(3);
    let mut limited = 0;
    for tick in 1..50 {
        sample.time = f64::from(tick) * 0.01;
        sample.state.velocity = DVector::from_fn(29, |_, _| rng.random_range(-2.0..2.0));
        let torque = sample.tick(&mut controller).joint_torque.clone();
        for joint in 0..23 {
            let target = controller.terms().unlimited_torque[joint];
            let step = torque[joint] - last[joint];
            assert_within!(step.abs() - 3.0, 1e-12);
            assert!(target.abs() <= 50.0);
            if (target - last[joint]).abs() > 3.0 {
                limited += 1;
                assert_within!((step - 3.0 * (target - last[joint]).signum()).abs(), 1e-12);
            } else {
                assert_within!((torque[joint] - target).abs(), 1e-12);
            }
        }
        last = torque;
    }
    assert!(limited > 100, "{limited} limited");
}

/// The error of the acceleration of a joint at which a share κ acts counts κ² in the Hessian, and its torque has κ of its limit.
#[test]
fn a_weak_joint_does_not_move_the_others() {
    let config = experiment("test2");
    let mut controller = controller(&config);
    Measurement::start(&config).tick(&mut controller);
    let (state, terms) = (controller.state(), controller.terms());
    let none = DVector::zeros(23);
    let update = |conditions: &[JointCondition]| {
        let mut qp = terms.torque_qp.clone();
        qp.limit(conditions);
        qp.update(
            &terms.contact,
            state.contact(),
            &terms.inverse_mass,
            &terms.free_acceleration,
            &none,
            &none,
        );
        qp
    };
    let healthy = update(&[JointCondition::Healthy; 23]);
    let weight = config.controller.law.torque.weight_acceleration;
    for (condition, share) in [(JointCondition::Weak(0.4), 0.4), (JointCondition::Free, 0.0)] {
        let mut conditions = [JointCondition::Healthy; 23];
        conditions[6] = condition;
        let qp = update(&conditions);
        let gain = terms.inverse_mass.joint_gain.column(6);
        let n = qp.joint_torque.start;
        let joints = |of: &DMatrix<f64>| of.view((n, n), (23, 23)).into_owned();
        let (from, to) = (joints(&healthy.problem.h), joints(&qp.problem.h));
        let expected = &from - (1.0 - share * share) * weight * gain * gain.transpose();
        assert_within!((to - expected).amax() / from.amax(), 1e-14);
        assert_within!((qp.problem.upper[n + 6] - share * healthy.problem.upper[n + 6]).abs(), 1e-14);
        assert_eq!(qp.problem.upper[n + 5], healthy.problem.upper[n + 5]);
    }
}

/// The torque law: `s̈* = −K_D (ṡ − ṡ*) − K_P ∫(ṡ − ṡ*)`, the integral used first and advanced after.
#[test]
fn the_torque_law_integrates_after_use() {
    let config = experiment("test2");
    let mut controller = controller(&config);
    let mut sample = Measurement::start(&config);
    let mut integral = DVector::zeros(23);
    let mut rng = rng(4);
    for tick in 0..20 {
        sample.time = f64::from(tick) * 0.01;
        sample.state.velocity.iter_mut().for_each(|v| *v = rng.random_range(-0.1..0.1));
        let wanted = sample.tick(&mut controller).joint_velocity.clone();
        let error = sample.state.velocity.rows(6, 23) - wanted;
        let law = &error * -20.0 - &integral * 100.0;
        assert_within!((&controller.terms().torque_qp.acceleration_desired - law).amax(), 1e-12);
        integral += error * 0.01;
        assert_within!((controller.state().velocity_error_integral() - &integral).amax(), 1e-14);
    }
}

/// Without it in the torques, the air moves no joint in them: the free acceleration is that in no air.
#[test]
fn the_air_can_be_left_out_of_the_torques() {
    let free = |is_felt: bool, density: f64| {
        let mut config = experiment("test2");
        config.controller.aero = aero("published", density);
        config.controller.law.aero_feedback.torque = is_felt;
        let mut controller = controller(&config);
        Measurement::start(&config).tick(&mut controller);
        controller.terms().free_acceleration.clone()
    };
    let (felt, left_out, in_none) = (free(true, 1.2), free(false, 1.2), free(true, 1e-12));
    // The forces of a density of 1e-12 kg/m³.
    assert_within!((&left_out - &in_none).amax(), 1e-9);
    assert!((&felt - &left_out).amax() > 0.1, "{felt}");
}

/// Torques overcome the friction of drives that move as commanded, and of no other: `F = f tanh(ṡ* / 0.02 rad/s)`.
#[test]
fn torques_overcome_the_friction_of_the_drives() {
    let mut config = experiment("test2");
    let (mut sample, mut rng) = (Measurement::start(&config), rng(5));
    sample.state.velocity.iter_mut().for_each(|v| *v = rng.random_range(-0.1..0.1));
    let plain = sample.tick(&mut controller(&config)).clone();
    config.controller.law.torque.friction = Some([("left_arm".into(), 2.0)].into());
    let mut controller = controller(&config);
    let more = &sample.tick(&mut controller).joint_torque - &plain.joint_torque;
    let arm = &controller.model().groups.iter().find(|group| group.name == "left_arm").unwrap().joints;
    for (joint, more) in more.iter().enumerate() {
        let friction =
            if arm.contains(&joint) { 2.0 * (plain.joint_velocity[joint] / 0.02).tanh() } else { 0.0 };
        assert_within!((more - friction).abs(), 1e-3, "{joint}: {more} for {friction}");
    }
}

/// A posture, inertia or integral that does not fit is refused by name.
#[test]
fn parts_of_a_state_that_do_not_fit_are_refused() {
    let config = experiment("test2");
    let mut controller = controller(&config);
    Measurement::start(&config).tick(&mut controller);
    let state = controller.state().clone();
    let one = Matrix3::identity();
    let zeros = DVector::zeros;
    let mut spoilt = zeros(23);
    spoilt[3] = f64::NAN;
    for (posture, inertia, integral, words) in [
        (zeros(22), one, zeros(23), ["posture is 22", "23, one entry per joint"]),
        (zeros(23), one, zeros(24), ["velocity_error_integral is 24", "23, one entry per joint"]),
        (zeros(23), Matrix3::zeros(), zeros(23), ["inertia_0_b", "positive definite"]),
        (zeros(23), -one, zeros(23), ["inertia_0_b", "positive definite"]),
        (zeros(23), one * f64::NAN, zeros(23), ["inertia_0_b", "positive definite"]),
        (spoilt.clone(), one, zeros(23), ["posture is NaN", "finite"]),
        (zeros(23), one, spoilt, ["velocity_error_integral is NaN", "finite"]),
    ] {
        let message = state.clone().with_posture_control(posture, inertia, integral).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "{message}");
        }
    }
    let (posture, integral) = (DVector::from_element(23, 0.5), DVector::from_element(23, 0.1));
    let good = state.with_posture_control(posture.clone(), 3.0 * one, integral.clone()).unwrap();
    assert_eq!((good.posture(), good.inertia_0_b()), (&posture, &(3.0 * one)));
    assert_eq!(good.velocity_error_integral(), &integral);
}

type Refusal = (&'static str, fn(&mut ScenarioConfig), &'static str);

/// Every number of the controller that cannot be is refused by its key, with its value.
#[test]
#[rustfmt::skip]
fn bad_numbers_are_refused_by_key() {
    const NAN: f64 = f64::NAN;
    let refusals: [Refusal; 22] = [
        ("controller.weights.symmetric_jets", |c| c.controller.law.weights.symmetric_jets[0][1] = c.controller.law.weights.symmetric_jets[0][0].clone(), "two jets"),
        ("controller.fault_detection.engines", |c| c.controller.law.fault_detection.engines = experiment("test2_observer").controller.law.fault_detection.engines, "controller.disturbance_observer"),
        ("controller.fault_detection.unmeasured_engines", |c| c.controller.law.fault_detection.unmeasured_engines = experiment("robot").controller.law.fault_detection.unmeasured_engines, "controller.fault_detection.engines"),
        ("disturbances.aero_estimate.scale", |c| c.disturbances.aero_estimate.scale = NAN, "NaN"),
        ("controller.momentum.kp_linear", |c| c.controller.law.momentum.kp_linear[2] = NAN, "not finite"),
        ("controller.weights.thrust_rate.l_arm_jet", |c| remove(&mut c.controller.law.weights.thrust_rate, "l_arm_jet"), "absent"),
        ("controller.weights.thrust_rate", |c| set(&mut c.controller.law.weights.thrust_rate, "tail_jet", 1.0), "tail_jet"),
        ("controller.weights.symmetric_jets", |c| c.controller.law.weights.symmetric_jets[1][0] = "tail_jet".into(), "tail_jet"),
        ("controller.bounds.thrust_rate_max.chest_r_jet", |c| remove(&mut c.controller.law.bounds.thrust_rate_max, "chest_r_jet"), "absent"),
        ("controller.bounds.thrust_rate_max", |c| set(&mut c.controller.law.bounds.thrust_rate_max, "tail_jet", 1.0), "known: l_arm_jet, r_arm_jet, chest_l_jet, chest_r_jet"),
        ("controller.posture_gain.torso", |c| remove(&mut c.controller.law.posture_gain, "torso"), "absent"),
        ("controller.posture_gain", |c| set(&mut c.controller.law.posture_gain, "tail", 1.0), "known: torso, left_arm, right_arm, left_leg, right_leg"),
        ("controller.torque.friction", |c| c.controller.law.torque.friction = Some([("tail".into(), 1.0)].into()), "known: torso"),
        ("controller.setpoint.nose_down_limits_deg[0]", |c| c.controller.law.setpoint.nose_down_limits_deg = [1.0, 0.0], "is 1"),
        ("start of an interval of mission.up", |c| c.mission.commands.up[0].0 = NAN, "NaN"),
        ("end of an interval of mission.up", |c| c.mission.commands.up[0].1 = 10.0, "a time after the start 10"),
        ("end of an interval of mission.down", |c| c.mission.commands.down[0].1 = NAN, "NaN"),
        ("mission.forward", |c| c.mission.commands.forward.push((3.0, 2.0)), "is 2"),
        ("mission.forward_turbo", |c| c.mission.commands.forward_turbo[0].1 = f64::INFINITY, "inf"),
        ("mission.pitch_up", |c| c.mission.commands.pitch_up[0].0 = f64::NEG_INFINITY, "-inf"),
        ("mission.yaw_left", |c| c.mission.commands.yaw_left.push((1.0, 1.0)), "is 1"),
        ("coefficient", |c| c.controller.aero = aero("nobodys", 1.225), "nobodys"),
    ];
    let robot = robot("ironcub_mk1");
    for (key, spoil, words) in refusals {
        let mut config = experiment("test2");
        spoil(&mut config);
        match config.controller(robot.clone()) {
            Ok(_) => panic!("{key} was accepted"),
            Err(error) => {
                let message = error.to_string();
                assert!(message.contains(key) && message.contains(words), "{key}: {message}");
            }
        }
    }
}

/// The momentum does not distinguish jets whose columns are nearly parallel: a robot with such a pair is refused by its jets' names. The
/// recommended one is not.
#[test]
fn jets_that_the_momentum_cannot_tell_are_refused() {
    let unmeasured = experiment("robot").controller.law.fault_detection.unmeasured_engines;
    assert!(unmeasured.is_some());
    let mut config = experiment("mk3_robot");
    let robot = load_robot(&config.robot).unwrap();
    assert!(config.controller(robot.clone()).is_ok());
    config.controller.law.fault_detection.unmeasured_engines = unmeasured;
    let message = config.controller(robot).unwrap_err().to_string();
    for word in ["controller.fault_detection.unmeasured_engines", "explains 0.9", "_arm_jet", "chest_"] {
        assert!(message.contains(word), "{message}");
    }
}

fn set(table: &mut std::collections::BTreeMap<String, f64>, name: &str, value: f64) {
    table.insert(name.to_owned(), value);
}

fn remove(table: &mut std::collections::BTreeMap<String, f64>, name: &str) {
    assert!(table.remove(name).is_some());
}

fn aero(coefficients: &str, air_density: f64) -> AeroConfig {
    let value = json!({"model": "axisymmetric", "coefficients": coefficients, "air_density": air_density});
    serde_json::from_value(value).unwrap()
}
