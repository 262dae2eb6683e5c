//! Exponential and hyperbolic tangent without branches or calls: loops over them vectorise, and every processor
//! computes the same bits.
//!
//! ```text
//! x = n ln 2 + r,   |r| ≤ ln 2 / 2,   eˣ = 2ⁿ (1 + r + … + rᵏ/k!)
//! ```
//!
//! The first omitted term is below rounding, and ln 2 is split so that subtracting `n ln 2` loses no digits. Arguments
//! are clamped to the range in which the exponential is a normal number; a NaN remains NaN.

/// 3/2 · 2²³: adding it rounds to an integer, which is then in the lowest bits.
const ROUND_F32: f32 = 1.5 / f32::EPSILON;
/// 3/2 · 2⁵².
const ROUND_F64: f64 = 1.5 / f64::EPSILON;

/// `eˣ` in single precision.
#[inline(always)]
pub(crate) fn exp_f32(x: f32) -> f32 {
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let x = if x > 87.0 { 87.0 } else { x };
    let x = if x < -87.0 { -87.0 } else { x };
    let shifted = x * std::f32::consts::LOG2_E + ROUND_F32;
    let n = shifted - ROUND_F32;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let mut sum = 1.0 / 5040.0;
    for coefficient in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        sum = sum * r + coefficient;
    }
    let exponent = shifted.to_bits().wrapping_sub(ROUND_F32.to_bits()).wrapping_add(127);
    sum * f32::from_bits(exponent << 23)
}

/// `eˣ` in double precision.
#[inline(always)]
pub(crate) fn exp_f64(x: f64) -> f64 {
    const LN_2_HIGH: f64 = 0.693_147_180_369_123_8;
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let x = if x > 708.0 { 708.0 } else { x };
    let x = if x < -708.0 { -708.0 } else { x };
    let shifted = x * std::f64::consts::LOG2_E + ROUND_F64;
    let n = shifted - ROUND_F64;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let mut sum = 1.0 / 6_227_020_800.0;
    for coefficient in [
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ] {
        sum = sum * r + coefficient;
    }
    let exponent = shifted.to_bits().wrapping_sub(ROUND_F64.to_bits()).wrapping_add(1023);
    sum * f64::from_bits(exponent << 52)
}

/// `tanh x`, exactly odd; its error is a few units in the last place of one.
#[inline(always)]
pub(crate) fn tanh_f64(x: f64) -> f64 {
    (1.0 - 2.0 / (1.0 + exp_f64(2.0 * x.abs()))).copysign(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two units in the last place, over all arguments that do not overflow. In double precision two more, for the
    /// library's own error of half a unit and for the reduction of `x`.
    #[test]
    fn the_exponential_is_that_of_the_library() {
        for step in -8700..=8700 {
            let x = step as f32 * 0.01;
            let (found, expected) = (f64::from(exp_f32(x)), f64::from(x).exp());
            assert!((found / expected - 1.0).abs() < 2.5e-7, "exp({x}) = {found}, expected {expected}");
        }
        for step in -7080..=7080 {
            let x = f64::from(step) * 0.1;
            let (found, expected) = (exp_f64(x), x.exp());
            assert!((found / expected - 1.0).abs() < 1e-15, "exp({x}) = {found}, expected {expected}");
        }
    }

    /// The exponential has a relative error of 1e-15, the quotient at most half of that, and its difference from one
    /// is rounded.
    #[test]
    fn the_hyperbolic_tangent_is_that_of_the_library() {
        for step in -4000..=4000 {
            let x = f64::from(step) * 0.01;
            assert!((tanh_f64(x) - x.tanh()).abs() < 1e-15, "tanh({x}) = {}", tanh_f64(x));
            assert_eq!(tanh_f64(-x).to_bits(), (-tanh_f64(x)).to_bits());
        }
    }

    #[test]
    fn they_are_total() {
        assert_eq!((tanh_f64(-1e300), tanh_f64(0.0), tanh_f64(f64::INFINITY)), (-1.0, 0.0, 1.0));
        assert!(tanh_f64(f64::NAN).is_nan());
        assert_eq!((exp_f32(-1e30), exp_f64(-1e300)), (exp_f32(-87.0), exp_f64(-708.0)));
        assert!(exp_f32(1e30).is_finite() && exp_f64(1e300).is_finite());
        assert!(exp_f32(f32::NAN).is_nan() && exp_f64(f64::NAN).is_nan());
    }
}
