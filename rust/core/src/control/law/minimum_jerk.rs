//! The minimum-jerk filter, which smooths references.
//!
//! Equations M45 and M46 of `docs/model`.

use nalgebra::{Matrix3, Vector3};

// Coefficients of the linear minimum-jerk trajectory generator of the iCub control library; the denominator has one
// real pole of multiplicity three at −5.3223/T.
const A: f64 = 150.765_868_956_161;
const B: f64 = 84.981_281_946_953_8;
const C: f64 = 15.966_961_070_938_4;

/// Three-axis low-pass filter of unit gain whose step response is nearly a minimum-jerk motion.
///
/// ```text
/// H(s) = (A/T³) / (s³ + (C/T) s² + (B/T²) s + A/T³)
/// ```
///
/// Outputs `H u`, `s H u`, `s² H u`: smoothed value, first and second derivative. Discretised by the
/// bilinear transform (Tustin): the trapezoidal rule on the controllable form
/// `ẋ = (x₂, x₃, A/T³ (u − x₁) − B/T² x₂ − C/T x₃)`.
#[derive(Debug, Clone, PartialEq)]
pub struct MinimumJerkFilter {
    transition: Matrix3<f64>,
    input_gain: Vector3<f64>,
    /// `T B / A` \[s\] and `T² C / A` \[s²\].
    lags: [f64; 2],
}

/// State of a [`MinimumJerkFilter`], and its output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterState {
    /// Column k holds value, first and second derivative of axis k.
    derivatives: Matrix3<f64>,
    previous_input: Vector3<f64>,
}

impl FilterState {
    /// State of equilibrium at a constant input.
    #[must_use]
    pub fn at_rest(input: Vector3<f64>) -> Self {
        Self::from_outputs([input, Vector3::zeros(), Vector3::zeros()], input)
    }

    /// State with these outputs (value, first and second derivative) and the given last input.
    #[must_use]
    pub fn from_outputs(outputs: [Vector3<f64>; 3], input: Vector3<f64>) -> Self {
        Self {
            derivatives: Matrix3::from_rows(&outputs.map(|output| output.transpose())),
            previous_input: input,
        }
    }

    /// Smoothed input.
    #[must_use]
    pub fn value(&self) -> Vector3<f64> {
        self.derivatives.row(0).transpose()
    }

    /// First time derivative of the smoothed input.
    #[must_use]
    pub fn rate(&self) -> Vector3<f64> {
        self.derivatives.row(1).transpose()
    }

    /// Second time derivative of the smoothed input.
    #[must_use]
    pub fn acceleration(&self) -> Vector3<f64> {
        self.derivatives.row(2).transpose()
    }
}

impl MinimumJerkFilter {
    /// Filter with smoothing time `smoothing_time` \[s\] at tick `time_step` \[s\]. Both must be positive, which
    /// the configuration checks.
    #[must_use]
    pub fn new(smoothing_time: f64, time_step: f64) -> Self {
        let t = smoothing_time;
        let half = 0.5 * time_step;
        let continuous = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, -A / (t * t * t), -B / (t * t), -C / t);
        // I − hA/2 is invertible: all coefficients of H are positive, so its determinant is > 1 for every h, T > 0.
        let inverse = (Matrix3::identity() - continuous * half).try_inverse().unwrap_or_else(Matrix3::zeros);
        Self {
            transition: inverse * (Matrix3::identity() + continuous * half),
            input_gain: inverse * Vector3::new(0.0, 0.0, half * A / (t * t * t)),
            lags: [t * B / A, t * t * C / A],
        }
    }

    /// Input, and its rate, for which the filter has these outputs (value, first and second derivative) without
    /// jerk: `u = y + (T B/A) ẏ + (T² C/A) ÿ`.
    #[must_use]
    pub fn input_of(&self, [value, rate, acceleration]: [Vector3<f64>; 3]) -> (Vector3<f64>, Vector3<f64>) {
        let [first, second] = self.lags;
        (value + rate * first + acceleration * second, rate + acceleration * first)
    }

    /// Advances the filter with the input of this tick; `state` then holds the outputs of this tick.
    pub fn update(&self, state: &mut FilterState, input: &Vector3<f64>) {
        let drive = self.input_gain * (state.previous_input + input).transpose();
        state.derivatives = self.transition * state.derivatives + drive;
        state.previous_input = *input;
    }
}
