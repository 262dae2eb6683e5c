//! Lags, and times for which a limit has been exceeded.

use crate::common::assert_within;
use flight_core::timing::{Exceeded, is_longer, share};

#[test]
fn a_lag_takes_up_its_share() {
    for (x, expected) in [(0.0, 0.0), (1.0, 1.0 - 1.0 / std::f64::consts::E), (f64::INFINITY, 1.0)] {
        assert_within!((share(x) - expected).abs(), 1e-15, "{x}");
    }
}

/// A sum of ticks that is a limit up to rounding is not longer.
#[test]
fn a_limit_is_passed_after_its_last_tick() {
    for (limit, step, within) in
        [(0.15, 0.01, 15), (0.15, 0.02, 7), (0.15, 0.05, 3), (0.15, 0.002, 75), (3.0, 0.01, 300)]
    {
        let mut time = 0.0;
        let ticks = (0..1000).take_while(|_| {
            time += step;
            !is_longer(time, limit, step)
        });
        assert_eq!(ticks.count(), within, "{limit} s at {step} s");
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
