//! A recorded reference: samples in time, and interpolation between them.
//!
//! Equation M49 of `docs/model`.

use crate::error::BuildError;
use crate::spatial::{GREATEST, exp_so3, log_so3, rotation_from_rpy};
use nalgebra::{Matrix3, Vector3};

/// Columns that every sample has: time, position, attitude.
pub const REQUIRED: usize = 7;

/// Greatest rotation between successive samples \[rad\]: the axis of half a turn would be determined by
/// rounding.
const MAX_TURN: f64 = 179.0 * std::f64::consts::PI / 180.0;

/// The reference at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedMotion {
    /// Position of the centre of mass and its first three derivatives \[m, m/s, m/s², m/s³\].
    pub com: [Vector3<f64>; 4],
    /// Base rotation, inertial from base.
    pub rotation: Matrix3<f64>,
    /// Angular velocity of the base \[rad/s, base axes\].
    pub angular_velocity_b: Vector3<f64>,
}

impl RecordedMotion {
    /// The motion at the share `s` of the way to another one, `h` \[s\] later and turned by `turn_b` \[rad\] (M49).
    #[must_use]
    pub fn interpolate(&self, other: &Self, turn_b: &Vector3<f64>, h: f64, s: f64) -> Self {
        let (a, b) = (self, other);
        let cubic =
            |order: usize| hermite([a.com[order], a.com[order + 1], b.com[order], b.com[order + 1]], h, s);
        Self {
            com: [cubic(0), cubic(1), cubic(2), a.com[3].lerp(&b.com[3], s)],
            rotation: a.rotation * exp_so3(&(turn_b * s)),
            angular_velocity_b: a.angular_velocity_b.lerp(&b.angular_velocity_b, s),
        }
    }

    /// The same position and attitude, at rest.
    fn at_rest(&self) -> Self {
        let zero = Vector3::zeros();
        Self { com: [self.com[0], zero, zero, zero], angular_velocity_b: zero, ..*self }
    }
}

/// A recorded reference after its checks: samples in order of time.
#[derive(Debug, Clone)]
pub struct Recording {
    times: Vec<f64>,
    motions: Vec<RecordedMotion>,
    /// Rotation vector from each sample to the next, in body axes of the earlier sample \[rad\].
    turns_b: Vec<Vector3<f64>>,
}

impl Recording {
    /// Builds a recording from samples in order of time. Each row has time, position, roll, pitch and yaw
    /// \[rad\] and, optionally, velocity, acceleration and jerk. `origin` and `place` name the recording and
    /// a row in errors.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the row and what was expected.
    pub fn new(rows: &[Vec<f64>], origin: &str, place: impl Fn(usize) -> String) -> Result<Self, BuildError> {
        if rows.len() < 2 {
            return Err(BuildError::bad_value(origin, format!("{} samples long", rows.len()), "at least 2"));
        }
        let width = rows[0].len();
        if !(REQUIRED..=REQUIRED + 9).contains(&width) || !(width - REQUIRED).is_multiple_of(3) {
            return Err(BuildError::bad_value(place(0), format!("{:?}", rows[0]), "7, 10, 13 or 16 numbers"));
        }
        let is_step = |time: f64| time > 0.0 && time.is_finite();
        for (index, row) in rows.iter().enumerate() {
            let expected = if row.len() != width {
                format!("{width} numbers")
            } else if !row.iter().all(|value| value.is_finite()) {
                "finite numbers".to_owned()
            } else if index > 0 && !is_step(row[0] - rows[index - 1][0]) {
                "a time later than the one before, by a finite number".to_owned()
            } else {
                continue;
            };
            return Err(BuildError::bad_value(place(index), format!("{row:?}"), expected));
        }
        let recording = Self::from_rows(rows, width);
        let is_finite = |motion: &RecordedMotion| {
            motion.com.iter().chain([&motion.angular_velocity_b]).all(|vector| vector.norm() <= GREATEST)
        };
        if let Some(row) = recording.motions.iter().position(|motion| !is_finite(motion)) {
            let expected = "positions, velocities, accelerations and jerks up to 1e6 (m, rad, s)";
            return Err(BuildError::bad_value(place(row), format!("{:?}", rows[row]), expected));
        }
        match recording.turns_b.iter().position(|turn| turn.norm() > MAX_TURN) {
            None => Ok(recording),
            Some(row) => {
                let turn = recording.turns_b[row].norm().to_degrees();
                let turned = format!("turned by {turn:.1} deg since {}", place(row));
                Err(BuildError::bad_value(
                    place(row + 1),
                    turned,
                    "a turn below 179 deg, whose axis is certain",
                ))
            }
        }
    }

    fn from_rows(rows: &[Vec<f64>], width: usize) -> Self {
        let triple = |row: &Vec<f64>, first: usize| Vector3::new(row[first], row[first + 1], row[first + 2]);
        let times: Vec<f64> = rows.iter().map(|row| row[0]).collect();
        let position: Vec<Vector3<f64>> = rows.iter().map(|row| triple(row, 1)).collect();
        let mut com = vec![position];
        for order in 0..3 {
            let first = REQUIRED + 3 * order;
            com.push(if first < width {
                rows.iter().map(|row| triple(row, first)).collect()
            } else {
                differences(&times, &com[order])
            });
        }
        let rotations: Vec<Matrix3<f64>> =
            rows.iter().map(|row| rotation_from_rpy(&triple(row, 4))).collect();
        let turns_b: Vec<Vector3<f64>> =
            rotations.windows(2).map(|pair| log_so3(&(pair[0].transpose() * pair[1]))).collect();
        let rates: Vec<Vector3<f64>> =
            turns_b.iter().zip(times.windows(2)).map(|(turn, time)| turn / (time[1] - time[0])).collect();
        let motions = (0..times.len())
            .map(|sample| RecordedMotion {
                com: [com[0][sample], com[1][sample], com[2][sample], com[3][sample]],
                rotation: rotations[sample],
                // Mean of the rotations before and after; the first and the last sample have only one.
                angular_velocity_b: 0.5
                    * (rates[sample.saturating_sub(1)] + rates[sample.min(rates.len() - 1)]),
            })
            .collect();
        Self { times, motions, turns_b }
    }

    /// The reference at `time` \[s\]; before the first and after the last sample, that sample at rest.
    ///
    /// Position, velocity and acceleration are each interpolated by the cubic whose slopes at both samples
    /// are the next derivative; jerk and angular velocity are linear, the attitude turns at a constant rate
    /// (M49).
    #[must_use]
    pub fn at(&self, time: f64) -> RecordedMotion {
        let next = self.times.partition_point(|sample| *sample <= time);
        let Some(before) = next.checked_sub(1) else { return self.motions[0].at_rest() };
        let (a, Some(b)) = (&self.motions[before], self.motions.get(next)) else {
            // The last sample itself is part of the recording.
            let last = &self.motions[before];
            return if time > self.times[before] { last.at_rest() } else { *last };
        };
        let h = self.times[next] - self.times[before];
        let s = (time - self.times[before]) / h;
        a.interpolate(b, &self.turns_b[before], h, s)
    }
}

/// Cubic Hermite interpolation over the length `h`, at the fraction `s` of it.
fn hermite([value_a, slope_a, value_b, slope_b]: [Vector3<f64>; 4], h: f64, s: f64) -> Vector3<f64> {
    let r = 1.0 - s;
    value_a * (r * r * (1.0 + 2.0 * s))
        + value_b * (s * s * (1.0 + 2.0 * r))
        + (slope_a * r - slope_b * s) * (h * s * r)
}

/// Slopes at the samples: of the parabola through a sample and its neighbours; at both ends, of the straight
/// line.
fn differences(times: &[f64], values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let steps: Vec<f64> = times.windows(2).map(|t| t[1] - t[0]).collect();
    let slopes: Vec<Vector3<f64>> =
        values.windows(2).zip(&steps).map(|(value, h)| (value[1] - value[0]) / *h).collect();
    (0..values.len())
        .map(|i| match (i.checked_sub(1), slopes.get(i)) {
            (Some(left), Some(right)) => {
                (slopes[left] * steps[i] + right * steps[left]) / (steps[left] + steps[i])
            }
            (None, Some(slope)) => *slope,
            (left, None) => slopes[left.unwrap_or(0)],
        })
        .collect()
}
