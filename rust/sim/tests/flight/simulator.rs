//! What the simulator guarantees besides physics: the log, batches, interruption, falls, refusals.

use super::{STILL, data, ramp_to, with};
use crate::common::{assert_within, difference, experiment, fly, tick_at};
use flight_core::control::Given;
use flight_core::spatial::{orthonormality_error, rotation_from_wxyz};
use flight_io::{load_controller, load_robot};
use flight_sim::outcome::Judge;
use flight_sim::quantity::Dimension;
use flight_sim::{
    BatchError, FlightLog, FlightResult, Loss, LossReason, NoResult, Scenario, ScenarioConfig, fly_batch,
};
use flight_sim::{FIGURES, Outcome, SIGNALS, Summary};
use nalgebra::Vector3;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

fn short(seconds: f64) -> ScenarioConfig {
    with(experiment("test2"), |config| config.simulator.duration = seconds)
}

fn run(config: &ScenarioConfig) -> FlightResult {
    Scenario::new(config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap()
}

/// Signals and figures are declared once each, completely; the log has those that are read here.
#[test]
fn signals_and_figures_are_declared_once() {
    let names: BTreeSet<_> = SIGNALS.iter().map(|signal| signal.name).collect();
    assert_eq!(names.len(), SIGNALS.len());
    for signal in SIGNALS {
        assert!(!signal.dims.is_empty() && !signal.unit.is_empty() && !signal.meaning.is_empty());
        let per_tick = signal.dims[0] == Dimension::Time;
        assert_eq!(signal.read.is_some(), per_tick, "{}", signal.name);
    }
    let result = run(&short(0.05));
    let logged: Vec<_> = result.log.series.iter().map(|series| series.signal.name).collect();
    let declared = SIGNALS.iter().filter(|signal| signal.read.is_some() && !signal.is_of_ground);
    assert_eq!(logged, declared.map(|signal| signal.name).collect::<Vec<_>>());

    let names: BTreeSet<_> = FIGURES.iter().map(|figure| figure.name).collect();
    assert_eq!(names.len(), FIGURES.len());
    let of_flights = FIGURES.iter().filter(|figure| !figure.is_of_ground);
    let found = result.summary.figures(result.log.has_ground());
    assert!(found.map(|(figure, _)| figure.name).eq(of_flights.map(|figure| figure.name)));
}

/// The log has a row for every tick of every signal, time 0 included. `record.to_dataset` in Python refuses a signal whose shape
/// is not the declared one.
#[test]
fn the_log_has_every_signal_of_every_tick() {
    let result = run(&short(0.5));
    assert_eq!(result.log.len(), 51);
    for series in &result.log.series {
        let name = series.signal.name;
        assert_eq!(series.row_shape.iter().product::<usize>(), series.width(), "{name}");
        assert_eq!(series.data.len(), 51 * series.width(), "{name}");
        assert_eq!(series.row(50).len(), series.width(), "{name}");
        assert!(series.row(51).is_empty(), "{name}");
        let is_unknown =
            ["measured_torque_latency", "measured_thrust_latency", "raw_shaft_speed", "raw_height"]
                .contains(&name);
        assert!(is_unknown || series.data.iter().all(|x| x.is_finite()), "{name}");
    }
    assert!(result.log.series("typo").is_none());
    for (tick, time) in data(&result, "time").iter().enumerate() {
        assert_within!((time - 0.01 * tick as f64).abs(), 1e-12);
    }
    assert_eq!(result.log.joint_setpoint.len(), 23);
    assert!(FlightLog::new(&load_robot(&short(1.0).robot).unwrap(), 10).is_empty());
}

/// Signals belong together: velocities are rates, momentum is that of the CoM, attitudes are rotations,
/// forces of a controller with the air's model are those of the air.
#[test]
fn logged_signals_belong_together() {
    let result = run(&with(short(12.0), |config| config.wind = ramp_to([3.0, -9.0, 1.0])));
    let mass = load_robot(&short(1.0).robot).unwrap().mass();
    let n = result.log.len();
    let row = |name: &str, tick: usize| result.log.series(name).unwrap().row(tick).to_vec();
    for tick in 0..n {
        let quaternion: [f64; 4] = row("base_quaternion", tick).try_into().unwrap();
        assert!(quaternion[0] >= 0.0);
        assert_within!((quaternion.iter().map(|q| q * q).sum::<f64>() - 1.0).abs(), 1e-12);
        assert_within!(orthonormality_error(&rotation_from_wxyz(&quaternion)), 1e-12);
        let (velocity, momentum) = (row("com_velocity", tick), row("momentum", tick));
        for axis in 0..3 {
            assert_within!((momentum[axis] - mass * velocity[axis]).abs(), 1e-9);
        }
        assert_eq!(row("aero_force_sim", tick), row("aero_force_control", tick));
        if tick > 0 {
            // Semi-implicit: positions follow the new velocities.
            for (name, rate) in [("base_position", "base_velocity"), ("joint_position", "joint_velocity")] {
                let (now, before, rate) = (row(name, tick), row(name, tick - 1), row(rate, tick));
                for k in 0..now.len() {
                    assert_within!((now[k] - before[k] - 0.01 * rate[k]).abs(), 1e-12, "{name} {k}");
                }
            }
        }
    }
    assert_eq!(row("wind", 500), [0.0, 0.0, 0.0]);
    assert_eq!(row("wind", n - 1), [3.0, -9.0, 1.0]);
    assert_eq!(result.log.joint_setpoint, row("joint_position", 0));
}

/// A log of made-up rows of these times, at which nothing moves and everything is as wished.
fn made_up_log(times: &[f64]) -> FlightLog {
    let robot = load_robot(&experiment("test2").robot).unwrap();
    let mut log = FlightLog::new(&robot, times.len());
    for series in &mut log.series {
        series.data = if series.signal.name == "time" {
            times.to_vec()
        } else {
            vec![0.0; times.len() * series.width()]
        };
    }
    log.joint_setpoint = vec![0.0; robot.joints.len()];
    log
}

fn set(log: &mut FlightLog, name: &str, entry: usize, value: f64) {
    let series = log.series.iter_mut().find(|series| series.signal.name == name).unwrap();
    series.data[entry] = value;
}

/// Each figure is computed from its own signals, from 3 s on where start-up is left out; ticks are those of the log.
#[test]
fn figures_of_a_made_up_log() {
    let times: Vec<f64> = (0..20).map(|tick| 0.25 * f64::from(tick)).collect();
    let mut log = made_up_log(&times);
    set(&mut log, "rotation_error", 5, 44.9_f64.to_radians());
    set(&mut log, "rotation_error", 13, 45.1_f64.to_radians());
    set(&mut log, "rotation_error", 14, 3.0);
    set(&mut log, "com_position", 3 * 11, 7.0); // at 2.75 s
    set(&mut log, "com_position", 3 * 12 + 1, 3.0); // at 3 s
    set(&mut log, "com_setpoint", 3 * 13 + 2, 4.0);
    set(&mut log, "com_position", 3 * 4, -2.0);
    set(&mut log, "thrust", 7, -0.5);
    set(&mut log, "thrust", 8, 0.25);
    set(&mut log, "joint_position", 23 * 2 + 4, -0.5);
    set(&mut log, "joint_position", 23 * 2 + 5, 0.25);
    set(&mut log, "joint_torque", 6, -9.0);
    set(&mut log, "aero_force_sim", 39 * 3, 3.0);
    set(&mut log, "aero_force_sim", 39 * 3 + 4, 4.0); // of another link
    set(&mut log, "aero_force_control", 39 * 3, 3.0);
    set(&mut log, "qp_status", 4, 1.0);
    set(&mut log, "qp_status", 5, 2.0);
    set(&mut log, "qp_kkt", 4, f64::NAN); // without an answer
    set(&mut log, "qp_kkt", 7, 1e-9);
    set(&mut log, "qp_iterations", 9, 6.0);
    let of = Summary::new(&log, times.len());
    // Sums of squares and their roots are within a few roundings.
    let near = |found: f64, expected: f64| assert_within!((found - expected).abs(), 1e-14);
    assert_eq!(
        [of.max_com_error, of.max_com_error_x, of.max_com_error_y, of.max_com_error_z],
        [4.0, 0.0, 3.0, 4.0]
    );
    near(of.rms_com_error, (25.0_f64 / 8.0).sqrt());
    near(of.rms_rotation_error, ((45.1_f64.to_radians().powi(2) + 9.0) / 8.0).sqrt());
    assert_eq!(of.max_rotation_error, 3.0);
    assert_eq!(of.time_above_45_deg, 0.5);
    assert_eq!((of.thrust_min, of.thrust_max), (-0.5, 0.25));
    assert_eq!((of.min_com_height, of.min_com_x_settling), (0.0, -2.0));
    assert_eq!((of.max_joint_error_sum, of.max_torque), (0.75, 9.0));
    assert_eq!((of.max_aero_force, of.max_aero_force_difference), (5.0, 4.0));
    assert_eq!((of.ticks_without_solution, of.max_kkt, of.max_qp_iterations), (1.0, 1e-9, 6.0));
    let before = Summary::new(&log, 13);
    assert_eq!((before.max_com_error, before.time_above_45_deg), (3.0, 0.0));
}

/// A flight that ends while it settles has no tracking error; its other figures count.
#[test]
fn figures_of_an_early_end() {
    let mut log = made_up_log(&[0.0, 0.5, 2.999]);
    set(&mut log, "com_position", 6, 7.0);
    set(&mut log, "rotation_error", 2, 1.0);
    let of = Summary::new(&log, 3);
    let after_settling = [
        of.max_com_error,
        of.max_com_error_x,
        of.max_com_error_y,
        of.max_com_error_z,
        of.rms_com_error,
        of.rms_rotation_error,
    ];
    assert!(after_settling.iter().all(|figure| figure.is_nan()), "{after_settling:?}");
    assert_eq!((of.max_rotation_error, of.time_above_45_deg), (1.0, 0.5));
}

/// A figure of a log that lacks one of its signals is NaN, never a number of nothing.
#[test]
fn figures_do_not_make_up_a_signal_that_is_missing() {
    let times: Vec<f64> = (0..20).map(|tick| 0.25 * f64::from(tick)).collect();
    let mut log = made_up_log(&times);
    for series in log.series.iter_mut().filter(|series| series.signal.name != "time") {
        series.data.fill(1.0);
    }
    let whole = Summary::new(&log, times.len());
    assert_eq!((whole.thrust_min, whole.max_torque), (1.0, 1.0));
    assert!(Summary::signals().contains("thrust"));
    for name in Summary::signals() {
        let mut without = log.clone();
        without.series.retain(|series| series.signal.name != name);
        let found = Summary::new(&without, times.len());
        let pairs = || whole.figures(true).zip(found.figures(true));
        assert!(pairs().any(|(_, (_, value))| value.is_nan()), "{name}");
        for ((figure, before), (_, value)) in pairs() {
            assert!(
                value.is_nan() || value.to_bits() == before.to_bits(),
                "{name}: {} is {value}",
                figure.name
            );
        }
    }
}

/// What is no number stays visible in every figure that is made of it.
#[test]
fn figures_do_not_hide_what_is_no_number() {
    let times: Vec<f64> = (0..20).map(|tick| 0.25 * f64::from(tick)).collect();
    let of_forces = ["com_position", "rotation_error", "thrust", "joint_torque", "aero_force_sim"];
    for signal in of_forces.into_iter().chain(["qp_status", "qp_kkt", "qp_iterations", "degraded_modes"]) {
        for tick in [0, 13, 19] {
            let mut log = made_up_log(&times);
            let width = log.series(signal).unwrap().width();
            // A controller may have one QP; without either nothing is known.
            for entry in 0..width.min(2) {
                set(&mut log, signal, tick * width + entry, f64::NAN);
            }
            set(&mut log, signal, (tick * width + width) % (20 * width), 1.0);
            let of = Summary::new(&log, times.len());
            let figures = match signal {
                "com_position" if tick == 0 => vec![of.min_com_x_settling],
                "com_position" => vec![of.max_com_error, of.max_com_error_x, of.rms_com_error],
                "rotation_error" => vec![of.max_rotation_error, of.time_above_45_deg],
                "thrust" => vec![of.thrust_min, of.thrust_max],
                "joint_torque" => vec![of.max_torque],
                "aero_force_sim" => vec![of.max_aero_force, of.max_aero_force_difference],
                "qp_status" => vec![of.ticks_without_solution],
                "qp_kkt" => vec![of.max_kkt],
                "qp_iterations" => vec![of.max_qp_iterations],
                _ => vec![of.degraded_time, of.nominal_until, of.all_modes, of.warning_time],
            };
            assert!(figures.iter().all(|figure| figure.is_nan()), "{signal} {tick}: {figures:?}");
        }
    }
}

fn bits(log: &FlightLog) -> Vec<Vec<u64>> {
    log.series.iter().map(|series| series.data.iter().map(|x| x.to_bits()).collect()).collect()
}

/// A batch gives the same bits on one, two and three threads, in the order of its configurations, and the
/// same as flying one by one; saturated flights too.
#[test]
fn batches_do_not_depend_on_threads() {
    let winds = [[0.0, -10.0, 0.0], [-15.0, 0.0, 0.0], [0.0, 6.0, 0.0], [9.0, -9.0, 2.0], [0.0, -18.0, 0.0]];
    let configs: Vec<ScenarioConfig> = winds
        .iter()
        .map(|wind| {
            with(experiment("test1_published"), |config| {
                config.simulator.duration = 14.0;
                config.wind = ramp_to(*wind);
            })
        })
        .collect();
    let fly_on = |threads: usize| -> Vec<Vec<Vec<u64>>> {
        fly_batch(&configs, Some(threads), || ControlFlow::Continue(()), |result| bits(&result.log)).unwrap()
    };
    let alone: Vec<_> = configs.iter().map(|config| bits(&run(config).log)).collect();
    for threads in [1, 2, 3] {
        assert!(fly_on(threads) == alone, "{threads} threads");
    }
    assert!(alone[0] != alone[1]);
}

/// A command that is refused changes nothing: the flight goes on as if it had not been handed in.
#[test]
fn a_refused_command_changes_nothing() {
    let config = short(0.05);
    let mut flight = Scenario::new(&config).unwrap().begin();
    for _ in 0..3 {
        let command = Some((&[0.0; 3][..], &[0.0; 23][..]));
        assert!(flight.step_with(&Given::default(), command).is_err());
        assert!(flight.step());
    }
    while flight.step() {}
    assert!(bits(flight.log()) == bits(&run(&config).log));
}

/// `progress` is called every tick and may end the flight.
#[test]
fn a_flight_can_be_interrupted() {
    let flight = Scenario::new(&short(1.0)).unwrap();
    assert_eq!(flight.n_ticks(), 100);
    let mut seen = Vec::new();
    let result = flight.run(|tick, of| {
        seen.push((tick, of));
        if tick == 7 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert!(matches!(result, Err(NoResult::Interrupted)));
    assert_eq!(seen, (0..=7).map(|tick| (tick, 100)).collect::<Vec<_>>());
}

/// A batch can be stopped while it is built and in the middle of its flights, of which none then has a result.
#[test]
fn a_batch_can_be_interrupted() {
    let configs = [short(50.0), short(50.0)];
    for calls in [0, 1, 20] {
        let left = AtomicUsize::new(calls);
        let count = |left: usize| left.checked_sub(1);
        let go_on = || match left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, count) {
            Ok(_) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        };
        let stopped = fly_batch(&configs, Some(2), go_on, |_| panic!("no flight ends"));
        assert!(matches!(stopped, Err(BatchError::Interrupted)), "{calls}");
    }
}

/// A batch names its first flight that cannot be built, and then flies none.
#[test]
fn a_batch_is_checked_before_it_flies() {
    let go_on = || ControlFlow::Continue(());
    let bad = with(short(0.2), |config| config.simulator.duration = -1.0);
    let configs = [short(0.2), bad.clone(), short(0.2), bad];
    let refused = fly_batch(&configs, Some(2), go_on, |_| panic!("no flight begins")).unwrap_err();
    assert!(matches!(refused, BatchError::Refused(1, _)));
    let expected = "flight 1 of the batch: `simulator.duration` is -1.0; expected a number > 0";
    assert_eq!(refused.to_string(), expected);
    assert!(fly_batch(&[], None, go_on, |_| ()).unwrap().is_empty());
}

/// A flight ends on the tick that exceeds a limit, with its reason and its row in the log.
#[test]
fn falls_have_their_reason() {
    let tipped = with(experiment("test1"), |config| config.simulator.fall.rotation_error_deg = 10.0);
    let shoved = with(experiment("test1"), |config| config.simulator.fall.com_error = 0.1);
    let flights = fly(&[tipped, shoved]);
    let last = |flight: &FlightResult, name: &str| *data(flight, name).last().unwrap();
    for flight in &flights {
        let Loss { time, .. } = flight.loss.unwrap();
        assert_eq!(last(flight, "time"), time);
        assert_eq!(flight.log.len(), tick_at(time) + 1);
    }
    let reason = |k: usize| flights[k].loss.unwrap().reason;

    let LossReason::RotationError(angle) = reason(0) else { panic!("{}", reason(0)) };
    assert_eq!(angle, last(&flights[0], "rotation_error"));
    let errors = data(&flights[0], "rotation_error");
    assert!(angle.to_degrees() > 10.0 && errors[errors.len() - 2].to_degrees() <= 10.0);
    assert_eq!(reason(0).to_string(), format!("rotation error {:.1} deg", angle.to_degrees()));

    let LossReason::ComError(distance) = reason(1) else { panic!("{}", reason(1)) };
    assert!((0.1..0.11).contains(&distance));
    assert_eq!(reason(1).to_string(), "CoM error 0.10 m");

    assert!(flights.iter().all(|flight| flight.outcome == Outcome::Fell));
}

/// A flight that reaches its end has completed, or was off course where its position error after the start-up exceeds
/// half a metre: with nine tenths of the mass in its model the robot sinks by 0.6 m.
#[test]
fn a_flight_that_reaches_its_end_is_on_course_or_not() {
    let sinking = |seconds| with(short(seconds), |c| c.disturbances.model_error.mass_scale = 0.9);
    for (config, outcome) in [
        (short(4.0), Outcome::Completed),
        (sinking(3.5), Outcome::OffCourse),
        // The start-up does not count.
        (sinking(2.5), Outcome::Completed),
    ] {
        let flight = run(&config);
        assert_eq!((flight.outcome, flight.loss), (outcome, None));
    }
}

/// A touch-down is a landing within its limits, and beyond one of them a crash: of the speed downwards, the speed sideways, the
/// angle from upright.
#[test]
fn a_touch_down_beyond_a_limit_is_a_crash() {
    let crash = |x, y, z, degrees: f64| Judge::crash(&Vector3::new(x, y, z), degrees.to_radians());
    for (landing, crashed, text) in [
        (crash(0.0, 0.0, -1.49, 0.0), crash(0.0, 0.0, -1.51, 0.0), "touches down at 1.5 m/s"),
        (crash(0.59, -0.8, 0.0, 0.0), crash(0.62, -0.8, 0.0, 0.0), "touches down at 1.0 m/s sideways"),
        (crash(0.0, 0.0, 0.0, 29.9), crash(0.0, 0.0, 0.0, 30.1), "touches down at 30.1 deg from upright"),
    ] {
        assert_eq!(landing, None);
        let reason = crashed.unwrap();
        assert_eq!((reason.outcome(), reason.to_string().as_str()), (Outcome::Crashed, text));
    }
    assert_eq!(crash(0.59, 0.8, -1.49, 29.9), None, "the limits are separate");
    assert_eq!(crash(0.0, 0.0, 3.0, 0.0), None, "upwards");
}

/// Each limit of what physics allows ends a flight at the tick that exceeds it, with its name; the row is in the
/// log and no merit.
#[test]
fn numbers_that_physics_excludes_diverge() {
    type Spoil = fn(&mut ScenarioConfig);
    type Commanded<'a> = Option<(&'a [f64], &'a [f64])>;
    let mut blow = [0.0; 23];
    blow[6] = 70.0; // the left elbow
    let spoilt: [(Spoil, Commanded, LossReason, &str); 5] = [
        (
            |c| c.simulator.initial.base_velocity[1] = 301.0,
            None,
            LossReason::Speed,
            "speed of base or air above 300 m/s",
        ),
        (
            |c| c.wind = flight_sim::WindConfig::Constant { velocity: [0.0, 301.0, 0.0] },
            None,
            LossReason::Speed,
            "speed of base or air above 300 m/s",
        ),
        (
            |c| c.simulator.initial.base_velocity[4] = -101.0,
            None,
            LossReason::AngularVelocity,
            "angular velocity above 100 rad/s",
        ),
        (
            |c| c.simulator.initial.joint_position[3] -= 8.0,
            None,
            LossReason::JointPosition,
            "joint more than 6 rad beyond its stop",
        ),
        (
            |c| c.simulator.joint_stops = false,
            Some((&[0.0; 4], &blow)),
            LossReason::JointVelocity,
            "joint velocity above 100 rad/s",
        ),
    ];
    for (spoil, command, reason, text) in spoilt {
        let config = with(short(0.5), |config| {
            config.simulator.initial.free_fall_tick = false;
            spoil(config);
        });
        let mut flight = Scenario::new(&config).unwrap().begin();
        while flight.step_with(&Given::default(), command).unwrap() {}
        let flight = flight.result();
        let loss = flight.loss.unwrap();
        assert_eq!((flight.outcome, loss.reason), (Outcome::Diverged, reason));
        assert_eq!(loss.reason.to_string(), text);
        assert_eq!(flight.log.len(), tick_at(loss.time) + 1);
        let merits = flight.summary;
        let values: Vec<f64> = merits.figures(false).map(|(_, value)| value).collect();
        let missing = values.iter().filter(|figure| figure.is_nan()).count();
        if loss.time == 0.0 {
            assert_eq!(missing, values.len(), "{merits:?}");
        } else {
            assert_eq!(missing, 6, "those after settling: {merits:?}");
            assert!(merits.max_aero_force < 100.0, "{merits:?}");
        }
    }
}

/// Below its limits nothing diverges.
#[test]
fn numbers_that_physics_allows_fly() {
    let fast = with(short(0.02), |config| {
        config.simulator.initial.base_velocity = [299.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        config.simulator.aero = super::NO_AIR;
        config.controller.aero = super::NO_AIR;
        config.simulator.fall.com_error = 1e9;
    });
    assert!(run(&fast).loss.is_none());
    let at_its_limits = with(fast, |config| {
        config.simulator.initial.base_velocity = [300.0, 0.0, 0.0, 0.0, 0.0, 100.0];
        config.simulator.initial.thrust[2] = 220.0;
        config.simulator.initial.free_fall_tick = false;
    });
    let mut flight = Scenario::new(&at_its_limits).unwrap().begin();
    assert!(flight.step(), "{:?}", flight.loss());
}

/// A robot that nothing touches falls freely whatever the controller commands of its joints, but for the
/// error of the integrator, which shrinks with its step.
#[test]
fn without_thrust_the_centre_of_mass_falls_freely() {
    for (substeps, tolerance) in [(1, 2e-3), (10, 2e-4), (100, 2e-5)] {
        let config = with(short(0.4), |config| {
            config.wind = STILL;
            config.simulator.substeps = substeps;
            config.simulator.aero = super::NO_AIR;
            config.simulator.initial.thrust = vec![0.0; 4];
            config.simulator.initial.free_fall_tick = false;
            config.simulator.fall.rotation_error_deg = 180.0;
            for rate in config.controller.law.bounds.thrust_rate_max.values_mut() {
                *rate = 0.0;
            }
        });
        let result = run(&config);
        assert!(result.loss.is_none());
        for (velocity, time) in data(&result, "com_velocity").chunks(3).zip(data(&result, "time")) {
            assert_within!((velocity[2] + 9.81 * time).abs(), tolerance, because "free fall in steps of 10 ms: h²/12 of the acceleration's change", "{velocity:?} at {time} s");
            assert_within!(velocity[0].abs(), tolerance, because "free fall in steps of 10 ms: h²/12 of the acceleration's change", "{velocity:?}");
            assert_within!(velocity[1].abs(), tolerance, because "free fall in steps of 10 ms: h²/12 of the acceleration's change", "{velocity:?}");
        }
        let moving = data(&result, "joint_velocity").iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        assert!(moving > 0.1, "joints move at {moving} rad/s");
    }
}

type Refusal = (&'static str, fn(&mut ScenarioConfig), &'static str);

/// Where there is no ground, nothing is on the feet of a controller that could stand: it flies as one without feet.
#[test]
fn a_controller_with_feet_flies() {
    let config = with(experiment("test2_observer"), |config| config.simulator.duration = 1.0);
    let contact = experiment("take_off").controller.law.contact;
    let able = with(config.clone(), |config| config.controller.law.contact = contact);
    let [able, without] = [able, config].map(|config| run(&config));
    assert_eq!(able.outcome, Outcome::Completed);
    let end = |result| Vector3::from_column_slice(&data(result, "com_position")[300..]);
    assert_within!(difference(end(&able), end(&without)), 1e-9, because "QPs with more unknowns, all of them zero");
}

/// Every number of the simulator that cannot be is refused by name, with its value.
#[test]
#[rustfmt::skip]
fn bad_simulators_are_refused_by_name() {
    let refusals: [Refusal; 8] = [
        ("simulator.duration", |c| c.simulator.duration = f64::NAN, "is not finite"),
        ("simulator.duration", |c| (c.simulator.duration, c.controller.law.time_step) = (1e5, 0.01), "exceeds 2 GiB"),
        ("simulator.duration / controller.time_step", |c| c.simulator.duration = 1e8, "at most ten million"),
        ("controller.time_step", |c| (c.controller.law.time_step, c.simulator.jets) = (0.014, serde_json::from_str(r#"{"dynamics": "throttled"}"#).unwrap()), "is 0.014; expected below 2 / (150/s)"),
        ("simulator.initial.thrust", |c| c.simulator.initial.thrust[1] = 160.5, "is 160.5; expected newtons from 0 to 160, the range of jet `r_arm_jet`"),
        ("length of simulator.initial.joint_position", |c| { c.simulator.initial.joint_position.pop(); }, "is 22; expected 23"),
        ("length of simulator.initial.thrust", |c| c.simulator.initial.thrust.push(0.0), "is 5; expected 4"),
        ("coefficients", |c| c.simulator.aero = serde_json::from_str(r#"{"model": "axisymmetric", "coefficients": "nobodys", "air_density": 1.2}"#).unwrap(), "nobodys"),
    ];
    let low = with(experiment("mk3_hover"), |c| c.simulator.initial.thrust[1] = 10.9);
    let message = Scenario::new(&low).unwrap_err().to_string();
    assert!(message.contains("newtons from 11 to 227, the range of jet `r_arm_jet`"), "{message}");
    for (item, spoil, value) in refusals {
        let message = Scenario::new(&with(experiment("test2"), spoil)).unwrap_err().to_string();
        assert!(message.contains(item) && message.contains(value), "{item}: {message}");
    }
}

/// TEST2 at ticks of 2 and 5 ms is the flight of 10 ms: the same places at every time and the same greatest speed, to
/// 1 % of the way and of the speed.
#[test]
fn the_flight_does_not_depend_on_the_tick() {
    let at = |time_step| with(experiment("test2"), |config| config.controller.law.time_step = time_step);
    let flights = fly(&[at(0.01), at(0.005), at(0.002)]);
    let places = |flight: usize| flights[flight].log.series("com_position").unwrap();
    let speed = |flight: usize| {
        let velocity = &flights[flight].log.series("com_velocity").unwrap().data;
        velocity.chunks_exact(3).map(|v| Vector3::from_column_slice(v).norm()).fold(0.0, f64::max)
    };
    for (finer, ratio) in [(1, 2), (2, 5)] {
        for tick in 0..flights[0].log.len() {
            for (found, expected) in places(finer).row(ratio * tick).iter().zip(places(0).row(tick)) {
                assert_within!((found - expected).abs(), 0.01 * 78.0, because "set-points of ticks of another length differ by what happens in one tick", "{tick}");
            }
        }
        assert_within!((speed(finer) - speed(0)).abs(), 0.01 * 7.5);
    }
    assert!(flights.iter().all(|flight| flight.outcome == Outcome::Completed));
}

/// The controller's own time step is refused too: it may be built without a simulator.
#[test]
fn bad_time_steps_are_refused_by_the_controller() {
    let mut config = experiment("test2");
    let robot = load_robot(&config.robot).unwrap();
    for time_step in [0.0, -0.01, f64::NAN, f64::INFINITY] {
        config.controller.law.time_step = time_step;
        let controller = load_controller(robot.clone(), &config.controller, &config.mission);
        let message = controller.unwrap_err().to_string();
        assert!(message.contains("controller.time_step"), "{message}");
    }
}

/// A flight of less than half a tick has its first row.
#[test]
fn the_shortest_flight_has_one_row() {
    let result = run(&short(0.004));
    assert_eq!(result.log.len(), 1);
    assert!(result.loss.is_none());
}
