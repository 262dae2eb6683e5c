//! Where a robot comes down that has lost an engine, with the engines, sensors and drives of a robot.

use super::with;
use crate::common::experiment;
use flight_sim::disturbances::{FailureKind, JetFailure};
use flight_sim::{FlightResult, Outcome, Scenario};
use std::ops::ControlFlow;

/// When the engine stops: hovering in the wind, 5 m above the start \[s\].
const LOSS: f64 = 18.0;

/// A flight in which a jet stops at once; on the way down distances weigh what is shipped, or as much \[1/m²\].
fn fly_without(jet: &str, of_distances: Option<f64>) -> FlightResult {
    let config = with(experiment("robot"), |config| {
        config.simulator.duration = LOSS + 18.0;
        config.disturbances.jets.failure =
            Some(JetFailure { jet: jet.into(), time: LOSS, kind: FailureKind::Off, decay: 0.0 });
        let descent = config.controller.law.mpc.as_mut().unwrap().descent.as_mut().unwrap();
        descent.clearance = of_distances.or(descent.clearance);
    });
    Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap()
}

/// It lands without any one engine; where the exhausts keep as clear of the legs as in flight, not without one of an arm.
#[test]
fn a_robot_lands_without_an_engine() {
    for (jet, of_distances, outcome) in [
        ("chest_l_jet", None, Outcome::Landed),
        ("r_arm_jet", None, Outcome::Landed),
        ("r_arm_jet", Some(5000.0), Outcome::Crashed),
    ] {
        let flight = fly_without(jet, of_distances);
        assert_eq!(flight.outcome, outcome, "{jet}, {of_distances:?}: {:?}", flight.loss);
    }
}
