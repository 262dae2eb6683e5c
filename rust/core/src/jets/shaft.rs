//! An engine of the speed of its shaft: control unit, shaft, thrust.
//!
//! Equations M176 of `docs/model`. Speeds are shares of the full speed.

use crate::error::BuildError;
use crate::schema::{self, Positive};
use serde::{Deserialize, Serialize};

/// Newton's steps from an upper bound of the speed of a thrust: each doubles the digits of a bound that is at most `√2`
/// times too high.
const STEPS: u32 = 8;

/// Numbers of an engine, for every thrust that it has at full speed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShaftConfig {
    /// Speed at idle, a share of the full speed.
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub idle: f64,
    /// Greatest rates of the wanted speed upwards and downwards \[1/s\].
    #[schemars(with = "[Positive; 2]")]
    pub ramps: [f64; 2],
    /// Time constants of the speed below and above the wanted one \[s\].
    #[schemars(with = "[Positive; 2]")]
    pub lags: [f64; 2],
    /// Greatest acceleration and deceleration at full speed \[1/s\].
    #[schemars(with = "[Positive; 2]")]
    pub accelerations: [f64; 2],
    /// Exponent of the speed in both of them.
    #[schemars(range(min = 0))]
    pub exponent: f64,
    /// Share of the thrust that is proportional to the square of the speed; the rest is to its cube.
    #[schemars(range(min = 0, max = 1))]
    pub square_share: f64,
}

/// One engine of the shaft's speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft {
    k: ShaftConfig,
    /// Thrust at full speed in standard air \[N\].
    thrust_max: f64,
}

impl Shaft {
    /// Checks every number; `thrust_max` is the thrust at full speed in standard air \[N\].
    ///
    /// # Errors
    /// [`BuildError`] naming the key of `table`.
    pub fn new(table: &str, k: ShaftConfig, thrust_max: f64) -> Result<Self, BuildError> {
        schema::check(&k, table)?;
        Ok(Self { k, thrust_max })
    }

    /// The same engine with ramps that are `scale` times as fast.
    #[must_use]
    pub(crate) fn with_ramps(mut self, scale: f64) -> Self {
        self.k.ramps = self.k.ramps.map(|ramp| scale * ramp);
        self
    }

    /// Thrust \[N\] at a speed (M176).
    #[must_use]
    pub fn thrust(&self, speed: f64) -> f64 {
        let (n, b) = (speed, self.k.square_share);
        self.thrust_max * n * n * (b + (1.0 - b) * n)
    }

    /// First and second derivative of the thrust by the speed \[N\].
    fn slopes(&self, speed: f64) -> (f64, f64) {
        let (n, b, unit) = (speed, self.k.square_share, self.thrust_max);
        (unit * n * (2.0 * b + 3.0 * (1.0 - b) * n), unit * (2.0 * b + 6.0 * (1.0 - b) * n))
    }

    /// Speed that gives a thrust \[N\]; zero without thrust.
    ///
    /// The thrust is convex in the speed: Newton's method falls from an upper bound to the root.
    #[must_use]
    pub fn speed(&self, thrust: f64) -> f64 {
        let share = thrust / self.thrust_max;
        if share <= 0.0 || !share.is_finite() {
            return 0.0;
        }
        let b = self.k.square_share;
        let mut n = (share / b).sqrt().min(libm::cbrt(share / (1.0 - b)));
        for _ in 0..STEPS {
            n -= (n * n * (b + (1.0 - b) * n) - share) / (n * (2.0 * b + 3.0 * (1.0 - b) * n));
        }
        n
    }

    /// Speed that a throttle \[%\] demands, and its inverse within 0 and 100 %.
    fn wanted(&self, throttle: f64) -> f64 {
        self.k.idle + (1.0 - self.k.idle) * throttle.clamp(0.0, 100.0) / 100.0
    }

    fn throttle(&self, wanted: f64) -> f64 {
        (100.0 * (wanted - self.k.idle) / (1.0 - self.k.idle)).clamp(0.0, 100.0)
    }

    /// Time constant for a positive or negative rate \[s\].
    fn lag(&self, rises: bool) -> f64 {
        self.k.lags[usize::from(!rises)]
    }

    /// Least and greatest acceleration that the gas gives the shaft \[1/s\].
    fn gas(&self, speed: f64) -> (f64, f64) {
        let torque = libm::pow(speed, self.k.exponent);
        let [up, down] = self.k.accelerations;
        (-down * torque, up * torque)
    }

    /// Acceleration of the shaft \[1/s\] towards a wanted speed (M176).
    fn acceleration(&self, speed: f64, wanted: f64) -> f64 {
        let (least, greatest) = self.gas(speed);
        ((wanted - speed) / self.lag(wanted > speed)).max(least).min(greatest)
    }

    /// Least and greatest thrust rate at a thrust \[N; N/s\]: what gas and the ends of the throttle allow.
    #[must_use]
    pub fn rate_range(&self, thrust: f64) -> (f64, f64) {
        let speed = self.speed(thrust);
        let (slope, _) = self.slopes(speed);
        let end = |wanted| slope * self.acceleration(speed, wanted);
        (end(self.k.idle).min(0.0), end(1.0).max(0.0))
    }

    /// Throttle \[%\] that brings the thrust rate to a command, as far as gas and the control unit allow \[N; N/s\].
    #[must_use]
    pub fn throttle_for(&self, thrust: f64, command: f64) -> Option<f64> {
        let speed = self.speed(thrust);
        let (slope, _) = self.slopes(speed);
        let (least, greatest) = self.gas(speed);
        let rate = (command / slope).max(least).min(greatest);
        rate.is_finite().then(|| self.throttle(speed + self.lag(rate > 0.0) * rate))
    }

    /// Throttle \[%\] that holds a thrust \[N\].
    #[must_use]
    pub fn steady_throttle(&self, thrust: f64) -> f64 {
        self.throttle(self.speed(thrust))
    }

    /// Least and greatest thrust acceleration \[N/s²\] at a thrust and its rate, by the ramps of the wanted speed:
    ///
    /// ```text
    /// n_w = n + τ ṅ,   n̈ = (ṅ_w − ṅ)/τ,   T̈ = T″ ṅ² + T′ n̈
    /// ```
    #[must_use]
    pub fn acceleration_range(&self, thrust: f64, thrust_rate: f64) -> (f64, f64) {
        let [up, down] = self.k.ramps;
        self.range_of(thrust, thrust_rate, |_| (-down, up))
    }

    /// The same by ramps no faster than what the gas allows, where the thrust rate ends while they last.
    #[must_use]
    pub fn lasting_range(&self, thrust: f64, thrust_rate: f64) -> (f64, f64) {
        let [up, down] = self.k.ramps;
        self.range_of(thrust, thrust_rate, |speed| {
            let (least, greatest) = self.gas(speed);
            (least.max(-down), greatest.min(up))
        })
    }

    fn range_of(&self, thrust: f64, thrust_rate: f64, ramps: impl Fn(f64) -> (f64, f64)) -> (f64, f64) {
        let speed = self.speed(thrust);
        let (slope, curvature) = self.slopes(speed);
        if slope <= 0.0 {
            return (0.0, 0.0); // an engine that stands
        }
        let (rate, (down, up)) = (thrust_rate / slope, ramps(speed));
        let at = |ramp: f64, lag: f64| curvature * rate * rate + slope * (ramp - rate) / lag;
        (at(down, self.lag(rate > 0.0)), at(up, self.lag(rate >= 0.0)))
    }

    /// Derivatives of the thrust acceleration by thrust \[1/s²\] and thrust rate \[1/s\] about a steady state, while it
    /// rises or falls.
    #[must_use]
    pub fn acceleration_slopes(&self, rises: bool) -> (f64, f64) {
        (0.0, -1.0 / self.lag(rises))
    }

    /// Speed, wanted speed and thrust rate \[N/s\] after `dt` \[s\] at a throttle \[%\].
    #[must_use]
    pub fn step(&self, speed: f64, wanted: f64, throttle: f64, dt: f64) -> (f64, f64, f64) {
        let [up, down] = self.k.ramps;
        let wanted = wanted + (self.wanted(throttle) - wanted).max(-dt * down).min(dt * up);
        let rate = self.acceleration(speed, wanted);
        let speed = (speed + dt * rate).max(0.0);
        (speed, wanted, self.slopes(speed).0 * rate)
    }
}
