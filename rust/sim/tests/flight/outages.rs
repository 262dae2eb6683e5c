//! What the observer's controller does without a channel, from an exact start (docs/failures.md has perturbed flights),
//! descents out of fast motion, engines that fail.

use super::with;
use crate::common::{assert_within, experiment};
use flight_core::control::Modes;
use flight_sim::disturbances::{FailureKind, JetFailure, Outage, OutageChannel, OutageKind};
use flight_sim::sensors::ThrustSensorConfig;
use flight_sim::{FlightResult, LossReason, Outcome, Scenario, ScenarioConfig};
use std::ops::ControlFlow;

/// When outages begin: hovering in the wind \[s\].
const START: f64 = 18.0;

const FOR_EVER: f64 = f64::INFINITY;

fn outage(channel: OutageChannel, duration: f64, kind: OutageKind) -> Outage {
    let duration = (duration < FOR_EVER).then_some(duration);
    Outage { channel, jet: None, start: START, duration, kind, error: 1.0 }
}

fn fly(outages: Vec<Outage>, change: impl FnOnce(&mut ScenarioConfig)) -> FlightResult {
    let config = with(experiment("test2_observer"), |config| {
        config.disturbances.outages = outages;
        change(config);
    });
    Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap()
}

/// All modes of a flight.
fn modes(flight: &FlightResult) -> u32 {
    let series = flight.log.series("degraded_modes").unwrap();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    series.data.iter().fold(0, |all, modes| all | *modes as u32)
}

/// A signal's last row.
fn last<'a>(flight: &'a FlightResult, name: &str) -> &'a [f64] {
    flight.log.series(name).unwrap().row(flight.log.len() - 1)
}

fn completes(lost: Outage, expected: u32, worst_deg: f64) {
    let what = format!("{lost:?}");
    let flight = fly(vec![lost], |_| ());
    assert_eq!(flight.outcome, Outcome::Completed, "{what}: {:?}", flight.loss);
    assert_eq!(modes(&flight), expected, "{what}");
    let rotation = flight.summary.max_rotation_error.to_degrees();
    assert_within!(rotation, worst_deg, because "margin of the flight, not of rounding", "{what}: {rotation} deg");
}

#[test]
fn without_wind_it_completes() {
    let lost = Modes::WIND_HELD.bits() | Modes::WIND_LOST.bits();
    for (duration, modes) in [(0.3, 1), (1.0, 1), (FOR_EVER, lost)] {
        completes(outage(OutageChannel::Wind, duration, OutageKind::Missing), modes, 5.0);
    }
}

#[test]
fn without_thrust_sensors_it_completes() {
    for duration in [0.3, 1.0, FOR_EVER] {
        let lost = outage(OutageChannel::Thrust, duration, OutageKind::Missing);
        let one = Outage { jet: Some("chest_l_jet".into()), ..lost.clone() };
        for lost in [lost, one] {
            completes(lost, Modes::THRUST_MODELLED.bits(), 5.0);
        }
    }
}

#[test]
fn blind_for_a_second_it_completes() {
    for (channel, mode) in [
        (OutageChannel::BasePosition, Modes::POSITION_PREDICTED),
        (OutageChannel::BaseRotation, Modes::ROTATION_PREDICTED),
        (OutageChannel::BaseVelocity, Modes::VELOCITY_PREDICTED),
    ] {
        for duration in [0.3, 1.0] {
            // An error beyond every jump.
            for (kind, error) in [(OutageKind::Missing, 1.0), (OutageKind::Wrong, 3.0)] {
                completes(Outage { error, ..outage(channel, duration, kind) }, mode.bits(), 5.0);
            }
        }
    }
    completes(outage(OutageChannel::Joints, 0.3, OutageKind::Nan), Modes::JOINTS_PREDICTED.bits(), 5.0);
}

/// Everything of the state stands still for 0.3 s: recognised, and survived.
#[test]
fn a_frozen_state_is_recognised() {
    let channels = [
        (OutageChannel::Joints, Modes::JOINTS_PREDICTED),
        (OutageChannel::BasePosition, Modes::POSITION_PREDICTED),
        (OutageChannel::BaseRotation, Modes::ROTATION_PREDICTED),
        (OutageChannel::BaseVelocity, Modes::VELOCITY_PREDICTED),
    ];
    let frozen = channels.map(|(channel, _)| outage(channel, 0.3, OutageKind::Frozen)).to_vec();
    let flight = fly(frozen, |config| config.simulator.duration = 24.0);
    assert_eq!(flight.outcome, Outcome::Completed, "{:?}", flight.loss);
    assert!(modes(&flight) & Modes::VELOCITY_PREDICTED.bits() != 0, "{}", modes(&flight));
}

/// Level, and down at the configured speed, until it lands.
#[test]
fn blind_for_good_it_descends() {
    for channel in [OutageChannel::BasePosition, OutageChannel::BaseRotation, OutageChannel::BaseVelocity] {
        let lost = outage(channel, FOR_EVER, OutageKind::Missing);
        let flight = fly(vec![lost], |config| config.simulator.duration = 36.0);
        assert_eq!(flight.outcome, Outcome::Landed, "{channel:?}: {:?}", flight.loss);
        assert!(modes(&flight) & Modes::DESCENDING.bits() != 0);
        let velocity = last(&flight, "com_velocity");
        assert_within!((velocity[2] + 0.5).abs(), 0.05, because "air pushes on the way down", "{channel:?}: {velocity:?}");
        assert_within!(last(&flight, "rotation_error")[0].to_degrees(), 8.0, because "margin of the flight", "{channel:?}");
    }
}

/// Out of the fast leg, at 7.5 m/s, it brakes as the mission does.
#[test]
fn blind_in_the_fast_leg_it_brakes() {
    for channel in [OutageChannel::BasePosition, OutageChannel::BaseRotation, OutageChannel::BaseVelocity] {
        let lost = Outage { start: 25.0, ..outage(channel, FOR_EVER, OutageKind::Missing) };
        let flight = fly(vec![lost], |config| config.simulator.duration = 38.0);
        assert_eq!(flight.outcome, Outcome::Landing, "{channel:?}: {:?}", flight.loss);
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, 8.0, because "margin of the flight", "{channel:?}: {rotation} deg");
        let velocity = last(&flight, "com_velocity");
        assert_within!(velocity[0].hypot(velocity[1]), 0.1, because "air pushes on the way down", "{channel:?}: {velocity:?}");
    }
}

/// Out of a recorded mission, which accelerates and brakes with 4 m/s², likewise; but this one is flown below the height of its
/// start, where the robot is down before it has braked.
#[test]
fn blind_on_a_recorded_mission_it_brakes() {
    for (start, end) in [(10.0, Outcome::Crashed), (14.0, Outcome::Crashed), (17.0, Outcome::Landed)] {
        let recorded = experiment("min_time");
        let lost = Outage { start, ..outage(OutageChannel::BasePosition, FOR_EVER, OutageKind::Missing) };
        let flight = fly(vec![lost], |config| {
            (config.mission, config.wind) = (recorded.mission, recorded.wind);
            config.simulator.duration = start + 10.0;
        });
        assert_eq!(flight.outcome, end, "{start} s: {:?}", flight.loss);
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, 20.0, because "margin of the flight", "{start} s: {rotation} deg");
    }
}

/// A thrust sensor that stands still or is off for good: the momentum shows it, and the thrust is modelled from then on.
#[test]
fn with_a_wrong_thrust_sensor_it_completes() {
    let none = Modes::default();
    for (jet, kind, error, others) in [
        ("l_arm_jet", OutageKind::Wrong, -40.0, Modes::TRACKING_ERROR),
        ("chest_r_jet", OutageKind::Wrong, 20.0, none),
        ("chest_r_jet", OutageKind::Wrong, -90.0, none),
        ("l_arm_jet", OutageKind::Frozen, 1.0, none),
        ("chest_r_jet", OutageKind::Frozen, 1.0, none),
    ] {
        let lost = outage(OutageChannel::Thrust, FOR_EVER, kind);
        let expected = Modes::THRUST_MODELLED.bits() | others.bits();
        completes(Outage { jet: Some(jet.into()), error, ..lost }, expected, 30.0);
    }
}

const JETS: [&str; 4] = ["l_arm_jet", "r_arm_jet", "chest_l_jet", "chest_r_jet"];

/// A flight in which an engine fails at `time` \[s\], and after how long that was found \[s\].
fn fly_without(
    jet: &str,
    kind: FailureKind,
    decay: f64,
    time: f64,
    duration: f64,
) -> (FlightResult, Option<f64>) {
    let flight = fly(Vec::new(), |config| {
        config.simulator.duration = duration;
        config.disturbances.jets.failure = Some(JetFailure { jet: jet.into(), time, kind, decay });
    });
    let series = flight.log.series("degraded_modes").unwrap();
    let first = series.data.iter().position(|modes| *modes >= f64::from(Modes::ENGINE_LIMITED.bits()));
    (flight, first.map(|tick| tick as f64 * 0.01 - time))
}

/// An engine that fades is found within 0.15 s, and the robot sinks to the ground; so it does without a chest jet that stops at
/// once.
#[test]
fn without_an_engine_it_sinks_to_the_ground() {
    let fading = JETS.map(|jet| (jet, 0.5, 0.15, 20.0));
    let stopping = ["chest_l_jet", "chest_r_jet"].map(|jet| (jet, 0.0, 0.075, 70.0));
    for (jet, decay, time_to_find, lean) in fading.into_iter().chain(stopping) {
        let (flight, found) = fly_without(jet, FailureKind::Off, decay, START, 30.0);
        assert_eq!(flight.outcome, Outcome::Landed, "{jet}: {:?}", flight.loss);
        assert!(found.is_some_and(|time| (0.03..time_to_find).contains(&time)), "{jet}: {found:?}");
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, lean, because "17 and 59 degrees of the flights, not of rounding", "{jet}: {rotation} deg");
        // At the height at which it began, where the ground is.
        let height = |row: &[f64]| row[2];
        let start = height(flight.log.series("com_position").unwrap().row(0));
        assert!(height(last(&flight, "com_position")) <= start, "{jet}");
        let speed = height(last(&flight, "com_velocity"));
        assert!((-1.1..-0.4).contains(&speed), "{jet}: {speed}");
    }
}

/// In the fast leg an arm that fades is given up while there is thrust left to turn with, but none to brake: it comes down level,
/// at 2 m/s sideways.
#[test]
fn an_arm_that_fades_in_the_fast_leg_comes_down_level_and_too_fast() {
    for jet in &JETS[..2] {
        let (flight, _) = fly_without(jet, FailureKind::Off, 0.5, 28.0, 38.0);
        let loss = flight.loss.unwrap();
        assert!(matches!(loss.reason, LossReason::SidewaysSpeed(1.5..2.5)), "{jet}: {loss:?}");
        assert_eq!((flight.outcome, loss.time), (Outcome::Crashed, last(&flight, "time")[0]));
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, 20.0, because "margin of the flight", "{jet}: {rotation} deg");
    }
}

/// One that keeps its thrust is no loss before another thrust is asked of it: the mission goes on, with a chest jet until it
/// descends, which takes longer than the flight.
#[test]
fn with_a_stuck_engine_it_completes() {
    let ends = [Outcome::Completed, Outcome::Completed, Outcome::Landing, Outcome::Landing];
    for (jet, end) in JETS.into_iter().zip(ends) {
        let (flight, _) = fly_without(jet, FailureKind::Stuck, 0.0, START, 50.0);
        assert_eq!(flight.outcome, end, "{jet}: {:?}", flight.loss);
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, 15.0, because "margin of the flight, not of rounding", "{jet}: {rotation} deg");
    }
}

/// Thrusts rounded to 1 N repeat bits in health, so that jets are suspects: what is looked for and not found changes no bit. The
/// arm that stops with its sensor is found as early as one that is measured.
#[test]
fn an_engine_that_stops_with_its_sensor_is_found_and_a_healthy_flight_is_the_same() {
    let fly = |looks: bool, stops: bool| {
        let config = with(experiment("robot"), |config| {
            config.simulator.duration = if stops { 1.2 } else { 0.6 };
            config.simulator.sensors.as_mut().unwrap().thrust =
                ThrustSensorConfig { resolution: 1.0, ..Default::default() };
            let jet = JETS[0].to_owned();
            if stops {
                let lost = outage(OutageChannel::Thrust, FOR_EVER, OutageKind::Missing);
                config.disturbances.outages = vec![Outage { start: 1.0, jet: Some(jet.clone()), ..lost }];
                config.disturbances.jets.failure =
                    Some(JetFailure { jet, time: 1.0, kind: FailureKind::Off, decay: 0.0 });
            }
            if !looks {
                config.controller.law.fault_detection.unmeasured_engines = None;
            }
        });
        Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap()
    };
    let (with, without) = (fly(true, false), fly(false, false));
    for name in ["com_position", "joint_torque", "thrust", "degraded_modes"] {
        assert_eq!(with.log.series(name).unwrap().data, without.log.series(name).unwrap().data, "{name}");
    }
    assert_eq!(modes(&fly(true, true)) & Modes::ENGINE_STOPPED.bits(), Modes::ENGINE_STOPPED.bits());
    assert_eq!(modes(&fly(false, true)) & Modes::ENGINE_LIMITED.bits(), 0);
}
