//! Repeatable noise: a seed gives the same numbers in every run and for every number of threads.
//!
//! Equation M42 of `docs/model`.

use std::f64::consts::TAU;

/// Random number generator PCG-XSH-RR with 64 bits of state.
///
/// Source: M. E. O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically Good
/// Algorithms for Random Number Generation", 2014. Does not allocate.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    state: u64,
    increment: u64,
    spare: Option<f64>,
}

impl Noise {
    /// Stream number `stream` of a seed; the streams of a seed are independent of each other.
    #[must_use]
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut noise = Self { state: 0, increment: (stream << 1) | 1, spare: None };
        noise.next();
        noise.state = noise.state.wrapping_add(seed);
        noise.next();
        noise
    }

    fn next(&mut self) -> u32 {
        let old = self.state;
        self.state = old.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(self.increment);
        // The truncation is part of the algorithm: the middle bits, rotated by the top five.
        #[allow(clippy::cast_possible_truncation)]
        let (bits, turn) = ((((old >> 18) ^ old) >> 27) as u32, (old >> 59) as u32);
        bits.rotate_right(turn)
    }

    /// Uniform in (0, 1).
    pub fn uniform(&mut self) -> f64 {
        (f64::from(self.next()) + 0.5) / 4_294_967_296.0
    }

    /// Normally distributed with mean 0 and standard deviation 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        let (sin, cos) = libm::sincos(TAU * self.uniform());
        self.spare = Some(radius * sin);
        radius * cos
    }
}
