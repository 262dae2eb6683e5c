//! Errors of the measured wind.
//!
//! ```text
//! wind ──(mean_only)──► delay ──► + bias + noise ──► low pass ──► Measurement::wind
//! ```
//!
//! Equation M39 of `docs/model`.

use crate::noise::Noise;
use flight_core::BuildError;
use flight_core::timing::share;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Errors of the measured wind; none by default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WindEstimateConfig {
    /// Bias of the wind \[m/s, inertial axes\].
    pub bias: [f64; 3],
    /// Standard deviation of white noise on every axis, drawn in every tick \[m/s\].
    #[schemars(range(min = 0))]
    pub noise_std: f64,
    /// Age of the wind, rounded to ticks \[s\].
    #[schemars(range(min = 0, max = 1000))]
    pub delay: f64,
    /// Time constant of a first-order low pass after all other errors \[s\]; zero for none.
    #[schemars(range(min = 0))]
    pub time_constant: f64,
    /// Whether the controller receives the mean over the flight only.
    pub mean_only: bool,
    /// Seed of the noise.
    pub seed: u64,
}

/// State of the measured wind; update once per tick.
#[derive(Debug, Clone)]
pub struct WindEstimator {
    /// Replaces the wind if `mean_only` is set.
    mean: Option<Vector3<f64>>,
    bias: Vector3<f64>,
    noise_std: f64,
    noise: Noise,
    /// Age of the wind in ticks.
    age: usize,
    /// The last winds: when full, a ring buffer as long as the age, with the oldest entry at
    /// `next`.
    line: Vec<Vector3<f64>>,
    next: usize,
    /// Fraction of the difference that the low pass corrects per tick.
    step: f64,
    filtered: Option<Vector3<f64>>,
}

impl WindEstimator {
    /// Builds the estimator, which is updated every `time_step` \[s\]; `mean` is the mean wind of
    /// the flight.
    ///
    /// # Errors
    /// As [`WindEstimateConfig::check`].
    pub fn new(config: &WindEstimateConfig, time_step: f64, mean: Vector3<f64>) -> Result<Self, BuildError> {
        flight_core::schema::check(config, "disturbances.wind_estimate")?;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 1000 s
        let age = (config.delay / time_step).round() as usize;
        Ok(Self {
            age,
            mean: config.mean_only.then_some(mean),
            bias: Vector3::from(config.bias),
            noise_std: config.noise_std,
            noise: Noise::new(config.seed, 0),
            line: Vec::with_capacity(age),
            next: 0,
            step: share(time_step / config.time_constant),
            filtered: None,
        })
    }

    /// Measured wind of this tick, from the true wind of this tick \[m/s, inertial axes\].
    ///
    /// Until the delay has passed, it is that of the first wind; the low pass starts in its steady
    /// state.
    pub fn update(&mut self, wind_i: &Vector3<f64>) -> Vector3<f64> {
        let mut estimate = self.delay_wind(&self.mean.unwrap_or(*wind_i)) + self.bias;
        if self.noise_std > 0.0 {
            estimate += self.noise_std * Vector3::from_fn(|_, _| self.noise.normal());
        }
        let before = self.filtered.unwrap_or(estimate);
        // Without a filter the value must be exact; adding a difference back is not.
        let filtered = if self.step < 1.0 { before + (estimate - before) * self.step } else { estimate };
        self.filtered = Some(filtered);
        filtered
    }

    fn delay_wind(&mut self, wind: &Vector3<f64>) -> Vector3<f64> {
        if self.age == 0 {
            return *wind;
        }
        if self.line.len() < self.age {
            self.line.push(*wind);
            return self.line[0];
        }
        let oldest = std::mem::replace(&mut self.line[self.next], *wind);
        self.next = (self.next + 1) % self.age;
        oldest
    }
}
