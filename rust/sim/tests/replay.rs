//! Logs through the tick: the same bits for flights of ours, and refusals of logs of other periods.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{assert_says, at, experiment, outage};
use flight_core::control::estimate::joint_tracker::JointMeasurement;
use flight_core::{Measurement, RobotState};
use flight_io::load_robot;
use flight_sim::disturbances::{OutageChannel, OutageKind};
use flight_sim::signals::Read;
use flight_sim::{FlightLog, Scenario, ScenarioConfig, replay};
use nalgebra::Vector3;
use std::ops::ControlFlow;

fn log_of(config: &ScenarioConfig) -> FlightLog {
    Scenario::new(config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap().log
}

/// Bits of a signal, because a missing measurement is no number.
fn bits(log: &FlightLog, name: &str) -> Vec<u64> {
    log.series(name).unwrap().data.iter().map(|number| number.to_bits()).collect()
}

/// With exact measurements; with sensors, an estimator, outages and a wrong model; with a plan and the wind ahead.
#[test]
fn a_flight_replays_with_the_same_bits() {
    let missing = |channel| outage(channel, OutageKind::Missing, 0.3, Some(0.2));
    for (name, duration) in [("test2", 0.6), ("test2_sensors", 0.6), ("test2_mpc", 0.1)] {
        let mut config = experiment(name);
        config.simulator.duration = duration;
        config.wind = experiment("head_wind").wind;
        if let Some(sensors) = &mut config.simulator.sensors {
            sensors.wind_preview = 0.8;
            config.disturbances.outages =
                vec![missing(OutageChannel::Joints), missing(OutageChannel::BaseRotation)];
            config.disturbances.model_error.mass_scale = 1.02;
        }
        let log = log_of(&config);
        let replayed = replay(&config, &log).unwrap();
        assert!(replayed.series.iter().all(|series| matches!(series.signal.read, Some(Read::Tick(_)))));
        for series in &replayed.series {
            let name_of = series.signal.name;
            assert_eq!(bits(&replayed, name_of), bits(&log, name_of), "{name}: {name_of}");
        }
        let missed = log.series("raw_joint_position").unwrap().data.iter().filter(|x| x.is_nan()).count();
        assert_eq!(missed > 0, !config.disturbances.outages.is_empty());
    }
}

/// Every tenth row is a tick of the law; those between are of the torques.
#[test]
fn a_log_at_the_rate_of_the_torques_has_a_tick_of_the_law_in_every_tenth_row() {
    let mut config = experiment("test2");
    config.simulator.duration = 0.2;
    let mut log = log_of(&config); // 21 rows
    config.controller.law.torque.steps = 10;
    assert_says(
        &replay(&config, &log).unwrap_err(),
        &["period of the log", "0.01", "0.001", "controller.torque.steps, 10"],
    );
    for series in &mut log.series {
        if series.signal.name == "time" {
            series.data.iter_mut().for_each(|time| *time /= 10.0);
        }
    }
    let replayed = replay(&config, &log).unwrap();
    assert_eq!(replayed.len(), 3);

    let mut controller = config.controller(load_robot(&config.robot).unwrap()).unwrap();
    let mut memory = None;
    let rows = |name: &str, row: usize| log.series(name).unwrap().row(row).to_vec();
    for row in 0..21 {
        let (position, velocity) = (rows("raw_joint_position", row), rows("raw_joint_velocity", row));
        if row % 10 > 0 {
            let measured = JointMeasurement { position: &position, velocity: &velocity };
            controller.tick_torques(memory.as_mut().unwrap(), &measured);
            continue;
        }
        let mut state = RobotState::zero(position.len());
        state.base.position.copy_from_slice(&rows("raw_base_position", row));
        state.base.rotation.copy_from_slice(&rows("raw_base_rotation", row));
        state.base.rotation.transpose_mut();
        state.joint_position.copy_from_slice(&position);
        state.velocity.copy_from_slice(&[rows("raw_base_velocity", row), velocity].concat());
        let (thrust, wind) = (rows("raw_thrust", row), Vector3::from_vec(rows("raw_wind", row)));
        let time = rows("time", row)[0];
        let measurement = Measurement { wind, ..at(time, &state, &thrust) };
        let memory = memory.get_or_insert_with(|| controller.start(&measurement).unwrap());
        let torque = controller.tick(memory, &measurement).joint_torque.as_slice();
        assert_eq!(torque, replayed.series("joint_torque").unwrap().row(row / 10), "row {row}");
    }
}

/// A log of another period, without rows, or with a first row that no flight can start with.
#[test]
fn a_log_that_no_tick_fits_is_refused() {
    let mut config = experiment("test2");
    config.simulator.duration = 0.1;
    let log = log_of(&config);
    let mut without = log.clone();
    without.series.retain(|series| series.signal.name != "raw_thrust");
    assert_says(&replay(&config, &without).unwrap_err(), &["first row of the log", "thrust", "NaN"]);
    without.series.clear();
    assert_says(&replay(&config, &without).unwrap_err(), &["number of rows of the log is 0"]);
    config.controller.law.time_step = 0.005;
    assert_says(
        &replay(&config, &log).unwrap_err(),
        &["period of the log", "0.005", "controller.time_step", "controller.mpc.period and knots"],
    );
    config.controller.law.time_step = 0.01;
    let mut doubled = log.clone();
    let time = doubled.series.iter_mut().find(|series| series.signal.name == "time").unwrap();
    time.data[5] = time.data[4];
    assert_says(&replay(&config, &doubled).unwrap_err(), &["row 6", "0.04 s", "row 5"]);
}

/// Ticks without a measurement, and a pause of the ticks, in place of lost rows; the period is that of most rows.
#[test]
fn a_log_with_lost_rows_replays() {
    let mut config = experiment("test2");
    config.simulator.duration = 0.5;
    let log = log_of(&config);
    let lost = 20..25;
    let mut missing = log.clone();
    for series in missing.series.iter_mut().filter(|series| series.signal.name.starts_with("raw_")) {
        let width = series.width();
        series.data[lost.start * width..lost.end * width].fill(f64::NAN);
    }
    let mut paused = log.clone();
    for series in &mut paused.series {
        let width = series.width();
        series.data.drain(lost.start * width..lost.end * width);
    }
    let last = |log: &FlightLog| log.series("joint_torque").unwrap().row(log.len() - 1).to_vec();
    let torques = |log: &FlightLog| log.series("joint_torque").unwrap().data.clone();
    for (log_with_gap, rows) in [(&missing, log.len()), (&paused, log.len() - lost.len())] {
        let replayed = replay(&config, log_with_gap).unwrap();
        assert_eq!(replayed.len(), rows);
        assert!(torques(&replayed).iter().all(|torque| torque.is_finite()));
    }
    // The integral of the joints' errors continues through missing ticks, but not through a pause.
    let replayed = replay(&config, &missing).unwrap();
    let range = torques(&replayed).iter().fold(0.0_f64, |most, torque| most.max(torque.abs()));
    let (found, expected) = (last(&replayed), last(&log));
    let apart = found.iter().zip(&expected).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f64::max) < 0.01 * range, "it did not recover");
}
