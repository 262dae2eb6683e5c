//! The problem scaled to a Hessian diagonal of order one.

use super::{QpProblem, QpStatus};
use crate::linalg;

/// Hessian `s_i H_ij s_j`, linear term and bounds in `y_i = x_i / s_i` with `s_i ≈ 1/√H_ii` (Jacobi scaling), so
/// that thrust rates and joint velocities have similar scale. `s` is a power of two, so the scaling is free of
/// rounding.
#[derive(Debug, Clone)]
pub(super) struct Scaled {
    pub s: Vec<f64>,
    pub inverse_s: Vec<f64>,
    /// Column-major, with columns of `ld` entries.
    pub h: Vec<f64>,
    ld: usize,
    pub g: Vec<f64>,
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
}

impl Scaled {
    /// Allocates for `n` variables and a Hessian of leading dimension `ld`.
    pub(crate) fn new(n: usize, ld: usize) -> Self {
        let zeros = || vec![0.0; n];
        Self {
            s: zeros(),
            inverse_s: zeros(),
            h: vec![0.0; n * ld],
            ld,
            g: zeros(),
            lower: zeros(),
            upper: zeros(),
        }
    }

    /// Scales `qp`; fails if a diagonal entry is not positive.
    pub(crate) fn load(&mut self, qp: &QpProblem) -> Result<(), QpStatus> {
        let n = self.g.len();
        let (h, g) = (qp.h.as_slice(), qp.g.as_slice());
        for (j, (s, inverse_s)) in self.s.iter_mut().zip(&mut self.inverse_s).enumerate() {
            let diagonal = h[j + j * n];
            if !diagonal.is_finite() {
                return Err(QpStatus::NonFinite);
            }
            if diagonal <= 0.0 {
                return Err(QpStatus::NotPositiveDefinite);
            }
            (*s, *inverse_s) = inverse_root_power_of_two(diagonal);
        }
        for (j, &s_j) in self.s.iter().enumerate() {
            self.g[j] = g[j] * s_j;
            self.lower[j] = qp.lower[j] * self.inverse_s[j];
            self.upper[j] = qp.upper[j] * self.inverse_s[j];
        }
        linalg::scale_symmetric(h, n, &self.s, &mut self.h, self.ld);
        Ok(())
    }

    /// Column `j` of the Hessian.
    pub(crate) fn column(&self, j: usize) -> &[f64] {
        &self.h[j * self.ld..][..self.g.len()]
    }

    /// Adds the scaled Hessian times `y` to `product`.
    pub(crate) fn add_hessian_times(&self, y: &[f64], product: &mut [f64]) {
        linalg::add_mat_vec(product, &self.h, self.ld, y);
    }

    /// Converts `y` to `x` in the units of the problem, clamped to its bounds.
    pub(crate) fn unscale(&self, qp: &QpProblem, y: &[f64], x: &mut [f64]) {
        for ((x, y), s) in x.iter_mut().zip(y).zip(&self.s) {
            *x = y * s;
        }
        qp.clamp(x);
    }
}

/// `2^-⌊e/2⌋` and its reciprocal for a positive `value` with binary exponent e, so that `value · s²` is in
/// `[1, 4)`.
fn inverse_root_power_of_two(value: f64) -> (f64, f64) {
    const BIAS: u64 = 1023;
    const MANTISSA_BITS: u32 = 52;
    // The exponent is stored as e + 1023, so this is ⌊e/2⌋ + 512.
    let half = (value.to_bits() >> MANTISSA_BITS).div_ceil(2);
    let power = |biased: u64| f64::from_bits(biased << MANTISSA_BITS);
    (power(BIAS + 512 - half), power(BIAS + half - 512))
}
