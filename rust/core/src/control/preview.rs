//! What is known of the future at a tick: set-points and wind.

use super::law::setpoint::Setpoint;
use super::measure::greatest::MAGNITUDES;
use nalgebra::Vector3;

/// What is known of the future at a tick, which only the predictive law reads; by default nothing. Times are those after
/// the tick \[s\], increasing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Preview<'a> {
    /// Set-points that follow a given one, at times above zero: interpolated between, extrapolated after the last one. A
    /// mission has its own.
    pub setpoints: &'a [(f64, Setpoint)],
    /// Velocity of the air \[m/s, inertial axes\], at times from zero on: linear between samples, constant outside. The
    /// prediction has its change from time zero.
    pub wind: &'a [(f64, Vector3<f64>)],
}

impl Preview<'_> {
    /// Its valid parts, and whether it has no other. Set-points and winds must be within the range of [`greatest`].
    #[must_use]
    pub fn checked(self) -> (Self, bool) {
        let first = self.setpoints.first().is_none_or(|(time, _)| *time > 0.0);
        let are_setpoints = |(_, setpoint): &(f64, Setpoint)| setpoint.is_valid();
        let has_setpoints = first && are_ordered(self.setpoints) && self.setpoints.iter().all(are_setpoints);
        let first = self.wind.first().is_none_or(|(time, _)| *time >= 0.0);
        let are_winds = |(_, wind): &(f64, Vector3<f64>)| wind.iter().all(|x| x.abs() <= MAGNITUDES.wind);
        let has_wind = first && are_ordered(self.wind) && self.wind.iter().all(are_winds);
        let valid = Self {
            setpoints: if has_setpoints { self.setpoints } else { &[] },
            wind: if has_wind { self.wind } else { &[] },
        };
        (valid, has_setpoints && has_wind)
    }

    /// The set-point at a time after the tick, whose own is `now`; `None` from `tolerance` after the last one on \[s\].
    #[must_use]
    pub fn setpoint(&self, now: &Setpoint, time: f64, tolerance: f64) -> Option<Setpoint> {
        let (last, _) = self.setpoints.last().filter(|(last, _)| time < last + tolerance)?;
        let time = time.min(*last);
        let next = self.setpoints.partition_point(|(sample, _)| *sample < time);
        let (end, after) = self.setpoints.get(next)?;
        let (start, before) = match next.checked_sub(1) {
            None => (0.0, now),
            Some(before) => (self.setpoints[before].0, &self.setpoints[before].1),
        };
        let length = end - start;
        Some(before.interpolate(after, length, (time - start) / length))
    }

    /// Change of the wind from the tick to a time after it \[s; m/s\].
    #[must_use]
    pub fn wind_change(&self, time: f64) -> Vector3<f64> {
        interpolate(self.wind, time) - interpolate(self.wind, 0.0)
    }
}

/// Whether the times of samples are finite and increase.
fn are_ordered<T>(samples: &[(f64, T)]) -> bool {
    samples.iter().all(|(time, _)| time.is_finite()) && samples.windows(2).all(|pair| pair[0].0 < pair[1].0)
}

/// Value at `time` of samples in order of time: linear between them, constant outside; zero without samples.
#[must_use]
pub fn interpolate(samples: &[(f64, Vector3<f64>)], time: f64) -> Vector3<f64> {
    let after = samples.partition_point(|(sample, _)| *sample <= time);
    match (after.checked_sub(1).and_then(|before| samples.get(before)), samples.get(after)) {
        (Some((t0, v0)), Some((t1, v1))) => v0 + (v1 - v0) * ((time - t0) / (t1 - t0)),
        (Some((_, v)), None) | (None, Some((_, v))) => *v,
        (None, None) => Vector3::zeros(),
    }
}
