//! Precision of the network. `tests/golden` has the flights with one, TEST3, TEST4 and the robustness test.

use super::{data, with};
use crate::common::{experiment, fly};
use flight_core::aero::Precision;
use flight_io::AeroConfig;
use flight_sim::ScenarioConfig;

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
