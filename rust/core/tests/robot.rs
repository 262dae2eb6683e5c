//! What makes no robot is refused by name and value.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use flight_core::robot::check::{inertia_of_moving_body, interval, moments, triangle, unit};
use nalgebra::{Matrix3, Vector3};

#[test]
fn limits_without_an_interval_are_refused() {
    assert_eq!(interval("limits", -1.0, 2.0).unwrap(), (-1.0, 2.0));
    for (lower, upper) in
        [(1.0, 1.0), (2.0, 1.0), (f64::NEG_INFINITY, 1.0), (0.0, f64::INFINITY), (f64::NAN, 1.0)]
    {
        let message = interval("limits", lower, upper).unwrap_err().to_string();
        assert!(message.starts_with(&format!("limits is {:?}; expected", [lower, upper])), "{message}");
    }
}

#[test]
fn directions_have_length_one() {
    assert_eq!(unit("axis", &[0.0, 0.6, -0.8]).unwrap().y, 0.6);
    for wrong in [[0.0, 0.6, 0.7], [f64::NAN, 0.0, 1.0]] {
        let message = unit("axis", &wrong).unwrap_err().to_string();
        assert!(message.starts_with(&format!("axis is {wrong:?}; expected")), "{message}");
    }
}

/// A plate (the greatest moment is the sum of the others), a rod, and no extent at all, or one of 0.1 nm, are limits of
/// what exists; only the plate resists rotation about every axis.
#[test]
fn inertias_are_those_of_masses() {
    let diagonal = |x, y, z| Matrix3::from_diagonal(&Vector3::new(x, y, z));
    for (matrix, is_possible, can_move) in [
        (diagonal(1.0, 2.0, 2.5), true, true),
        (diagonal(1.0, 2.0, 3.0), true, true),
        (diagonal(1.0, 1.0, 0.0), true, false),
        (Matrix3::zeros(), true, false),
        (diagonal(3e-20, 3e-20, 3e-20), true, false),
        (diagonal(1.0, 2.0, 3.001), false, false),
        (diagonal(1.0, -0.001, 1.0), false, false),
        (diagonal(1.0, f64::NAN, 1.0), false, false),
    ] {
        let possible = moments("body", &matrix).and_then(|moments| triangle("body", &moments));
        assert_eq!(possible.is_ok(), is_possible, "{matrix}");
        assert_eq!(inertia_of_moving_body("body", &matrix, 1.0).is_ok(), can_move, "{matrix}");
    }
}
