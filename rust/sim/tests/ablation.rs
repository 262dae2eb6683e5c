//! Parts of the aerodynamic information are left out exactly as the configuration says, and a
//! configuration that leaves nothing out flies as one that does not mention it.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "the same computation gives the same bits")]

use crate::common::{Running, assert_within, at, experiment, fly};
use flight_core::Measurement;
use flight_core::control::law::momentum::RateFeedback;
use flight_io::load_robot;
use flight_sim::ScenarioConfig;
use flight_sim::disturbances::ModelError;
use flight_sim::disturbances::WindEstimateConfig;
use nalgebra::{Vector3, Vector6};
use std::collections::BTreeMap;

/// TEST2 where the wind has risen, cut short.
fn short(name: &str) -> ScenarioConfig {
    let mut config = experiment(name);
    config.simulator.duration = 12.0;
    config
}

fn with(change: impl Fn(&mut ScenarioConfig)) -> ScenarioConfig {
    let mut config = short("test2");
    change(&mut config);
    config
}

/// A controller behind its first tick in a wind askew to every link.
fn first_tick(config: &ScenarioConfig) -> Running {
    let robot = load_robot(&config.robot).unwrap();
    let mut controller = Running::new(config.controller(robot).unwrap());
    let state = config.simulator.initial.state();
    let wind = Vector3::new(-4.0, -9.0, 1.5);
    controller.tick(&Measurement { wind, ..at(0.0, &state, &config.simulator.initial.thrust) });
    controller
}

fn rate(config: &ScenarioConfig) -> Vector6<f64> {
    first_tick(config).terms().momentum.rate_estimate
}

#[test]
fn settings_that_change_nothing_leave_every_bit_of_a_flight() {
    let spoken = with(|config| {
        config.disturbances.wind_estimate = Some(WindEstimateConfig::default());
        config.disturbances.model_error = ModelError::default();
        config.disturbances.aero_estimate.links = BTreeMap::from([("head".to_owned(), 1.0)]);
        config.disturbances.jets.lag = 0.0;
    });
    let mut plain = short("test2");
    // A table with one factor of one takes the long way; the others must be exact.
    plain.disturbances.aero_estimate.links = spoken.disturbances.aero_estimate.links.clone();
    let results = fly(&[plain, spoken]);
    assert_eq!(results[0].log, results[1].log);
}

#[test]
fn a_configuration_is_written_out_with_every_default_and_without_absent_options() {
    let text = serde_json::to_string(&experiment("test2")).unwrap();
    for key in ["disturbances", "aero_estimate", "backend", "joint_stops"] {
        assert!(text.contains(&format!("\"{key}\"")), "{key}");
    }
    assert!(!text.contains("null"), "{text}");
}

#[test]
fn force_and_moment_together_are_the_whole_wrench() {
    let with_part = |part| rate(&with(|config| config.controller.law.aero_feedback.momentum_rate = part));
    let none = with_part(RateFeedback::None);
    let whole = rate(&with(|_| {})) - none;
    let force = with_part(RateFeedback::Force) - none;
    let moment = with_part(RateFeedback::Moment) - none;
    assert!(whole.fixed_rows::<3>(0).norm() > 10.0 && whole.fixed_rows::<3>(3).norm() > 0.1);
    assert_within!((force + moment - whole).norm(), 1e-12);
    assert_within!(force.fixed_rows::<3>(3).norm(), 1e-12);
    assert_within!(moment.fixed_rows::<3>(0).norm(), 1e-12);
}

#[test]
fn a_link_can_be_left_out() {
    let whole = first_tick(&with(|_| {}));
    let without = with(|config| {
        config.disturbances.aero_estimate.links = BTreeMap::from([("chest".to_owned(), 0.0)]);
    });
    let without = first_tick(&without);
    let names = &whole.model().aero_links;
    for (index, link) in names.iter().enumerate() {
        let (before, after) =
            (whole.terms().link_forces.forces_i[index], without.terms().link_forces.forces_i[index]);
        let expected = if link.name == "chest" { Vector3::zeros() } else { before };
        assert_within!((after - expected).norm(), 1e-13, "{}", link.name);
    }
}

#[test]
fn the_simulator_has_the_same_factors() {
    let doubled = with(|config| {
        config.disturbances.aero.drag = 2.0;
        config.disturbances.aero.normal = 2.0;
    });
    let results = fly(&[short("test2"), doubled]);
    let force = |flight: usize, tick: usize| {
        let series = results[flight].log.series("aero_force_sim").unwrap();
        Vector3::from_column_slice(&series.row(tick)[..3])
    };
    // The first tick, where both robots have fallen for one step alike.
    assert!(force(0, 0).norm() > 0.0);
    assert_within!((force(1, 0) - 2.0 * force(0, 0)).norm(), 1e-12 * force(0, 0).norm());
    assert!(results[1].summary.max_aero_force > 1.8 * results[0].summary.max_aero_force);
}

#[test]
fn what_cannot_be_left_out_is_refused_by_name() {
    let message = |change: &dyn Fn(&mut ScenarioConfig)| {
        let config = with(change);
        let robot = load_robot(&config.robot).unwrap();
        flight_sim::Scenario::with_robot(&config, robot).unwrap_err().to_string()
    };
    let unknown = message(&|config| {
        config.disturbances.aero_estimate.links = BTreeMap::from([("tail".to_owned(), 0.0)]);
    });
    assert!(unknown.contains("disturbances.aero_estimate.links") && unknown.contains("`tail`"), "{unknown}");
    assert!(unknown.contains("l_lower_leg"), "{unknown}");
    let nan = message(&|config| config.disturbances.aero_estimate.drag = f64::NAN);
    assert!(nan.contains("disturbances.aero_estimate.drag is NaN"), "{nan}");
    let tail = message(&|config| {
        config.disturbances.aero_estimate.normal_of = BTreeMap::from([("tail".to_owned(), 0.0)]);
    });
    assert!(tail.contains("disturbances.aero_estimate.normal_of") && tail.contains("`tail`"), "{tail}");
    let plant = message(&|config| config.disturbances.aero.normal = f64::INFINITY);
    assert!(plant.contains("disturbances.aero.normal is inf"), "{plant}");
}
