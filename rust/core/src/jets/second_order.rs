//! The identified second-order jet engine.
//!
//! Equations M32 and M34 of `docs/model`.

use crate::error::{BuildError, check};
use crate::schema;
use serde::{Deserialize, Serialize};

/// Input gain below which the throttle does not control the thrust and the loop holds it \[N/s² per %\].
const MIN_INPUT_GAIN: f64 = 1e-9;

/// Second-order model of an engine with thrust `T` \[N\] and throttle `u` in percent.
///
/// ```text
/// T̈ = k_t T + k_tt T² + k_d Ṫ + k_dd Ṫ² + k_td T Ṫ + c + (b_u + b_t T + b_d Ṫ)(u + b_uu u²)
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EngineCoefficients {
    /// Stiffness \[1/s²\].
    pub k_t: f64,
    /// Quadratic stiffness \[1/(N s²)\].
    pub k_tt: f64,
    /// Damping \[1/s\].
    pub k_d: f64,
    /// Quadratic damping \[1/N\].
    pub k_dd: f64,
    /// Damping proportional to thrust \[1/(N s)\].
    pub k_td: f64,
    /// Gain of the throttle \[N/s² per percent\].
    pub b_u: f64,
    /// Gain proportional to thrust \[1/s² per percent\].
    pub b_t: f64,
    /// Gain proportional to the thrust rate \[1/s per percent\].
    pub b_d: f64,
    /// Curvature of the throttle \[1/percent\].
    pub b_uu: f64,
    /// Constant drift \[N/s²\].
    pub c: f64,
    /// Least throttle \[percent\].
    pub throttle_min: f64,
    /// Greatest throttle \[percent\].
    pub throttle_max: f64,
}

/// Equations of one engine: its thrust acceleration is affine in a function of the throttle.
///
/// ```text
/// T̈ = f(T, Ṫ) + g(T, Ṫ) v(u)
/// f = K_T T + K_TT T² + K_D Ṫ + K_DD Ṫ² + K_TD T Ṫ + c
/// g = B_U + B_T T + B_D Ṫ,   v(u) = u + B_UU u²
/// ```
///
/// T thrust \[N\], u throttle \[%\]. Source: the published flight controller's jet model, identified
/// on the test bench by its authors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecondOrder {
    coefficients: EngineCoefficients,
}

impl SecondOrder {
    /// Checks that coefficients are finite and that `v(u)` increases between the throttle limits.
    ///
    /// # Errors
    /// [`BuildError`] naming `engine` and the coefficient.
    pub fn new(engine: &str, coefficients: EngineCoefficients) -> Result<Self, BuildError> {
        let k = &coefficients;
        schema::check(k, &format!("engines.{engine}"))?;
        let above = format!("a throttle above throttle_min = {} %", k.throttle_min);
        let item = format!("throttle_max of engine `{engine}`");
        check(&item, k.throttle_max, |max| max > k.throttle_min, &above)?;
        // dv/du = 1 + 2 B_UU u is linear in u, so it is positive between the ends if it is positive at both.
        let increases =
            |b_uu: f64| [k.throttle_min, k.throttle_max].iter().all(|u| 1.0 + 2.0 * b_uu * u > 0.0);
        let expected = "such that u + b_uu u² increases between the throttle limits";
        check(&format!("b_uu of engine `{engine}`"), k.b_uu, increases, expected)?;
        Ok(Self { coefficients })
    }

    /// Coefficients of the equations.
    #[must_use]
    pub fn coefficients(&self) -> &EngineCoefficients {
        &self.coefficients
    }

    /// Drift `f(T, Ṫ)` \[N/s²\]: thrust acceleration for `v = 0`.
    fn drift(&self, thrust: f64, thrust_rate: f64) -> f64 {
        let k = &self.coefficients;
        thrust * (k.k_t + k.k_tt * thrust + k.k_td * thrust_rate)
            + thrust_rate * (k.k_d + k.k_dd * thrust_rate)
            + k.c
    }

    /// Input gain `g(T, Ṫ)` \[N/s² per %\]; changes sign where the thrust rises fast.
    fn input_gain(&self, thrust: f64, thrust_rate: f64) -> f64 {
        let k = &self.coefficients;
        k.b_u + k.b_t * thrust + k.b_d * thrust_rate
    }

    /// Input `v(u)` \[%\] of a throttle \[%\], which is limited first.
    fn input(&self, throttle: f64) -> f64 {
        let k = &self.coefficients;
        let throttle = throttle.clamp(k.throttle_min, k.throttle_max);
        throttle * (1.0 + k.b_uu * throttle)
    }

    /// Throttle \[%\] within the limits whose thrust acceleration is nearest to a wanted one \[N/s²\]; `None` where the
    /// throttle does not act on the thrust, and for numbers that are not finite.
    ///
    /// ```text
    /// v = clamp (T̈ − f(T, Ṫ)) / g(T, Ṫ),   u = 2 v / (1 + √(1 + 4 B_UU v))
    /// ```
    ///
    /// The published `(−1 + √…)/(2 B_UU)` with the root in the denominator, which is also correct for `B_UU = 0`.
    #[must_use]
    pub fn throttle_for(&self, thrust: f64, thrust_rate: f64, acceleration: f64) -> Option<f64> {
        let k = &self.coefficients;
        let gain = self.input_gain(thrust, thrust_rate);
        let wanted = (acceleration - self.drift(thrust, thrust_rate)) / gain;
        (wanted.is_finite() && gain.abs() >= MIN_INPUT_GAIN).then(|| {
            let input = wanted.clamp(self.input(k.throttle_min), self.input(k.throttle_max));
            // The root is real between the limits, up to rounding.
            let root = (1.0 + 4.0 * k.b_uu * input).max(0.0).sqrt();
            (2.0 * input / (1.0 + root)).clamp(k.throttle_min, k.throttle_max)
        })
    }

    /// Throttle \[%\] that holds a thrust, as nearly as the limits allow; the least throttle if the throttle does not act
    /// on the thrust there.
    #[must_use]
    pub fn steady_throttle(&self, thrust: f64) -> f64 {
        self.throttle_for(thrust, 0.0, 0.0).unwrap_or(self.coefficients.throttle_min)
    }

    /// Thrust acceleration `T̈` \[N/s²\] for a throttle \[%\], which is limited first.
    #[must_use]
    pub fn thrust_acceleration(&self, thrust: f64, thrust_rate: f64, throttle: f64) -> f64 {
        self.drift(thrust, thrust_rate) + self.input_gain(thrust, thrust_rate) * self.input(throttle)
    }

    /// Least and greatest thrust acceleration between the limits of the throttle \[N/s²\].
    #[must_use]
    pub fn acceleration_range(&self, thrust: f64, thrust_rate: f64) -> (f64, f64) {
        let [a, b] = [self.coefficients.throttle_min, self.coefficients.throttle_max]
            .map(|throttle| self.thrust_acceleration(thrust, thrust_rate, throttle));
        (a.min(b), a.max(b))
    }

    /// Derivatives of `T̈` with respect to `T` \[1/s²\] and `Ṫ` \[1/s\], at a throttle \[%\].
    #[must_use]
    pub fn acceleration_slopes(&self, thrust: f64, thrust_rate: f64, throttle: f64) -> (f64, f64) {
        let k = &self.coefficients;
        let v = self.input(throttle);
        (
            k.k_t + 2.0 * k.k_tt * thrust + k.k_td * thrust_rate + k.b_t * v,
            k.k_d + 2.0 * k.k_dd * thrust_rate + k.k_td * thrust + k.b_d * v,
        )
    }
}
