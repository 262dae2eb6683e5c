//! What makes no robot.

use flight_core::robot::check::{inertia_of_moving_body, moments, triangle};
use nalgebra::{Matrix3, Vector3};

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
