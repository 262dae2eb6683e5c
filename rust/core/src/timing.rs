//! Lags, and times for which a limit has been exceeded.

/// Part of a difference that a first-order lag takes up in a time: `1 − e^−x`, where `x` is this time over the time constant.
/// Without a lag, where `x` is infinite, all of it.
#[must_use]
pub fn share(x: f64) -> f64 {
    -libm::expm1(-x)
}

/// Share of a tick that absorbs rounding. With half of one it would decide again where a limit is an odd number of half ticks,
/// as 0.15 s in ticks of 20 ms.
pub const ROUNDING: f64 = 0.1;

/// Whether a sum of times of ticks is more than a limit \[s\].
#[must_use]
pub fn is_longer(time: f64, limit: f64, time_step: f64) -> bool {
    time > limit + ROUNDING * time_step
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
    /// `elapsed` \[s\] after the one before: for 0.1 s, in eleven of 10 ms. Half a tick absorbs rounding. Where `confirmation`
    /// is an odd number of half ticks, as 0.02 s of a momentum that is measured every 0.04 s, rounding decides between two.
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
