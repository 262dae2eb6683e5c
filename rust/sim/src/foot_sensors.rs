//! Sensors of the wrenches that the ground exerts on the feet.
//!
//! ```text
//! f ← T (1 + c (1 1ᵀ − I)) (R̂ Rᵀ f)(t − d) + b + σ ε        of force and moment, c: cross-talk, T: tilt
//! ```
//!
//! They measure in axes of the robot, and its measured attitude R̂ turns that to inertial axes.
//!
//! Equation M184 of `docs/model`.

use crate::noise::Noise;
use crate::sensors::age;
use flight_core::spatial::rotation_from_rpy;
use nalgebra::{DVector, Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Stream of the noise: other sensors draw the same numbers with and without it.
const STREAM: u64 = 6;

/// Sensors of force and moment, alike at every foot; wrenches are about the origins of the soles, in inertial axes, which are
/// those of level soles.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FootSensorConfig {
    /// Bias of the force \[N\].
    pub force_bias: [f64; 3],
    /// Bias of the moment \[N m\].
    pub moment_bias: [f64; 3],
    /// Standard deviation of white noise of each component of the force, drawn in every tick \[N\].
    #[schemars(range(min = 0))]
    pub force_noise_std: f64,
    /// Of the moment \[N m\].
    #[schemars(range(min = 0))]
    pub moment_noise_std: f64,
    /// Age of the measurement, rounded to ticks \[s\].
    #[schemars(range(min = 0, max = 1))]
    pub delay: f64,
    /// Share of each component that its two neighbours of force or moment show in addition.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub cross_talk: f64,
    /// Roll, pitch and yaw of what is measured \[deg\]: a sensor that is mounted askew.
    pub tilt_rpy_deg: [f64; 3],
}

/// The sensors with their state; read once per tick.
#[derive(Debug, Clone)]
pub struct FootSensors {
    config: FootSensorConfig,
    /// From the true force to the measured one, and from the moment.
    shown: Matrix3<f64>,
    noise: Noise,
    /// True wrenches of the last ticks, a ring buffer; `now` is the latest.
    line: Vec<DVector<f64>>,
    now: usize,
    is_started: bool,
}

impl FootSensors {
    /// Sensors of so many feet, read every `time_step` \[s\].
    #[must_use]
    pub fn new(config: &FootSensorConfig, seed: u64, time_step: f64, feet: usize) -> Self {
        let others = Matrix3::from_element(1.0) - Matrix3::identity();
        let turn = rotation_from_rpy(&Vector3::from(config.tilt_rpy_deg.map(f64::to_radians)));
        Self {
            shown: turn * (Matrix3::identity() + config.cross_talk * others),
            noise: Noise::new(seed, STREAM),
            line: vec![DVector::zeros(6 * feet); age(config.delay, time_step) + 1],
            now: 0,
            is_started: false,
            config: config.clone(),
        }
    }

    /// Replaces true wrenches by what the sensors read; until the delay has passed, by the first ones. `turn` is the measured
    /// attitude relative to the true one, `R̂ Rᵀ`; one that is not measured turns nothing. Does not allocate.
    pub fn read(&mut self, turn: &Matrix3<f64>, wrenches: &mut DVector<f64>) {
        let Self { config, shown, noise, line, now, is_started } = self;
        if turn.iter().all(|entry| entry.is_finite()) {
            for row in (0..wrenches.len()).step_by(3) {
                let turned = turn * wrenches.fixed_rows::<3>(row);
                wrenches.fixed_rows_mut::<3>(row).copy_from(&turned);
            }
        }
        *now = (*now + 1) % line.len();
        for (place, tick) in line.iter_mut().enumerate() {
            if place == *now || !*is_started {
                tick.copy_from(wrenches);
            }
        }
        *is_started = true;
        let oldest = &line[(*now + 1) % line.len()];
        let parts =
            [(&config.force_bias, config.force_noise_std), (&config.moment_bias, config.moment_noise_std)];
        for (part, row) in (0..wrenches.len()).step_by(3).enumerate() {
            let (bias, std) = parts[part % 2];
            let drawn = Vector3::from_fn(|_, _| noise.normal());
            let exact = *shown * oldest.fixed_rows::<3>(row);
            wrenches.fixed_rows_mut::<3>(row).copy_from(&(exact + Vector3::from(*bias) + std * drawn));
        }
    }
}
