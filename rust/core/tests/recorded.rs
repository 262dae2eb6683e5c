//! A recorded reference, interpolated.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // tests stop at the first surprise

use crate::common::{assert_within, difference};
use flight_core::spatial::{rotation_from_rpy, rpy_from_rotation};
use flight_io::mission::{COLUMNS, parse_recording};
use nalgebra::Vector3;
use std::fmt::Write;

/// Position along a quintic and its derivatives: what a smooth recording holds.
fn quintic(t: f64) -> [f64; 4] {
    [
        t.powi(5) - 2.0 * t.powi(3) + t,
        5.0 * t.powi(4) - 6.0 * t.powi(2) + 1.0,
        20.0 * t.powi(3) - 12.0 * t,
        60.0 * t.powi(2) - 12.0,
    ]
}

/// A file of samples of the quintic along x, with `columns` columns, pitching as it goes.
fn recording(columns: usize, samples: usize) -> String {
    let mut text = format!("# made up\n{}\n", COLUMNS[..columns].join(","));
    for sample in 0..samples {
        let t = sample as f64 / (samples - 1) as f64;
        let [x, v, a, j] = quintic(t);
        let row = [t, x, 0.0, 1.0, 0.0, -0.3 * t, 3.0, v, 0.0, 0.0, a, 0.0, 0.0, j, 0.0, 0.0];
        let fields: Vec<String> = row[..columns].iter().map(ToString::to_string).collect();
        writeln!(text, "{}", fields.join(",")).unwrap();
    }
    text
}

#[test]
fn samples_come_back_as_they_were_written() {
    let recording = parse_recording(&recording(16, 11), "r.csv").unwrap();
    for sample in 0..=10 {
        let t = f64::from(sample) / 10.0;
        let motion = recording.at(t);
        for (order, expected) in quintic(t).into_iter().enumerate() {
            assert_within!(difference(motion.com[order].x, expected), 1e-12);
        }
        assert_within!(
            difference(rpy_from_rotation(&motion.rotation), Vector3::new(0.0, -0.3 * t, 3.0)),
            1e-12
        );
        assert_within!(difference(motion.angular_velocity_b, Vector3::new(0.0, -0.3, 0.0)), 1e-12);
    }
}

#[test]
fn between_samples_the_curve_is_smooth_and_close() {
    let full = parse_recording(&recording(16, 21), "r.csv").unwrap();
    for k in 0..=1000 {
        let t = f64::from(k) / 1000.0;
        let motion = full.at(t);
        for ((order, expected), tolerance) in quintic(t).into_iter().enumerate().zip([1e-5, 1e-5, 2e-4, 0.1])
        {
            assert_within!(difference(motion.com[order].x, expected), tolerance, because "a curve through samples is compared with the motion it was sampled from");
        }
        let error = motion.rotation.transpose() * rotation_from_rpy(&Vector3::new(0.0, -0.3 * t, 3.0));
        assert_within!(difference(error.trace(), 3.0), 1e-12);
    }
}

#[test]
fn derivatives_that_are_missing_are_differences() {
    let whole = parse_recording(&recording(16, 101), "r.csv").unwrap();
    for (columns, tolerance) in [(13, 0.02), (10, 0.02), (7, 0.05)] {
        let partial = parse_recording(&recording(columns, 101), "r.csv").unwrap();
        for k in 5..=95 {
            let t = f64::from(k) / 100.0;
            for order in 0..4 {
                let (found, expected) = (partial.at(t).com[order], whole.at(t).com[order]);
                assert_within!(difference(found, expected), tolerance, because "a curve through samples is compared with the motion it was sampled from");
            }
        }
    }
}

#[test]
fn outside_its_time_a_recording_stands_still_where_it_begins_or_ends() {
    let recording = parse_recording(&recording(16, 11), "r.csv").unwrap();
    for (time, end) in [(-1.0, 0.0), (-1e-9, 0.0), (1.0 + 1e-9, 1.0), (f64::MAX, 1.0)] {
        let motion = recording.at(time);
        assert_within!(difference(motion.com[0].x, quintic(end)[0]), 1e-12);
        assert_eq!([motion.com[1], motion.com[2], motion.com[3]], [Vector3::zeros(); 3]);
        assert_eq!(motion.angular_velocity_b, Vector3::zeros());
    }
}

#[test]
fn a_turn_through_180_degrees_of_yaw_is_a_small_turn() {
    let text = "time,x,y,z,roll,pitch,yaw\n0,0,0,1,0,0,3.1\n1,0,0,1,0,0,-3.1\n";
    let rate = parse_recording(text, "r.csv").unwrap().at(0.5).angular_velocity_b;
    assert_within!(difference(rate, Vector3::new(0.0, 0.0, std::f64::consts::TAU - 6.2)), 1e-12);
}

#[test]
fn rows_that_make_no_curve_are_refused() {
    let header = COLUMNS[..7].join(",");
    for (rows, expected) in [
        ("0,0,0,1,0,0,0\n0,0,0,1,0,0,0\n", "later than the one before"),
        ("0,0,0,1,0,0,0\n", "1 samples long; expected at least 2"),
        ("0,0,0,1,0,0,0\n1e-310,0,0,1,0,0,1\n", "jerks up to 1e6"),
        ("-1.7e308,0,0,1,0,0,0\n1.7e308,0,0,2,0,0,0\n", "by a finite number"),
        ("0,0,0,1e7,0,0,0\n1,0,0,1e7,0,0,0\n", "jerks up to 1e6"),
    ] {
        let message = parse_recording(&format!("{header}\n{rows}"), "r.csv").unwrap_err().to_string();
        assert!(message.contains(expected), "{message} does not say {expected}");
    }
}

/// Of a half turn between two rows the axis is rounding: refused, and the rows named.
#[test]
fn a_half_turn_between_rows_is_refused() {
    for (turn, is_refused) in [(178.5_f64, false), (179.5, true), (180.0, true)] {
        let mut text = format!("{}\n", COLUMNS[..7].join(","));
        for (time, yaw) in [(0.0, 0.0), (1.0, 0.0), (2.0, turn.to_radians())] {
            writeln!(text, "{time},0,0,1,0,0,{yaw}").unwrap();
        }
        let message = parse_recording(&text, "r.csv").err().map(|error| error.to_string());
        assert_eq!(message.is_some(), is_refused, "{message:?}");
        if let Some(message) = message {
            assert!(message.contains("r.csv") && message.contains("179 deg"), "{message}");
            assert!(message.contains(&format!("turned by {turn:.1} deg since")), "{message}");
        }
    }
}
