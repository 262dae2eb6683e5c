//! What the state estimator and the wind observer make of a whole flight.

use crate::common::{assert_within, experiment, fly, outage, uniform_estimator};
use flight_core::control::Modes;
use flight_core::control::estimate::estimator::{EstimatorConfig, FilterConfig};
use flight_sim::disturbances::{Outage, OutageChannel, OutageKind};
use flight_sim::sensors::{EncoderConfig, SensorConfig, ThrustSensorConfig};
use flight_sim::{Outcome, SensorsConfig};
use nalgebra::Vector3;

/// Twenty milliseconds on every signal: without the estimator the robot falls, with it it flies as if they were not there.
#[test]
fn a_late_robot_flies_with_an_estimator() {
    let sensor = || SensorConfig { delay: 0.02, ..SensorConfig::default() };
    let mut falling = experiment("test2_observer");
    falling.simulator.duration = 6.0;
    falling.simulator.sensors = Some(SensorsConfig {
        base_position: sensor(),
        base_rotation: sensor(),
        base_linear_velocity: sensor(),
        base_angular_velocity: sensor(),
        joints: EncoderConfig { delay: 0.02, ..EncoderConfig::default() },
        thrust: ThrustSensorConfig { delay: 0.02, ..ThrustSensorConfig::default() },
        ..SensorsConfig::default()
    });
    let mut flying = falling.clone();
    flying.controller.law.estimator =
        Some(uniform_estimator(FilterConfig { delay: 0.02, ..FilterConfig::default() }));
    let [falling, flying] = fly(&[falling, flying]).try_into().unwrap();
    assert_eq!(falling.outcome, Outcome::Fell);
    assert_eq!(flying.outcome, Outcome::Completed);
    assert!(flying.summary.max_rotation_error.to_degrees() < 3.0, "{}", flying.summary.max_rotation_error);
}

/// The wind is estimated from the thrusts that the controller uses: a sensor that is lost for good changes little.
#[test]
fn a_lost_thrust_sensor_is_no_wind() {
    let mut config = experiment("test2_observer");
    config.controller.law.wind_observer = true;
    config.simulator.duration = 14.0;
    let lost = outage(OutageChannel::Thrust, OutageKind::Missing, 8.0, None);
    config.disturbances.outages = vec![Outage { jet: Some("chest_l_jet".into()), ..lost }];
    let result = fly(&[config]).remove(0);
    let row = |name: &str| Vector3::from_column_slice(result.log.series(name).unwrap().row(1400));
    let error = (row("measured_wind") - row("wind")).norm();
    assert_within!(error, 1.5, because "as without the outage: the bound of the estimate");
}

/// A robot that is not given the wind completes its flight, and estimates it to 1.5 m/s when it has risen.
#[test]
fn a_robot_without_a_measured_wind_flies() {
    let mut config = experiment("test2_observer");
    config.controller.law.wind_observer = true;
    config.simulator.duration = 14.0;
    let result = fly(&[config]).remove(0);
    assert_eq!(result.outcome, Outcome::Completed);
    let row = |name: &str| Vector3::from_column_slice(result.log.series(name).unwrap().row(1400));
    let (measured, wind, std) = (row("measured_wind"), row("wind"), row("measured_wind_std"));
    assert!(wind.norm() > 6.0, "{wind}");
    assert!((measured - wind).norm() < 1.5, "{measured} of {wind}");
    assert!(std.iter().all(|std| (0.05..2.0).contains(std)), "{std}");
}

/// Outages are those of sensors: with an estimator between them and the controller a lost channel is the controller's to
/// predict, and no other one is lost with it.
#[test]
fn an_estimator_loses_nothing_else_with_a_channel() {
    let mut whole = experiment("test2_observer");
    whole.simulator.duration = 4.0;
    whole.controller.law.estimator = Some(EstimatorConfig::default());
    for (channel, mode) in [
        (OutageChannel::Wind, Modes::WIND_HELD),
        (OutageChannel::Thrust, Modes::THRUST_MODELLED),
        (OutageChannel::BasePosition, Modes::POSITION_PREDICTED),
        (OutageChannel::BaseVelocity, Modes::VELOCITY_PREDICTED),
    ] {
        let mut config = whole.clone();
        config.disturbances.outages = vec![outage(channel, OutageKind::Missing, 1.0, Some(0.5))];
        let result = fly(&[config]).remove(0);
        assert_eq!(result.outcome, Outcome::Completed, "{channel:?}");
        let modes = &result.log.series("degraded_modes").unwrap().data;
        for (tick, modes) in modes.iter().enumerate() {
            let expected = if (100..150).contains(&tick) { f64::from(mode.bits()) } else { 0.0 };
            assert_within!((modes - expected).abs(), 0.0, "{channel:?}, tick {tick}");
        }
    }
}

/// A value that is wrong by more than a jump, and one that is frozen, are not used with an estimator either: it does not follow
/// them.
#[test]
fn an_estimator_follows_no_measurement_that_is_not_accepted() {
    let late = || FilterConfig { delay: 0.02, time_constant: 0.05 };
    let mut whole = experiment("test2_observer");
    whole.simulator.duration = 4.0;
    let sensor = || SensorConfig { delay: 0.02, ..SensorConfig::default() };
    whole.simulator.sensors = Some(SensorsConfig {
        base_position: sensor(),
        base_rotation: sensor(),
        base_linear_velocity: sensor(),
        ..SensorsConfig::default()
    });
    whole.controller.law.estimator = Some(EstimatorConfig {
        base_position: late(),
        base_rotation: late(),
        base_linear_velocity: late(),
        ..EstimatorConfig::default()
    });
    for (channel, mode, error) in [
        (OutageChannel::BasePosition, Modes::POSITION_PREDICTED, 1.0),
        (OutageChannel::BaseRotation, Modes::ROTATION_PREDICTED, 1.0),
        (OutageChannel::BaseVelocity, Modes::VELOCITY_PREDICTED, 5.0),
    ] {
        let mut config = whole.clone();
        let wrong = outage(channel, OutageKind::Wrong, 1.0, Some(0.3));
        config.disturbances.outages = vec![Outage { error, ..wrong }];
        let result = fly(&[config]).remove(0);
        assert_eq!(result.outcome, Outcome::Completed, "{channel:?}");
        let modes = &result.log.series("degraded_modes").unwrap().data;
        for (tick, modes) in modes.iter().enumerate() {
            let expected = if (100..130).contains(&tick) { f64::from(mode.bits()) } else { 0.0 };
            assert_within!((modes - expected).abs(), 0.0, "{channel:?}, tick {tick}");
        }
        assert!(result.summary.max_rotation_error.to_degrees() < 3.0, "{channel:?}");
    }
}

/// With realistic sensors, too, a wrong thrust sensor is distinguished from a failing engine, and used no more by the
/// estimator. Compared with the deviation of this tick instead of one as late as the momentum, three of these are
/// engines and fell the robot.
#[test]
fn a_thrust_sensor_that_is_wrong_is_found_with_realistic_sensors() {
    let mut config = experiment("test2_sensors");
    config.simulator.duration = 22.0;
    for (jet, error) in
        [("l_arm_jet", 90.0), ("chest_r_jet", 90.0), ("chest_l_jet", -40.0), ("chest_r_jet", -90.0)]
    {
        let wrong = outage(OutageChannel::Thrust, OutageKind::Wrong, 18.0, None);
        config.disturbances.outages = vec![Outage { jet: Some(jet.into()), error, ..wrong }];
        let result = fly(&[config.clone()]).remove(0);
        assert_eq!(result.outcome, Outcome::Completed, "{jet}, {error} N");
        let modes = result.log.series("degraded_modes").unwrap().data.last().copied();
        assert_eq!(modes, Some(f64::from(Modes::THRUST_MODELLED.bits())), "{jet}, {error} N");
    }
}

/// A tenth of a second without any joint measurement, with realistic sensors, in wind: the model of the estimator goes on.
/// Joints that are predicted from the last estimate instead lose all of these flights.
#[test]
fn without_its_joints_for_a_moment_a_robot_with_realistic_sensors_flies_on() {
    let mut config = experiment("test2_sensors");
    config.simulator.duration = 22.0;
    let flights = [1, 2, 3, 4].map(|seed| {
        let mut config = config.clone();
        config.simulator.sensors.as_mut().unwrap().seed = seed;
        config.disturbances.outages =
            vec![outage(OutageChannel::Joints, OutageKind::Missing, 20.0, Some(0.1))];
        config
    });
    for result in fly(&flights) {
        assert_eq!(result.outcome, Outcome::Completed);
    }
}
