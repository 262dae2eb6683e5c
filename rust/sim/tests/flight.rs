//! Whole flights: what the published flights must give, in which world, and what the simulator guarantees.
//!
//! "Published" flights use the printed coefficients and explicit Euler, as the numbers they are compared
//! with did. After thrusts and joints saturate a falling robot moves chaotically: there only the outcome
//! and a window for its time are claimed.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

#[path = "flight/estimators.rs"]
mod estimators;
#[path = "flight/landing.rs"]
mod landing;
#[path = "flight/laws.rs"]
mod laws;
#[path = "flight/network.rs"]
mod network;
#[path = "flight/outages.rs"]
mod outages;
#[path = "flight/published.rs"]
mod published;
#[path = "flight/simulator.rs"]
mod simulator;
#[path = "flight/start.rs"]
mod start;
#[path = "flight/stops.rs"]
mod stops;
#[path = "flight/wind.rs"]
mod wind;

use flight_io::AeroConfig;
use flight_sim::config::Integrator;
use flight_sim::{FlightResult, ScenarioConfig, WindConfig};

/// A flight with something changed.
fn with(mut config: ScenarioConfig, change: impl FnOnce(&mut ScenarioConfig)) -> ScenarioConfig {
    change(&mut config);
    config
}

/// An experiment of ours in the world that the published numbers come from: printed coefficients on both
/// sides, explicit Euler, no joint stops.
fn as_published(name: &str) -> ScenarioConfig {
    with(crate::common::experiment(name), |config| {
        config.simulator.integrator = Integrator::ExplicitEuler;
        config.simulator.joint_stops = false;
        let printed = crate::common::experiment("test2_published").simulator.aero;
        if config.controller.aero != (AeroConfig::Off {}) {
            config.controller.aero = printed.clone();
        }
        config.simulator.aero = printed;
    })
}

/// The published ramp to another wind.
fn ramp_to(velocity: [f64; 3]) -> WindConfig {
    WindConfig::Ramp { velocity, ramp_start: 5.0, ramp_end: 10.0 }
}

const STILL: WindConfig = WindConfig::Constant { velocity: [0.0; 3] };
const NO_AIR: AeroConfig = AeroConfig::Off {};

fn data<'a>(result: &'a FlightResult, name: &str) -> &'a [f64] {
    &result.log.series(name).unwrap_or_else(|| panic!("no series `{name}`")).data
}

/// Error of the CoM along an axis, the one of greatest size, after the start has settled.
fn com_offset(result: &FlightResult, axis: usize) -> f64 {
    let rows = data(result, "com_position").chunks(3).zip(data(result, "com_setpoint").chunks(3));
    let errors = rows.zip(data(result, "time")).filter(|(_, time)| **time >= 3.0);
    errors
        .map(|((com, desired), _)| com[axis] - desired[axis])
        .fold(0.0, |worst: f64, e| if e.abs() > worst.abs() { e } else { worst })
}

/// Rotation error at a time \[deg\].
fn rotation_error_at(result: &FlightResult, time: f64) -> f64 {
    data(result, "rotation_error")[crate::common::tick_at(time)].to_degrees()
}
