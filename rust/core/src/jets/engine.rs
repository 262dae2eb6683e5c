//! The identified second-order jet engine, and the throttle loop that tracks a thrust rate.
//!
//! Equations M32 to M34, M144 and M173 of `docs/model`.

use crate::error::{BuildError, check};
use crate::robot::EngineCoefficients;

/// Input gain below which the throttle does not control the thrust and the loop holds it \[N/s² per %\].
const MIN_INPUT_GAIN: f64 = 1e-9;

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
pub struct EngineModel {
    coefficients: EngineCoefficients,
}

impl EngineModel {
    /// Checks that coefficients are finite and that `v(u)` increases between the throttle limits.
    ///
    /// # Errors
    /// [`BuildError`] naming `engine` and the coefficient.
    pub fn new(engine: &str, coefficients: EngineCoefficients) -> Result<Self, BuildError> {
        let k = &coefficients;
        for (name, value) in [
            ("k_t", k.k_t),
            ("k_tt", k.k_tt),
            ("k_d", k.k_d),
            ("k_dd", k.k_dd),
            ("k_td", k.k_td),
            ("b_u", k.b_u),
            ("b_t", k.b_t),
            ("b_d", k.b_d),
            ("b_uu", k.b_uu),
            ("c", k.c),
            ("throttle_min", k.throttle_min),
        ] {
            check(&format!("{name} of engine `{engine}`"), value, |_| true, "a finite number")?;
        }
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

    /// Drift `f(T, Ṫ)` \[N/s²\]: thrust acceleration for `v = 0`.
    #[must_use]
    pub fn drift(&self, thrust: f64, thrust_rate: f64) -> f64 {
        let k = &self.coefficients;
        thrust * (k.k_t + k.k_tt * thrust + k.k_td * thrust_rate)
            + thrust_rate * (k.k_d + k.k_dd * thrust_rate)
            + k.c
    }

    /// Input gain `g(T, Ṫ)` \[N/s² per %\]; changes sign where the thrust rises fast.
    #[must_use]
    pub fn input_gain(&self, thrust: f64, thrust_rate: f64) -> f64 {
        let k = &self.coefficients;
        k.b_u + k.b_t * thrust + k.b_d * thrust_rate
    }

    /// Input `v(u) = u + B_UU u²` \[%\] for a throttle \[%\].
    #[must_use]
    pub fn input(&self, throttle: f64) -> f64 {
        throttle * (1.0 + self.coefficients.b_uu * throttle)
    }

    /// Throttle \[%\] with `v(u) = input`, on the branch through `u = v = 0`; not limited.
    ///
    /// ```text
    /// u = 2 v / (1 + √(1 + 4 B_UU v)),   −1/(2 B_UU) where the root is not real
    /// ```
    ///
    /// The published `(−1 + √…)/(2 B_UU)` with the root in the denominator, which is also correct for
    /// `B_UU = 0`. Where no throttle gives `input`, the throttle at the vertex of the parabola, which keeps
    /// the function continuous.
    #[must_use]
    pub fn throttle_from_input(&self, input: f64) -> f64 {
        let b_uu = self.coefficients.b_uu;
        let discriminant = 1.0 + 4.0 * b_uu * input;
        // Beyond the vertex, with a root of zero, the formula would continue to increase with v.
        if discriminant < 0.0 { -0.5 / b_uu } else { 2.0 * input / (1.0 + discriminant.sqrt()) }
    }

    /// Limits a throttle \[%\] to the engine's range.
    #[must_use]
    pub fn limit_throttle(&self, throttle: f64) -> f64 {
        throttle.clamp(self.coefficients.throttle_min, self.coefficients.throttle_max)
    }

    /// Limits an input `v` \[%\] to the values of `v` at the throttle limits.
    #[must_use]
    pub fn limit_input(&self, input: f64) -> f64 {
        let k = &self.coefficients;
        input.clamp(self.input(k.throttle_min), self.input(k.throttle_max))
    }

    /// Throttle \[%\] that holds a thrust: `f(T, 0) + g(T, 0) v(u) = 0`, within the limits; the least throttle
    /// if the throttle does not act on the thrust there.
    #[must_use]
    pub fn steady_throttle(&self, thrust: f64) -> f64 {
        let gain = self.input_gain(thrust, 0.0);
        if gain.abs() < MIN_INPUT_GAIN {
            return self.coefficients.throttle_min;
        }
        self.limit_throttle(self.throttle_from_input(self.limit_input(-self.drift(thrust, 0.0) / gain)))
    }

    /// Thrust acceleration `T̈` \[N/s²\] for a throttle \[%\], which is limited first.
    #[must_use]
    pub fn thrust_acceleration(&self, thrust: f64, thrust_rate: f64, throttle: f64) -> f64 {
        self.drift(thrust, thrust_rate)
            + self.input_gain(thrust, thrust_rate) * self.input(self.limit_throttle(throttle))
    }

    /// Thrust rate \[N/s\] after `dt` \[s\] at the throttle within the limits that brings it nearest to a commanded one.
    #[must_use]
    pub fn nearest_rate(&self, thrust: f64, thrust_rate: f64, command: f64, dt: f64) -> f64 {
        let (least, greatest) = self.acceleration_range(thrust, thrust_rate);
        thrust_rate + (command - thrust_rate).max(dt * least).min(dt * greatest)
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
        let v = self.input(self.limit_throttle(throttle));
        (
            k.k_t + 2.0 * k.k_tt * thrust + k.k_td * thrust_rate + k.b_t * v,
            k.k_d + 2.0 * k.k_dd * thrust_rate + k.k_td * thrust + k.b_d * v,
        )
    }
}

/// State of one engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EngineDynamics {
    model: EngineModel,
    /// Thrust `T` \[N\].
    pub thrust: f64,
    /// Thrust rate `Ṫ` \[N/s\].
    pub thrust_rate: f64,
}

impl EngineDynamics {
    /// An engine at a thrust \[N\] and thrust rate \[N/s\].
    #[must_use]
    pub fn new(model: EngineModel, thrust: f64, thrust_rate: f64) -> Self {
        Self { model, thrust, thrust_rate }
    }

    /// The engine's equations.
    #[must_use]
    pub fn model(&self) -> &EngineModel {
        &self.model
    }

    /// Advances the engine by `dt` \[s\] at a constant throttle \[%\], limited to the engine's range.
    ///
    /// ```text
    /// T ← T + Ṫ dt + T̈ dt²/2,   Ṫ ← Ṫ + T̈ dt,   T̈ at the start of the step
    /// ```
    ///
    /// Source: the published simulator. The range of the thrust is left to the simulated jets. A NaN throttle results in
    /// NaN.
    pub fn step(&mut self, throttle: f64, dt: f64) {
        let acceleration = self.model.thrust_acceleration(self.thrust, self.thrust_rate, throttle);
        self.thrust += dt * (self.thrust_rate + 0.5 * dt * acceleration);
        self.thrust_rate += dt * acceleration;
    }
}

/// Gain of the throttle loop \[1/s\], of the published controller. The error decays only if `k_p dt < 2`; with the
/// published 1.5 it changes sign and halves every tick.
pub const RATE_GAIN: f64 = 150.0;

/// Throttle loop: feedback linearisation of [`EngineModel`] to `T̈ = −k_p (Ṫ − Ṫ*)`, `k_p` = [`RATE_GAIN`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThrustRateController {
    /// Last throttle \[%\].
    throttle: f64,
}

impl ThrustRateController {
    /// A loop with the initial throttle \[%\].
    #[must_use]
    pub fn new(throttle: f64) -> Self {
        Self { throttle }
    }

    /// Last throttle \[%\].
    #[must_use]
    pub fn throttle(&self) -> f64 {
        self.throttle
    }

    /// Returns the throttle \[%\] for a commanded thrust rate \[N/s\].
    ///
    /// ```text
    /// v = −( k_p (Ṫ − Ṫ*) + f(T, Ṫ) ) / g(T, Ṫ),   u = v⁻¹(clamp v)
    /// ```
    ///
    /// Source: the published controller. Where `g` is zero or a number is not finite the throttle is held, instead of a
    /// division by zero.
    pub fn update(&mut self, model: &EngineModel, thrust: f64, thrust_rate: f64, command: f64) -> f64 {
        let gain = model.input_gain(thrust, thrust_rate);
        let wanted = -(RATE_GAIN * (thrust_rate - command) + model.drift(thrust, thrust_rate)) / gain;
        if wanted.is_finite() && gain.abs() >= MIN_INPUT_GAIN {
            self.throttle = model.limit_throttle(model.throttle_from_input(model.limit_input(wanted)));
        }
        self.throttle
    }
}
