//! A recorded reference named in a configuration is flown.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::{assert_within, difference};
use flight_io::MissionConfig;
use flight_sim::{Scenario, load_scenario};
use std::fmt::Write;
use std::ops::ControlFlow;
use tempfile::tempdir;

const EXPERIMENTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/experiments");

#[test]
fn the_controller_flies_a_file_named_beside_its_configuration() {
    let folder = tempdir().unwrap();
    // One metre up between 4 and 8 s, as a minimum-jerk motion; position and attitude alone.
    let mut text = "time,x,y,z,roll,pitch,yaw\n".to_owned();
    for sample in 0..=80 {
        let (t, s) = (4.0 + 0.05 * f64::from(sample), f64::from(sample) / 80.0);
        let rise = s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s);
        writeln!(text, "{t},-0.00365,0.00041,{},0,0,3.14159265358979", 0.751_881 + rise).unwrap();
    }
    std::fs::write(folder.path().join("rise.csv"), text).unwrap();
    let flight = format!(
        "base = \"{EXPERIMENTS}/no_wind.toml\"\nmission = {{ base = \"{EXPERIMENTS}/../mission/hover.toml\", \
         file = \"rise.csv\" }}\nsimulator = {{ duration = 10.0 }}\n"
    );
    std::fs::write(folder.path().join("flight.toml"), flight).unwrap();

    let mut config = load_scenario(&folder.path().join("flight.toml")).unwrap();
    let mission = MissionConfig { file: config.mission.file.take(), ..MissionConfig::default() };
    assert!(mission.file.as_ref().is_some_and(|file| file.is_absolute()));
    config.mission = mission;
    let result = Scenario::new(&config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap();
    assert!(result.loss.is_none());
    assert!(result.summary.max_com_error < 0.02, "{}", result.summary.max_com_error);
    let height = result.log.series("com_position").unwrap().row(1000)[2];
    assert_within!(difference(height, 1.751_881), 5e-3, because "a curve through samples is compared with the motion it was sampled from");
}
