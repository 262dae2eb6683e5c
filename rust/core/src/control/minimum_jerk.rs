//! The minimum-jerk filter that smooths references.
//!
//! Equations M45 and M46 of `docs/model.md`.

use nalgebra::{Matrix3, Vector3};

// Coefficients of the linear minimum-jerk trajectory generator of the iCub control library; the
// denominator has one real pole of multiplicity three at −5.3223/T.
const A: f64 = 150.765_868_956_161;
const B: f64 = 84.981_281_946_953_8;
const C: f64 = 15.966_961_070_938_4;

/// Three-axis low-pass filter with unit gain whose step response is nearly a minimum-jerk motion.
///
/// ```text
/// H(s) = (A/T³) / (s³ + (C/T) s² + (B/T²) s + A/T³)
/// ```
///
/// Outputs `H u`, `s H u`, `s² H u`: smoothed value, first and second derivative. Discretised by the
/// bilinear transform (Tustin): the trapezoidal rule on the controllable form
/// `ẋ = (x₂, x₃, A/T³ (u − x₁) − B/T² x₂ − C/T x₃)`. Starts in equilibrium.
#[derive(Debug, Clone)]
pub struct MinimumJerkFilter {
    transition: Matrix3<f64>,
    input_gain: Vector3<f64>,
    /// Column k holds value, first and second derivative of axis k.
    state: Matrix3<f64>,
    previous_input: Vector3<f64>,
}

/// Output of a [`MinimumJerkFilter`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothed {
    /// Smoothed input.
    pub value: Vector3<f64>,
    /// Its first time derivative.
    pub rate: Vector3<f64>,
    /// Its second time derivative.
    pub acceleration: Vector3<f64>,
}

impl MinimumJerkFilter {
    /// Filter with smoothing time `smoothing_time` \[s\] at tick `time_step` \[s\], at rest at
    /// `initial`. Both times must be positive (the configuration checks them).
    #[must_use]
    pub fn new(smoothing_time: f64, time_step: f64, initial: Vector3<f64>) -> Self {
        let t = smoothing_time;
        let half = 0.5 * time_step;
        let continuous = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, -A / t.powi(3), -B / t.powi(2), -C / t);
        // I − hA/2 has determinant > 1 for every h, T > 0 (all coefficients of H are positive).
        let inverse = (Matrix3::identity() - continuous * half).try_inverse().unwrap_or_else(Matrix3::zeros);
        Self {
            transition: inverse * (Matrix3::identity() + continuous * half),
            input_gain: inverse * Vector3::new(0.0, 0.0, half * A / t.powi(3)),
            state: Matrix3::from_rows(&[
                initial.transpose(),
                Vector3::zeros().transpose(),
                Vector3::zeros().transpose(),
            ]),
            previous_input: initial,
        }
    }

    /// Takes the input of this tick and returns the outputs of this tick.
    pub fn update(&mut self, input: &Vector3<f64>) -> Smoothed {
        let drive = self.input_gain * (self.previous_input + input).transpose();
        self.state = self.transition * self.state + drive;
        self.previous_input = *input;
        Smoothed {
            value: self.state.row(0).transpose(),
            rate: self.state.row(1).transpose(),
            acceleration: self.state.row(2).transpose(),
        }
    }
}
