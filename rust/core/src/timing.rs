//! Lags, and times for which a limit has been exceeded.

/// Part of a difference that a first-order lag takes up in a time: `1 − e^−x`, where `x` is this time over the time constant.
/// Without a lag, where `x` is infinite, all of it.
#[must_use]
pub fn share(x: f64) -> f64 {
    -libm::expm1(-x)
}

/// For how long a limit has been exceeded, from tick to tick.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Exceeded {
    /// Sum of the times since the tick before each of its ticks \[s\]; zero while it is not exceeded.
    time: f64,
}

impl Exceeded {
    /// Takes in a tick `elapsed` \[s\] after the last one.
    pub fn update(&mut self, is_exceeded: bool, elapsed: f64) {
        self.time = if is_exceeded { self.time + elapsed } else { 0.0 };
    }

    /// Whether the limit has been exceeded in all ticks from one at least `confirmation` \[s\] ago to the last one, which was
    /// `elapsed` \[s\] after the one before: for 0.1 s, in eleven of 10 ms. Half a tick absorbs rounding.
    #[must_use]
    pub fn has_lasted(&self, confirmation: f64, elapsed: f64) -> bool {
        self.time > confirmation + 0.5 * elapsed
    }

    /// The sum \[s\].
    #[must_use]
    pub fn time(&self) -> f64 {
        self.time
    }
}

#[cfg(test)]
mod tests {
    use super::{Exceeded, share};

    #[test]
    fn a_lag_takes_up_its_share() {
        for (x, expected) in [(0.0, 0.0), (1.0, 1.0 - 1.0 / std::f64::consts::E), (f64::INFINITY, 1.0)] {
            assert!((share(x) - expected).abs() < 1e-15, "{x}");
        }
    }

    /// Whatever the rounding of the sum: eleven ticks are 0.1 s apart, one is zero; an interruption starts again.
    #[test]
    fn a_limit_is_exceeded_from_its_first_tick_on() {
        for (confirmation, step, expected) in
            [(0.1, 0.01, 11), (0.0, 0.01, 1), (0.3, 0.1, 4), (0.05, 0.002, 26)]
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
}
