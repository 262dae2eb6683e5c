//! Bounds of the momentum QP that keep thrusts and joints inside their own limits.

use crate::exponential::tanh_f64;

/// Bounds on the rate of a value that has limits itself.
///
/// ```text
/// −r tanh(ε (x − x_min)) ≤ ẋ ≤ r tanh(ε (x_max − x))
/// ```
///
/// Far from the limits this is ±r; at a limit the rate towards it must vanish; beyond a limit the
/// bound changes sign and demands a way back. `lower ≤ upper` holds for every x, since
/// `tanh a + tanh b` has the sign of `a + b = ε (x_max − x_min) ≥ 0`.
///
/// Equation M65 of `docs/model.md` (paper: "bounds on the input and its integral").
#[must_use]
pub fn rate_bounds(value: f64, limits: (f64, f64), rate_max: f64, steepness: f64) -> (f64, f64) {
    let (lower, upper) = limits;
    (-rate_max * tanh_f64(steepness * (value - lower)), rate_max * tanh_f64(steepness * (upper - value)))
}
