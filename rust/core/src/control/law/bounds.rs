//! Bounds on the unknowns of the momentum QP that keep thrusts and joint positions within their limits.

use crate::exponential::tanh_f64;
use crate::linalg::dispatch_plain;
use crate::schema::NonNegative;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Bounds of the momentum QP: the bound on a rate decreases as a tanh where the value approaches its limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoundsConfig {
    /// Greatest thrust rate, by jet \[N/s\].
    #[schemars(with = "BTreeMap<String, NonNegative>")]
    pub thrust_rate_max: BTreeMap<String, f64>,
    /// Steepness at the thrust limits \[1/N\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub thrust_steepness: f64,
    /// Greatest velocity of revolute joints \[deg/s\], in place of the robot's own limits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_velocity_max_deg: Option<f64>,
    /// Steepness at the joint limits \[1/rad, 1/m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_steepness: f64,
}

/// Limited quantities whose rates are unknowns of the QP, by index of the unknown. Stored as separate arrays so that
/// the loop over all bounds vectorises.
///
/// ```text
/// −r tanh(ε (x − x_min)) ≤ ẋ ≤ r tanh(ε (x_max − x))
/// ```
///
/// Far from the limits the bounds are ±r. At a limit the rate towards it must vanish; beyond a limit the bound
/// changes sign and demands a return. `lower ≤ upper` holds for every x, because `tanh a + tanh b` has the sign of
/// `a + b = ε (x_max − x_min) ≥ 0`.
///
/// Equation M65 of `docs/model` (paper: "bounds on the input and its integral").
#[derive(Debug, Clone)]
pub struct LimitedValues {
    /// `x`.
    pub value: Vec<f64>,
    /// `x_min`.
    pub least: Vec<f64>,
    /// `x_max`.
    pub greatest: Vec<f64>,
    /// `r`.
    pub rate_max: Vec<f64>,
    /// `ε`.
    pub steepness: Vec<f64>,
}

impl LimitedValues {
    /// `count` quantities without limits on value or rate.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self {
            value: vec![0.0; count],
            least: vec![f64::NEG_INFINITY; count],
            greatest: vec![f64::INFINITY; count],
            rate_max: vec![f64::INFINITY; count],
            steepness: vec![1.0; count],
        }
    }

    /// Writes the bounds on the rates (M65).
    pub fn write_bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        let limits = self.least.iter().zip(&self.greatest).zip(self.value.iter().zip(&self.steepness));
        for ((lower, upper), ((least, greatest), (value, steepness))) in
            lower.iter_mut().zip(&mut *upper).zip(limits)
        {
            (*lower, *upper) = (steepness * (value - least), steepness * (greatest - value));
        }
        for bound in [&mut *lower, &mut *upper] {
            dispatch_plain(
                #[inline(always)]
                || {
                    for x in bound {
                        *x = tanh_f64(*x);
                    }
                },
            );
        }
        for ((lower, upper), rate_max) in lower.iter_mut().zip(upper).zip(&self.rate_max) {
            (*lower, *upper) = (-rate_max * *lower, rate_max * *upper);
        }
    }
}
