//! Where a robot comes down that has lost an engine, with the engines, sensors and drives of a robot.

use super::with;
use crate::common::experiment;
use flight_sim::disturbances::{FailureKind, JetFailure};
use flight_sim::{FlightResult, Outcome, Scenario};
use std::ops::ControlFlow;

/// When the engine stops: hovering in the wind, 5 m above the start, and at 7.5 m/s \[s\].
const HOVERING: f64 = 18.0;
const FAST: f64 = 28.0;

/// Hovering 1 m above the start \[s\].
const LOW: f64 = 14.0;

/// A flight in which a jet stops at once; without the nonlinear plan, distances weigh as much on the way down \[1/m²\].
fn fly_without(jet: &str, time: f64, of_distances: Option<f64>) -> FlightResult {
    let config = with(experiment("robot"), |config| {
        config.simulator.duration = time + 18.0;
        config.disturbances.jets.failure =
            Some(JetFailure { jet: jet.into(), time, kind: FailureKind::Off, decay: 0.0 });
        if time == LOW {
            config.mission.commands.up = vec![(10.0, 11.34)];
        }
        let mpc = config.controller.law.mpc.as_mut().unwrap();
        if of_distances.is_some() {
            mpc.nonlinear_descent = false;
            mpc.descent.as_mut().unwrap().clearance = of_distances;
        }
    });
    Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap()
}

/// It lands without any one engine. The linear plan does not without one of an arm where the exhausts keep as clear of the
/// legs as in flight, nor where it is lost in fast flight.
#[test]
fn a_robot_lands_without_an_engine() {
    for (jet, time, of_distances, outcome) in [
        ("chest_l_jet", HOVERING, None, Outcome::Landed),
        ("r_arm_jet", HOVERING, None, Outcome::Landed),
        ("r_arm_jet", HOVERING, Some(5000.0), Outcome::Crashed),
        ("l_arm_jet", FAST, None, Outcome::Landed),
        ("l_arm_jet", FAST, Some(300.0), Outcome::Crashed),
    ] {
        let flight = fly_without(jet, time, of_distances);
        assert_eq!(flight.outcome, outcome, "{jet}, {time}, {of_distances:?}: {:?}", flight.loss);
    }
}

/// A plan that ends at the ground touches down upright: one that goes on below it leans by 23° there.
#[test]
fn a_low_robot_touches_down_upright() {
    let flight = fly_without("l_arm_jet", LOW, None);
    let quaternion = flight.log.series("base_quaternion").unwrap();
    let [_, x, y, _] = *quaternion.row(flight.log.len() - 1) else { panic!() };
    let lean = libm::acos(1.0 - 2.0 * (x * x + y * y)).to_degrees();
    assert_eq!(flight.outcome, Outcome::Landed, "{:?}", flight.loss);
    assert!(lean < 19.0, "{lean}");
}
