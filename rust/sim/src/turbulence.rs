//! Turbulent wind as a function of time: a sum of waves, which needs no state and no table.
//!
//! Equation M38 of `docs/model`.

use crate::noise::Noise;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Waves per axis.
const WAVES: usize = 24;

/// A wave along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wave {
    frequency: f64,
    phase: f64,
}

/// Fluctuations about the mean wind with the spectrum of a first-order Gauss–Markov process.
///
/// ```text
/// S(ω) ∝ σ² τ / (1 + ω² τ²)
/// ```
///
/// Every wave has the same part of the variance, at a random frequency within its band and with a
/// random phase. Source: ours; the longitudinal Dryden spectrum has this form.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Turbulence {
    amplitude: Vector3<f64>,
    waves: [[Wave; WAVES]; 3],
}

impl Turbulence {
    /// Turbulence with a standard deviation for each axis \[m/s\] and a time scale τ \[s\].
    #[must_use]
    pub(crate) fn new(std: &Vector3<f64>, time_scale: f64, seed: u64) -> Self {
        let mut noise = Noise::new(seed, 2);
        let mut wave = |band: usize| {
            // Not up to the edge of the band, because the last band has no upper edge.
            let place = band as f64 + 0.25 + 0.5 * noise.uniform();
            Wave {
                frequency: libm::tan(FRAC_PI_2 * place / WAVES as f64) / time_scale,
                phase: TAU * noise.uniform(),
            }
        };
        Self {
            amplitude: std * (2.0 / WAVES as f64).sqrt(),
            waves: std::array::from_fn(|_| std::array::from_fn(&mut wave)),
        }
    }

    /// Velocity to be added to the mean wind at `time` \[s\], in m/s, inertial axes.
    #[must_use]
    pub(crate) fn velocity(&self, time: f64) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let sum: f64 =
                self.waves[axis].iter().map(|wave| libm::sin(wave.frequency * time + wave.phase)).sum();
            self.amplitude[axis] * sum
        })
    }
}
