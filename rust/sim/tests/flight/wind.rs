//! Wind profiles: their values, their joints, and what is refused.

use crate::common::assert_within;
use flight_sim::{Scenario, Wind, WindConfig};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use tempfile::tempdir;

fn wind(config: &WindConfig) -> Wind {
    Wind::new(config).unwrap()
}

#[track_caller]
fn assert_blows(wind: &Wind, time: f64, expected: [f64; 3]) {
    let found = wind.velocity(time);
    assert_within!((found - Vector3::from(expected)).amax(), 1e-14, "at {time} s: {found}");
}

/// The published profile: still until 5 s, linear until 10 s, constant from then on.
#[test]
fn ramp_rises_linearly() {
    let wind = wind(&super::ramp_to([0.0, -10.0, 4.0]));
    for (time, factor) in [(0.0, 0.0), (5.0, 0.0), (6.0, 0.2), (7.5, 0.5), (10.0, 1.0), (50.0, 1.0)] {
        assert_blows(&wind, time, [0.0, -10.0 * factor, 4.0 * factor]);
    }
}

/// A ramp of no length is a step, taken at its time.
#[test]
fn ramp_of_no_length_is_a_step() {
    let wind = wind(&WindConfig::Ramp { velocity: [1.0, 0.0, 0.0], ramp_start: 3.0, ramp_end: 3.0 });
    assert_blows(&wind, 3.0 - 1e-12, [0.0; 3]);
    assert_blows(&wind, 3.0, [1.0, 0.0, 0.0]);
}

/// A gust adds all of itself at half time, nothing outside, and joins without a kink.
#[test]
fn gust_is_one_minus_cosine() {
    let wind = wind(&WindConfig::Gust {
        velocity: [1.0, 0.0, 0.0],
        gust: [0.0, -8.0, 2.0],
        start: 4.0,
        duration: 6.0,
    });
    for (time, strength) in
        [(0.0, 0.0), (4.0, 0.0), (5.5, 0.5), (7.0, 1.0), (8.5, 0.5), (10.0, 0.0), (20.0, 0.0)]
    {
        assert_blows(&wind, time, [1.0, -8.0 * strength, 2.0 * strength]);
    }
    for join in [4.0, 10.0] {
        let slope = (wind.velocity(join + 1e-6) - wind.velocity(join - 1e-6)) / 2e-6;
        assert_within!(slope.amax(), 1e-4, "slope {slope} at {join} s");
    }
    let strongest = (0..=6000).map(|k| -wind.velocity(4.0 + f64::from(k) * 1e-3).y).fold(f64::MIN, f64::max);
    assert_within!((strongest - 8.0).abs(), 1e-12);
}

fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

/// A recorded wind is linear between its samples and constant outside; blanks and empty lines are nothing.
#[test]
fn recorded_wind_is_interpolated() {
    let folder = tempdir().unwrap();
    let path = file(folder.path(), "good.csv", "time, x, y, z\n0,1,2,3\n\n 2.0, 3, 2 ,-1\r\n10,3,2,-1\n");
    let wind = wind(&WindConfig::File { path });
    for (time, velocity) in [
        (-5.0, [1.0, 2.0, 3.0]),
        (0.0, [1.0, 2.0, 3.0]),
        (0.5, [1.5, 2.0, 2.0]),
        (2.0, [3.0, 2.0, -1.0]),
        (7.0, [3.0, 2.0, -1.0]),
        (99.0, [3.0, 2.0, -1.0]),
    ] {
        assert_blows(&wind, time, velocity);
    }
    let path = file(folder.path(), "single.csv", "time,x,y,z\n3,1,2,3\n");
    let single = Wind::new(&WindConfig::File { path }).unwrap();
    assert_blows(&single, 0.0, [1.0, 2.0, 3.0]);
    assert_blows(&single, 9.0, [1.0, 2.0, 3.0]);
}

/// Samples of the configuration blow as those of a file; what is no recording is refused.
#[test]
fn samples_blow_as_a_file_does() {
    let samples = |samples: &[[f64; 4]]| Wind::new(&WindConfig::Samples { samples: samples.to_vec() });
    let wind = samples(&[[0.0, 1.0, 2.0, 3.0], [2.0, 3.0, 2.0, -1.0]]).unwrap();
    for (time, velocity) in [(-5.0, [1.0, 2.0, 3.0]), (0.5, [1.5, 2.0, 2.0]), (9.0, [3.0, 2.0, -1.0])] {
        assert_blows(&wind, time, velocity);
    }
    for (bad, word) in [
        (&[][..], "at least one sample"),
        (&[[0.0, f64::NAN, 0.0, 0.0]], "[0][1]` is not finite; expected a finite number"),
        (&[[1.0, 0.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.0]], "[1.0, 2.0, 0.0, 0.0]; expected a time later"),
    ] {
        let message = samples(bad).unwrap_err().to_string();
        assert!(message.contains("wind.samples") && message.contains(word), "{message}");
    }
}

/// A wind file that cannot be read as one is refused, with the line and what stands there.
#[test]
fn bad_wind_files_are_refused_with_their_line() {
    let folder = tempdir().unwrap();
    for (name, text, words) in [
        ("empty.csv", "", ["line 1", "empty"]),
        ("header.csv", "t,x,y,z\n0,1,2,3\n", ["line 1", "t,x,y,z"]),
        ("order.csv", "time,y,x,z\n0,0,-1,0\n", ["line 1", "time,y,x,z"]),
        ("no_header.csv", "0,1,2,3\n", ["line 1", "the header time,x,y,z"]),
        ("no_samples.csv", "time,x,y,z\n", ["no_samples.csv", "at least one sample"]),
        ("short.csv", "time,x,y,z\n0,1,2,3\n1,2,3\n", ["cells in line 3", "is 3"]),
        ("long.csv", "time,x,y,z\n0,1,2,3,4\n", ["line 2", "is 5"]),
        ("trailing.csv", "time,x,y,z\n0,1,2,3,gusty\n", ["line 2", "is 5"]),
        ("comma.csv", "time,x,y,z\n0,1,2,3,\n", ["line 2", "is 5"]),
        ("word.csv", "time,x,y,z\n0,1,strong,3\n", ["line 2", "strong"]),
        ("nan.csv", "time,x,y,z\n0,1,NaN,3\n", ["column y in line 2", "a finite number"]),
        ("inf.csv", "time,x,y,z\n0,1,inf,3\n", ["column y in line 2", "a finite number"]),
        ("mark.csv", "time,x,y,z\n0,1,2,3\n1,1,99.0,3\n", ["line 3", "below 99 m/s"]),
        ("late.csv", "time,x,y,z\n1,0,0,0\n0,0,0,0\n", ["line 3", "later than the one before"]),
        ("twice.csv", "time,x,y,z\n1,0,0,0\n\n1,0,0,0\n", ["line 4", "later than the one before"]),
    ] {
        let path = file(folder.path(), name, text);
        let message = Wind::new(&WindConfig::File { path }).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
        for word in words {
            assert!(message.contains(word), "{name}: `{message}` does not say `{word}`");
        }
    }
    let absent = Wind::new(&WindConfig::File { path: "nowhere/absent.csv".into() }).unwrap_err().to_string();
    assert!(absent.contains("cannot read nowhere/absent.csv"), "{absent}");
}

/// The wind that the controller is given is named where it stands.
#[test]
fn the_wind_of_the_controller_has_its_own_name() {
    let mut config = crate::common::experiment("test2");
    let backwards = WindConfig::Ramp { velocity: [1.0; 3], ramp_start: 5.0, ramp_end: 4.0 };
    config.disturbances.controller_wind = Some(backwards);
    let message = Scenario::new(&config).unwrap_err().to_string();
    assert!(message.starts_with("disturbances.controller_wind.ramp_end is 4"), "{message}");
    config.disturbances.controller_wind = Some(WindConfig::Samples { samples: vec![] });
    let message = Scenario::new(&config).unwrap_err().to_string();
    assert!(message.starts_with("disturbances.controller_wind.samples is empty"), "{message}");
}
