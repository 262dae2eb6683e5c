//! Extended Kalman filter for thrust and thrust rate of one engine, from its measured thrust.
//!
//! Equation M35 of `docs/model`.

use super::SecondOrder;
use nalgebra::{Matrix2, Vector2};

/// Covariance of the initial state, as published.
const INITIAL: Matrix2<f64> = Matrix2::new(1.0, 0.1, 0.1, 1.0);

/// `Q`, `R`: intensities of the noise of the process and of the measurement, as published.
const Q: Matrix2<f64> = Matrix2::new(10.0, 1.0, 1.0, 10.0);
const R: f64 = 1.0;

/// Extended Kalman filter of one engine: an update with measurement variance `R/dt`, then a prediction over `dt`.
///
/// ```text
/// K = P Cᵀ (C P Cᵀ + R/dt)⁻¹,   x̂ ← x̂ + K (y − T̂),   P ← P − K C P,   C = (1 0)
/// x̂ ← x̂ + dt ( Ṫ, T̈(x̂, u) ),   P ← Φ P Φᵀ + dt Q,   Φ = 1 + dt A,   A = ∂(Ṫ, T̈)/∂x at (x̂, u)
/// ```
///
/// The published filter integrates the continuous-time equations, the limit of these for small `dt`, by forward
/// Euler; it diverges for `dt P₁₁/R` above 1. Here P remains a covariance for every R.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThrustEkf {
    model: SecondOrder,
    state: Vector2<f64>,
    covariance: Matrix2<f64>,
}

impl ThrustEkf {
    /// Builds the filter of `model`; it starts from the given thrust \[N\], which is finite, at rest. The published filter
    /// starts at zero: its throttle loop uses too small a thrust for the first two seconds.
    #[must_use]
    pub fn new(model: SecondOrder, initial_thrust: f64) -> Self {
        Self { model, state: Vector2::new(initial_thrust, 0.0), covariance: INITIAL }
    }

    /// Estimated thrust \[N\].
    #[must_use]
    pub fn thrust(&self) -> f64 {
        self.state.x
    }

    /// Estimated thrust rate \[N/s\].
    #[must_use]
    pub fn thrust_rate(&self) -> f64 {
        self.state.y
    }

    /// Covariance `P` of thrust and thrust rate.
    #[must_use]
    pub fn covariance(&self) -> &Matrix2<f64> {
        &self.covariance
    }

    /// Jacobian `A` of the engine's equations at the estimate and a throttle \[%\].
    #[must_use]
    pub fn jacobian(&self, throttle: f64) -> Matrix2<f64> {
        let (by_thrust, by_rate) = self.model.acceleration_slopes(self.state.x, self.state.y, throttle);
        Matrix2::new(0.0, 1.0, by_thrust, by_rate)
    }

    /// Advances the estimate by `dt` \[s\], with the thrust measured now \[N\] and the throttle held from now on
    /// \[%\].
    pub fn update(&mut self, measured_thrust: f64, throttle: f64, dt: f64) {
        let column = self.covariance.column(0).into_owned();
        let gain = column / (column.x + R / dt);
        self.state += gain * (measured_thrust - self.state.x);
        self.covariance -= gain * column.transpose();

        let (thrust, thrust_rate) = (self.state.x, self.state.y);
        let drift = Vector2::new(thrust_rate, self.model.thrust_acceleration(thrust, thrust_rate, throttle));
        let transition = Matrix2::identity() + dt * self.jacobian(throttle);
        self.state += dt * drift;
        self.covariance = transition * self.covariance * transition.transpose() + dt * Q;
    }
}
