//! Lags, and times for which a limit has been exceeded.

use crate::common::assert_within;
use flight_core::timing::{Exceeded, share};

#[test]
fn a_lag_takes_up_its_share() {
    for (x, expected) in [(0.0, 0.0), (1.0, 1.0 - 1.0 / std::f64::consts::E), (f64::INFINITY, 1.0)] {
        assert_within!((share(x) - expected).abs(), 1e-15, "{x}");
    }
}

/// Whatever the rounding of the sum: eleven ticks are 0.1 s apart, one is zero; an interruption starts again.
#[test]
fn a_limit_is_exceeded_from_its_first_tick_on() {
    for (confirmation, step, expected) in [(0.1, 0.01, 11), (0.0, 0.01, 1), (0.3, 0.1, 4), (0.05, 0.002, 26)]
    {
        let mut exceeded = Exceeded::default();
        for _ in 0..2 {
            exceeded.update(false, step);
            let ticks = (1..100).find(|_| {
                exceeded.update(true, step);
                exceeded.has_lasted(confirmation, step)
            });
            assert_eq!(ticks, Some(expected), "{confirmation} s at {step} s");
        }
    }
}
