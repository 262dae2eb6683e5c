//! A first measurement that is wrong: the following ones outvote it, and the flight begins again from them (M141).

use super::with;
use crate::common::{Loop, TIME_STEP, assert_says, assert_within, at, experiment, outage, read, tick_at};
use crate::fuzz::cases::cases;
use flight_core::control::{Measurement, Modes};
use flight_core::kinematics::RobotState;
use flight_core::spatial::axis_angle;
use flight_sim::disturbances::{Outage, OutageChannel, OutageKind};
use flight_sim::signals::TrackingErrors;
use flight_sim::{NoResult, Outcome, Scenario, ScenarioConfig, Sensors, Wind, fly_batch};
use nalgebra::{Unit, Vector3};
use proptest::prelude::*;
use std::ops::ControlFlow;

/// Greatest rotation \[deg\] and position error \[m\] of a flight, from its third tick on, and its modes by tick. Its first
/// measurements are spoiled.
fn fly(
    config: &ScenarioConfig,
    seconds: f64,
    mut spoil: impl FnMut(usize, &mut RobotState),
) -> (f64, f64, Vec<Modes>) {
    let mut flight = Loop::new(config);
    let (joints, jets) = (flight.plant.robot().joints.len(), flight.plant.robot().jets.len());
    let sensors = config.simulator.sensors.as_ref();
    let mut sensors = sensors.map(|sensors| Sensors::new(sensors, TIME_STEP, joints, jets).unwrap());
    let wind = Wind::new(&config.wind).unwrap();
    let (mut rotation, mut position, mut modes) = (0.0_f64, 0.0_f64, Vec::new());
    for tick in 0..tick_at(seconds) {
        let time = tick as f64 * TIME_STEP;
        let wind = wind.velocity(time);
        flight.plant.observe(&wind);
        let (mut state, mut thrust) =
            (flight.plant.state().clone(), flight.plant.jets().thrust_feedback().to_vec());
        if let Some(sensors) = &mut sensors {
            let reading = read(sensors, &state, &thrust);
            (state, thrust) = (reading.state, reading.thrust);
        }
        spoil(tick, &mut state);
        let measurement = Measurement { wind, ..at(time, &state, &thrust) };
        let command = flight.controller.tick(&measurement).clone();
        modes.push(command.modes);
        let errors = TrackingErrors::new(&flight.plant, &flight.controller.terms().setpoint);
        if tick > 2 {
            rotation = rotation.max(errors.rotation.to_degrees());
            position = position.max(errors.com);
        }
        let (torque, rates) = (command.joint_torque.as_slice(), command.thrust_rate.as_slice());
        flight.plant.advance(torque, rates, &wind, TIME_STEP);
    }
    (rotation, position, modes)
}

fn begun_again(modes: &[Modes]) -> Vec<usize> {
    let again = modes.iter().enumerate().filter(|(_, modes)| modes.contains(Modes::BEGUN_AGAIN));
    again.map(|(tick, _)| tick).collect()
}

/// One joint is measured wrong in the first tick, exactly and with realistic sensors. Judged by the first measurement, the
/// robot falls within 0.6 s with an error of 1 rad, and of 0.4 rad with realistic sensors.
#[test]
fn a_first_joint_that_is_wrong_is_outvoted() {
    for name in ["test2_observer", "test2_sensors"] {
        let config = experiment(name);
        let (right, _, modes) = fly(&config, 3.0, |_, _| ());
        assert!(begun_again(&modes).is_empty(), "{name}");
        for error in [1.0, 0.4, 0.12] {
            let (rotation, position, modes) = fly(&config, 3.0, |tick, state| {
                if tick == 0 {
                    state.joint_position[6] += error;
                }
            });
            assert_eq!(begun_again(&modes), [2], "{name} {error}");
            assert_within!(rotation, right + 8.0, because "margin of the flight", "{name} {error}: {rotation} deg");
            assert_within!(position, 0.1, because "margin of the flight", "{name} {error}: {position} m");
        }
    }
}

/// All joints at once, and the pose of the base: the flight refers to what is measured later.
#[test]
fn a_flight_begins_again_with_its_reference() {
    let fly = |outages| {
        let config = with(experiment("test2_observer"), |config| {
            config.simulator.duration = 3.0;
            config.disturbances.outages = outages;
        });
        Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap()
    };
    let right = fly(vec![]);
    for (channel, error) in [
        (OutageChannel::Joints, 0.15),
        (OutageChannel::BasePosition, 0.5),
        (OutageChannel::BaseRotation, 0.7),
    ] {
        let wrong = outage(channel, OutageKind::Wrong, 0.0, Some(0.01));
        let flight = fly(vec![Outage { error, ..wrong }]);
        assert_eq!(flight.outcome, Outcome::Completed, "{channel:?}: {:?}", flight.loss);
        let modes = flight.log.series("degraded_modes").unwrap();
        let again = f64::from(Modes::BEGUN_AGAIN.bits());
        assert_eq!(modes.data.iter().position(|modes| *modes == again), Some(2), "{channel:?}");
        for (found, expected) in flight.log.joint_setpoint.iter().zip(&right.log.joint_setpoint) {
            assert_within!((found - expected).abs(), 0.075, because "half of the error; torques have acted for two ticks", "{channel:?}");
        }
        for name in ["base_position", "joint_position"] {
            let row = |flight: &flight_sim::FlightResult| flight.log.series(name).unwrap().row(300).to_vec();
            for (found, expected) in row(&flight).iter().zip(row(&right)) {
                assert_within!((found - expected).abs(), 0.05, because "two ticks of 10 ms", "{channel:?} {name}");
            }
        }
    }
}

#[test]
fn a_flight_does_not_begin_where_nothing_is_measured() {
    for kind in [OutageKind::Missing, OutageKind::Nan, OutageKind::Frozen] {
        let lost = outage(OutageChannel::Joints, kind, 0.0, None);
        let config = with(experiment("test2_observer"), |config| config.disturbances.outages = vec![lost]);
        assert_says(
            &Scenario::new(&config).unwrap_err(),
            &["disturbances.outages[0].start is 0", "seconds > 0"],
        );
    }
}

/// A flight that cannot begin with its first measurement has no result, and says why; its batch says which.
#[test]
fn a_start_that_is_refused_says_why() {
    let wrong = outage(OutageChannel::Joints, OutageKind::Wrong, 0.0, Some(0.01));
    let config = with(experiment("test2_observer"), |config| {
        config.disturbances.outages = vec![Outage { error: 6.0, ..wrong }];
    });
    let mut flight = Scenario::new(&config).unwrap().begin();
    assert!(flight.try_tick().is_err());
    assert!(!flight.step() && flight.has_ended());
    assert_eq!((flight.tick(), flight.loss()), (0, None));
    let refusal = NoResult::Refused(flight.refusal().unwrap());
    let why = refusal.to_string();
    assert!(why.starts_with("a flight cannot begin: `joint_position[0]` holds "), "{why}");
    let go_on = || ControlFlow::Continue(());
    assert_eq!(Scenario::new(&config).unwrap().run(|_, _| go_on()).unwrap_err(), refusal);
    let short = with(experiment("no_wind"), |config| config.simulator.duration = 0.02);
    let batch = fly_batch(&[short, config], Some(1), go_on, |_| ());
    assert_says(&batch.unwrap_err(), &["flight 1 of the batch", "first measurement", &why]);
}

proptest! {
    #![proptest_config(cases(24))]

    /// Whatever is wrong in the first measurement, as long as the flight begins with it.
    #[test]
    fn any_wrong_first_measurement_is_survived(
        joint in 0_usize..23,
        turn in prop::array::uniform3(-1.0..1.0_f64),
        what in 0..4,
        size in -1.2..1.2_f64,
        has_sensors in any::<bool>(),
    ) {
        let config = experiment(if has_sensors { "test2_sensors" } else { "test2_observer" });
        let stops = Loop::new(&config).plant.robot().joints[joint].stops;
        let axis = Unit::try_new(Vector3::from(turn), 1e-3).unwrap_or_else(Vector3::x_axis);
        let (rotation, position, _) = fly(&config, 1.5, |tick, state| {
            match what {
                _ if tick > 0 => (),
                0 => state.joint_position[joint] = (state.joint_position[joint] + size).clamp(stops.0, stops.1),
                1 => state.base.position += size * axis.into_inner(),
                2 => state.base.rotation = axis_angle(&axis, size) * state.base.rotation,
                _ => state.velocity.rows_mut(0, 3).axpy(4.0 * size, &axis.into_inner(), 1.0),
            }
        });
        prop_assert!(rotation < 15.0 && position < 0.2, "{rotation} deg, {position} m");
    }
}
