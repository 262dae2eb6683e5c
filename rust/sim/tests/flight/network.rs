//! Flights with the network: TEST3, TEST4 and the robustness test, with right and with published arms.
//!
//! The network is ours, not the paper's, so outcomes are claimed, and how large things are; not digits.

use super::{data, with};
use crate::common::{experiment, fly};
use flight_core::aero::Precision;
use flight_io::AeroConfig;
use flight_sim::{FlightResult, ScenarioConfig};

fn flights<const N: usize>(names: [&str; N]) -> [FlightResult; N] {
    fly(&names.map(experiment)).try_into().unwrap_or_else(|_| panic!("{N} flights"))
}

#[track_caller]
fn assert_completed(result: &FlightResult) {
    assert!(result.loss.is_none(), "{:?}", result.loss);
    assert_eq!(result.summary.ticks_without_solution, 0.0);
}

fn rotation_error_deg(result: &FlightResult) -> f64 {
    result.summary.max_rotation_error.to_degrees()
}

/// TEST3: without aerodynamics in the controller the robot turns over with the published arms, whatever the last bits.
/// With corrected arms it leans so far that they decide the end: of 20 flights that differ in them 20 or, with other
/// vector instructions, 19 complete.
#[test]
fn test3_falls_with_published_arms() {
    let [published] = flights(["test3_published"]);
    let fall = published.loss.unwrap_or_else(|| panic!("it flew on"));
    assert!((12.0..=40.0).contains(&fall.time), "fell at {} s: {}", fall.time, fall.reason);
    for result in fly_completed("test3", 8, 4) {
        assert!(rotation_error_deg(&result) > 15.0, "{}", rotation_error_deg(&result));
    }
}

/// Flights of an experiment whose first thrust differs in its last bits, those that complete: at least so many.
fn fly_completed(name: &str, flights: u32, least: usize) -> Vec<FlightResult> {
    let config = experiment(name);
    let nudged: Vec<_> = (0..flights)
        .map(|bits| {
            with(config.clone(), |config| {
                config.simulator.initial.thrust[0] *= 1.0 + f64::from(bits) * f64::EPSILON;
            })
        })
        .collect();
    let completed: Vec<_> = fly(&nudged).into_iter().filter(|result| result.loss.is_none()).collect();
    assert!(completed.len() >= least, "{name}: {} of {flights} complete", completed.len());
    completed.iter().for_each(assert_completed);
    completed
}

/// TEST4: with the same network in the controller it flies, with either kind of arms. The controller's
/// forces are the simulator's to the last bit: what the published code feeds back by a wire.
#[test]
fn test4_flies() {
    for result in flights(["test4", "test4_published"]) {
        assert_completed(&result);
        assert!(rotation_error_deg(&result) < 6.0, "{}", rotation_error_deg(&result));
        assert!(result.summary.max_com_error < 0.03, "{}", result.summary.max_com_error);
        assert_eq!(data(&result, "aero_force_sim"), data(&result, "aero_force_control"));
        // In full side wind and at full speed: of the size of the axisymmetric model's, 21 N.
        let force = result.summary.max_aero_force;
        assert!((15.0..=30.0).contains(&force), "{force} N");
    }
}

/// Robustness: a controller with the axisymmetric model completes more often than not, and the models differ. It leans
/// so far that last bits decide the end: of 20 flights that differ in them 19 complete, and 15 with published arms.
#[test]
fn the_axisymmetric_model_is_good_enough_to_complete() {
    for name in ["robustness", "robustness_published"] {
        for result in fly_completed(name, 12, 4) {
            let difference = result.summary.max_aero_force_difference;
            assert!((1.0..=12.0).contains(&difference), "{difference} N");
        }
    }
}

/// Single precision is enough: thrusts differ by less than a newton over the whole flight.
#[test]
fn precision_does_not_matter() {
    let double = |config: &mut ScenarioConfig| {
        for aero in [&mut config.simulator.aero, &mut config.controller.aero] {
            let AeroConfig::Network(network) = aero else { panic!("no network") };
            network.precision = Precision::F64;
        }
    };
    let [single, double] = &fly(&[experiment("test4"), with(experiment("test4"), double)])[..] else {
        panic!()
    };
    let pairs = data(single, "thrust").iter().zip(data(double, "thrust"));
    let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1.0, "{worst} N");
    assert!(worst > 0.0);
}
