//! The floating-point environment of the calling thread: results are those of IEEE 754 in its default modes only.

use std::hint::black_box;

/// What differs from rounding to nearest with gradual underflow; `None` if nothing does.
///
/// Traps cannot be seen from here; a controller raises only the inexact and underflow exceptions for finite numbers.
#[must_use]
#[allow(clippy::float_cmp, reason = "rounding itself is looked at")]
pub(crate) fn unusual_mode() -> Option<&'static str> {
    const QUARTER: f64 = f64::EPSILON / 4.0;
    let (one, quarter, least) = (black_box(1.0_f64), black_box(QUARTER), black_box(f64::MIN_POSITIVE));
    let is_nearest = one + quarter == one && -one - quarter == -one && one + 3.0 * quarter > one;
    let underflows = black_box(least * 0.5) > 0.0;
    match (is_nearest, underflows) {
        (false, _) => Some("another rounding mode than to nearest"),
        (true, false) => Some("subnormal numbers flushed to zero"),
        (true, true) => None,
    }
}
