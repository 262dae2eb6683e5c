//! Wind as a function of time: velocity of the air in inertial axes, uniform in space.
//!
//! Equations M36 and M37 of `docs/model`.

use crate::turbulence::Turbulence;
use flight_core::control::preview::interpolate;
use flight_core::error::{BuildError, check};
use flight_io::csv::{Csv, Kind};
use flight_io::read_text;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Least number in a recorded wind that stands for a missing one \[m/s\].
const MISSING: f64 = 99.0;

/// A wind profile; velocities in m/s, inertial axes, times in s.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "profile", rename_all = "snake_case", deny_unknown_fields)]
pub enum WindConfig {
    /// Constant velocity.
    Constant {
        /// Velocity of the air \[m/s\].
        velocity: [f64; 3],
    },
    /// Zero, then a linear rise to a constant: the published profile.
    Ramp {
        /// Velocity after the ramp \[m/s\].
        velocity: [f64; 3],
        /// Start of the rise \[s\].
        ramp_start: f64,
        /// End of the rise \[s\].
        ramp_end: f64,
    },
    /// A steady wind with one "1 − cos" gust.
    Gust {
        /// Steady velocity \[m/s\].
        velocity: [f64; 3],
        /// Velocity added at the peak of the gust \[m/s\].
        gust: [f64; 3],
        /// Start of the gust \[s\].
        start: f64,
        /// Duration of the gust \[s\].
        #[schemars(extend("exclusiveMinimum" = 0))]
        duration: f64,
    },
    /// The published profile with turbulence that rises in proportion.
    Turbulent {
        /// Mean velocity after the ramp \[m/s\].
        velocity: [f64; 3],
        /// Start of the rise \[s\].
        ramp_start: f64,
        /// End of the rise \[s\].
        ramp_end: f64,
        /// Standard deviation of the turbulence on each axis \[m/s\].
        #[schemars(inner(range(min = 0)))]
        std: [f64; 3],
        /// Time scale of the turbulence \[s\].
        #[schemars(extend("exclusiveMinimum" = 0))]
        time_scale: f64,
        /// Seed of the turbulence.
        #[serde(default)]
        seed: u64,
    },
    /// A recorded wind: a CSV file with header `time,x,y,z`; linear between samples, constant
    /// outside.
    File {
        /// The file; relative paths start at the configuration file.
        #[schemars(extend("format" = "path"))]
        path: PathBuf,
    },
    /// A recorded wind, given here; linear between samples, constant outside.
    Samples {
        /// Time \[s\], increasing, and velocity along x, y and z \[m/s\].
        samples: Vec<[f64; 4]>,
    },
}

/// A wind profile after its checks.
#[derive(Debug, Clone)]
pub struct Wind {
    profile: WindConfig,
    /// Turbulence at full rise.
    turbulence: Option<Box<Turbulence>>,
    /// Recorded samples `(time, velocity)` in order of time.
    samples: Vec<(f64, Vector3<f64>)>,
}

impl Wind {
    /// Checks a profile and reads its file, if it names one.
    ///
    /// # Errors
    /// [`BuildError`] naming the key or the file and line.
    pub fn new(config: &WindConfig) -> Result<Self, BuildError> {
        Self::from_table(config, "wind")
    }

    /// As [`Wind::new`]; errors name the profile `table`.
    ///
    /// # Errors
    /// As [`Wind::new`].
    pub fn from_table(config: &WindConfig, table: &str) -> Result<Self, BuildError> {
        flight_core::schema::check(config, table)?;
        let mut wind = Self { profile: config.clone(), turbulence: None, samples: Vec::new() };
        match config {
            WindConfig::Constant { .. } | WindConfig::Gust { .. } => {}
            WindConfig::Ramp { ramp_start, ramp_end, .. }
            | WindConfig::Turbulent { ramp_start, ramp_end, .. } => {
                let expected = format!("a time ≥ ramp_start ({ramp_start})");
                check(&format!("{table}.ramp_end"), *ramp_end, |end| end >= *ramp_start, &expected)?;
            }
            WindConfig::File { path } => wind.samples = read_samples(path)?,
            WindConfig::Samples { samples } => {
                let item = format!("{table}.samples");
                wind.samples = check_order(samples, &item, |index| format!("{item}[{index}]"))?;
            }
        }
        if let WindConfig::Turbulent { std, time_scale, seed, .. } = config {
            wind.turbulence = Some(Turbulence::new(&Vector3::from(*std), *time_scale, *seed).into());
        }
        Ok(wind)
    }

    /// Samples `(time, velocity)` of a recorded wind \[s, m/s\]; empty of any other.
    #[must_use]
    pub fn samples(&self) -> &[(f64, Vector3<f64>)] {
        &self.samples
    }

    /// Velocity of the air at `time` \[s\], in m/s, inertial axes.
    #[must_use]
    pub fn velocity(&self, time: f64) -> Vector3<f64> {
        let vector = |velocity: &[f64; 3]| Vector3::from(*velocity);
        match &self.profile {
            WindConfig::Constant { velocity } => vector(velocity),
            WindConfig::Ramp { velocity, ramp_start, ramp_end } => {
                vector(velocity) * ramp_fraction(*ramp_start, *ramp_end, time)
            }
            WindConfig::Turbulent { velocity, ramp_start, ramp_end, .. } => {
                let turbulence = self.turbulence.as_ref().map_or_else(Vector3::zeros, |of| of.velocity(time));
                (vector(velocity) + turbulence) * ramp_fraction(*ramp_start, *ramp_end, time)
            }
            WindConfig::Gust { velocity, gust, start, duration } => {
                let phase = (time - start) / duration;
                let strength =
                    if (0.0..=1.0).contains(&phase) { 0.5 * (1.0 - libm::cos(TAU * phase)) } else { 0.0 };
                vector(velocity) + vector(gust) * strength
            }
            WindConfig::File { .. } | WindConfig::Samples { .. } => interpolate(&self.samples, time),
        }
    }
}

/// Fraction of a rise at `time`, from 0 to 1.
fn ramp_fraction(start: f64, end: f64, time: f64) -> f64 {
    if time >= end { 1.0 } else { ((time - start) / (end - start)).max(0.0) }
}

/// Checks that samples are in order of time; errors name `item` and the sample's `place`.
fn check_order(
    samples: &[[f64; 4]],
    item: &str,
    place: impl Fn(usize) -> String,
) -> Result<Vec<(f64, Vector3<f64>)>, BuildError> {
    if samples.is_empty() {
        return Err(BuildError::bad_value(item, "empty", "at least one sample"));
    }
    for (index, sample) in samples.iter().enumerate() {
        let expected = if !sample.iter().all(|number| number.is_finite()) {
            "four finite numbers: time, x, y, z"
        } else if index > 0 && sample[0] <= samples[index - 1][0] {
            "a time later than the one before"
        } else {
            continue;
        };
        return Err(BuildError::bad_value(place(index), format!("{sample:?}"), expected));
    }
    Ok(samples.iter().map(|[time, x, y, z]| (*time, Vector3::new(*x, *y, *z))).collect())
}

fn read_samples(path: &Path) -> Result<Vec<(f64, Vector3<f64>)>, BuildError> {
    const COLUMNS: [&str; 4] = ["time", "x", "y", "z"];
    let file = format!("wind file {}", path.display());
    let text = read_text(path)?;
    let csv = Csv::new(&text, &file, "the header time,x,y,z", |names| names == COLUMNS)?;
    let rows = csv.read(&COLUMNS.map(|name| (name, Kind::Number)))?;
    let samples = rows.numbers.as_chunks::<4>().0;
    if let Some(row) = samples
        .iter()
        .position(|sample| sample[1..].iter().any(|part| part.is_finite() && part.abs() >= MISSING))
    {
        let expected = format!(
            "a wind below {MISSING} m/s, as {MISSING}, 999 and the like stand for no measurement, whose row is left out"
        );
        return Err(BuildError::bad_value(rows.place(&file, row), format!("{:?}", samples[row]), expected));
    }
    check_order(samples, &file, |row| rows.place(&file, row))
}
