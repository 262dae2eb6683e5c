//! The wind from the wrench: where the model is the world's, the estimate goes to the wind, and says how sure it is.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{Loop, assert_within, experiment, fly};
use flight_core::WindObserver;
use flight_core::wind_observer::WindObserverConfig;
use flight_io::load_robot;
use flight_sim::{Outcome, ScenarioConfig};
use nalgebra::Vector3;

const STEP: f64 = 0.01;

fn flight(settings: WindObserverConfig) -> ScenarioConfig {
    let mut config = experiment("test2_observer");
    config.controller.wind_observer = Some(settings);
    config
}

fn observer(config: &ScenarioConfig) -> WindObserver {
    config.wind_observer(load_robot(&config.robot).unwrap()).unwrap().unwrap()
}

/// Hovers in a wind that blows from the first tick on, given to the controller; what the observer makes of it.
fn estimate(settings: WindObserverConfig, wind: Vector3<f64>, seconds: f64) -> WindObserver {
    let config = flight(settings);
    let (mut world, mut observer) = (Loop::new(&config), observer(&config));
    for _ in 0..flight_ticks(seconds) {
        world.observe(&wind);
        let time = world.tick as f64 * STEP;
        observer.update(world.controller.terms(), world.plant.jets().thrust(), time);
        world.advance(&wind);
    }
    observer
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few hundred")]
fn flight_ticks(seconds: f64) -> usize {
    (seconds / STEP).round() as usize
}

/// With the world's own model and vertical winds as uncertain as the others, every component is found.
#[test]
fn the_estimate_goes_to_the_wind() {
    let settings = WindObserverConfig {
        walk: 10.0,
        vertical_std: 10.0,
        vertical_time: 1e6,
        force_noise: [0.01; 3],
        ..WindObserverConfig::default()
    };
    for wind in [Vector3::new(6.0, -8.0, 1.0), Vector3::new(-9.0, 3.0, -0.5)] {
        let found = estimate(settings, wind, 5.0).wind();
        assert_within!((found - wind).norm(), 0.05, because "fifteen time constants of the observed force, and what a step adds to the momentum (M85)", "{found} of {wind}");
    }
}

/// Before anything is measured its uncertainty is that of the configuration; a measured force takes some of it away.
#[test]
fn it_says_how_sure_it_is() {
    let settings = WindObserverConfig::default();
    let first = observer(&flight(settings));
    assert_eq!(first.wind(), Vector3::zeros());
    assert_within!(
        (first.std() - Vector3::new(settings.walk, settings.walk, settings.vertical_std)).amax(),
        1e-12
    );
    let sure = estimate(settings, Vector3::new(0.0, -10.0, 0.0), 3.0).std();
    let unsure = WindObserverConfig { relative_std: 0.5, ..settings };
    let unsure = estimate(unsure, Vector3::new(0.0, -10.0, 0.0), 3.0).std();
    assert!(sure.y < unsure.y && sure.x < unsure.x, "{sure} {unsure}");
    assert!(sure.y < 1.0, "{sure}");
    assert!(sure.z <= settings.vertical_std, "{sure}");
}

/// A robot that is not given the wind arrives, and estimates it to 1.5 m/s when it has risen.
#[test]
fn a_robot_that_is_not_told_the_wind_flies() {
    let mut config = flight(WindObserverConfig::default());
    config.simulator.duration = 14.0;
    let result = fly(&[config]).remove(0);
    assert_eq!(result.outcome, Outcome::Completed);
    let row = |name: &str| Vector3::from_column_slice(result.log.series(name).unwrap().row(1400));
    let (measured, wind, std) = (row("measured_wind"), row("wind"), row("measured_wind_std"));
    assert!(wind.norm() > 6.0, "{wind}");
    assert!((measured - wind).norm() < 1.5, "{measured} of {wind}");
    assert!(std.iter().all(|std| (0.05..2.0).contains(std)), "{std}");
}

#[test]
fn bad_wind_observers_are_refused_by_name() {
    type Change = fn(&mut ScenarioConfig);
    let refusals: [(&str, Change); 7] = [
        ("controller.wind_observer.gain is 0", |c| c.controller.wind_observer.as_mut().unwrap().gain = 0.0),
        ("controller.wind_observer.gain is 101", |c| {
            c.controller.wind_observer.as_mut().unwrap().gain = 101.0;
        }),
        ("controller.wind_observer.walk is NaN", |c| {
            c.controller.wind_observer.as_mut().unwrap().walk = f64::NAN;
        }),
        ("controller.wind_observer.force_noise is -1", |c| {
            c.controller.wind_observer.as_mut().unwrap().force_noise[1] = -1.0;
        }),
        ("controller.wind_observer.moment_arm is 0", |c| {
            c.controller.wind_observer.as_mut().unwrap().moment_arm = 0.0;
        }),
        ("controller.wind_observer.relative_std is -1", |c| {
            c.controller.wind_observer.as_mut().unwrap().relative_std = -1.0;
        }),
        ("controller.aero.model is off", |c| c.controller.aero = flight_io::AeroConfig::Off {}),
    ];
    for (expected, change) in refusals {
        let mut config = flight(WindObserverConfig::default());
        change(&mut config);
        let text = config.wind_observer(load_robot(&config.robot).unwrap()).unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
    }
}
