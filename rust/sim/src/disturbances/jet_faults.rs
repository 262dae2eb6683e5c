//! Faults of jets: slow response, weak thrust, failed engine.
//!
//! Separate from [`crate::jets::JetsConfig`], so that every fault can be combined with all thrust dynamics.
//!
//! Equation M41 of `docs/model`.

use crate::noise::Noise;
use flight_core::error::{BuildError, Table, place_of};
use flight_core::robot::Jet;
use flight_core::schema::{self, NonNegative};
use flight_core::timing::share;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Stream of the measurement noise.
const MEASUREMENT_STREAM: u64 = 1;

/// Faults of the jets; none by default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct JetFaultsConfig {
    /// One jet that fails.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<JetFailure>,
    /// Limit of the thrust as a fraction of the robot's greatest thrust; without it only the controller limits the
    /// thrust, as published.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub thrust_limit_scale: Option<f64>,
    /// Whether the controller's own limits are scaled as well, by `thrust_limit_scale`.
    pub limit_is_known: bool,
    /// Time constant of a first-order lag of the commanded thrust rate \[s\]; zero for none.
    #[schemars(range(min = 0))]
    pub lag: f64,
    /// Noise of the measured thrust, which only the estimators of jets with throttles use.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measurement_noise: Option<MeasurementNoise>,
    /// Ratio of the force that a jet exerts to its thrust, by name; it is 1 for jets that are not named.
    #[schemars(with = "BTreeMap<String, NonNegative>")]
    pub force_scale: BTreeMap<String, f64>,
}

/// A jet that no longer follows its command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JetFailure {
    /// Name of the jet.
    pub jet: String,
    /// Time of the failure \[s\].
    #[schemars(range(min = 0))]
    pub time: f64,
    /// Kind of the failure.
    pub kind: FailureKind,
    /// Time constant with which the thrust of a jet that is off decays \[s\]; zero for at once.
    #[serde(default)]
    #[schemars(range(min = 0))]
    pub decay: f64,
}

/// Kind of a jet failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The thrust decays to zero.
    Off,
    /// The thrust stays constant.
    Stuck,
}

/// White noise of measured thrusts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasurementNoise {
    /// Standard deviation \[N\].
    #[schemars(range(min = 0))]
    pub std: f64,
    /// Seed.
    #[serde(default)]
    pub seed: u64,
}

impl JetFaultsConfig {
    /// Checks that names and values are valid for `jets`.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected.
    pub fn check(&self, jets: &[Jet]) -> Result<(), BuildError> {
        schema::check(self, "disturbances.jets")?;
        let table = Table("disturbances.jets");
        if let Some(failure) = &self.failure {
            index_of("failure.jet", &failure.jet, jets)?;
            if failure.kind == FailureKind::Stuck {
                let expected = "0: a jet that is stuck keeps its thrust";
                table.check("failure.decay", failure.decay, |t| t == 0.0, expected)?;
            }
        }
        if let Some(scale) = self.thrust_limit_scale {
            for jet in jets {
                let expected =
                    format!("a factor that leaves jet `{}` more than {} N", jet.name, jet.thrust_min);
                let is_above = |scale| scale * jet.thrust_max > jet.thrust_min;
                table.check("thrust_limit_scale", scale, is_above, &expected)?;
            }
        } else if self.limit_is_known {
            let expected = "false without disturbances.jets.thrust_limit_scale";
            return Err(BuildError::bad_value("disturbances.jets.limit_is_known", true, expected));
        }
        self.force_scale.keys().try_for_each(|jet| index_of("force_scale", jet, jets).map(|_| ()))
    }

    /// Scales the limits in the controller's model, if `limit_is_known`.
    pub fn apply_known_limits(&self, jets: &mut [Jet]) {
        if let (true, Some(scale)) = (self.limit_is_known, self.thrust_limit_scale) {
            for jet in jets {
                jet.thrust_max *= scale;
            }
        }
    }
}

/// Index of a jet in every thrust vector.
fn index_of(key: &str, name: &str, jets: &[Jet]) -> Result<usize, BuildError> {
    place_of(format!("disturbances.jets.{key}"), name, jets.iter().map(|jet| &jet.name))
}

/// State of the faults.
#[derive(Debug, Clone)]
pub struct JetFaults {
    /// Lag between the command and the jets.
    pub response: Response,
    /// Noise between the jets and their estimators.
    pub sensor: Sensor,
    /// Least and greatest thrust of each jet \[N\]; infinite without a limit.
    limits: Vec<(f64, f64)>,
    /// Ratio of each jet's force to its thrust.
    force_scale: Vec<f64>,
    failing: Option<Failing>,
}

/// A lag of the thrust rate.
#[derive(Debug, Clone)]
pub struct Response {
    lag: f64,
    command: Vec<f64>,
}

impl Response {
    /// Thrust rates \[N/s\] that reach the jets if `command` is commanded for the next `dt` \[s\].
    pub fn delay_rates(&mut self, command: &[f64], dt: f64) -> &[f64] {
        for (delayed, command) in self.command.iter_mut().zip(command) {
            let share = share(dt / self.lag);
            *delayed = if share < 1.0 { *delayed + (command - *delayed) * share } else { *command };
        }
        &self.command[..command.len().min(self.command.len())]
    }
}

/// A thrust sensor with white noise.
#[derive(Debug, Clone)]
pub struct Sensor {
    std: f64,
    noise: Noise,
}

impl Sensor {
    /// Measured value of a thrust \[N\].
    pub fn measure_thrust(&mut self, thrust: f64) -> f64 {
        if self.std > 0.0 { thrust + self.std * self.noise.normal() } else { thrust }
    }
}

#[derive(Debug, Clone)]
struct Failing {
    jet: usize,
    kind: FailureKind,
    decay: f64,
    /// Time until the failure \[s\]; negative afterwards.
    left: f64,
    /// Thrust at the failure \[N\].
    thrust: Option<f64>,
}

impl JetFaults {
    /// Checks the faults and prepares them for `jets`.
    ///
    /// # Errors
    /// As [`JetFaultsConfig::check`].
    pub fn new(config: &JetFaultsConfig, jets: &[Jet]) -> Result<Self, BuildError> {
        config.check(jets)?;
        let failing = |failure: &JetFailure| {
            Ok(Failing {
                jet: index_of("failure.jet", &failure.jet, jets)?,
                kind: failure.kind,
                decay: failure.decay,
                left: failure.time,
                thrust: None,
            })
        };
        let limit_scale = config.thrust_limit_scale.unwrap_or(f64::INFINITY);
        let (std, seed) = config.measurement_noise.as_ref().map_or((0.0, 0), |noise| (noise.std, noise.seed));
        Ok(Self {
            response: Response { lag: config.lag, command: vec![0.0; jets.len()] },
            sensor: Sensor { std, noise: Noise::new(seed, MEASUREMENT_STREAM) },
            limits: jets.iter().map(|jet| (jet.thrust_min, jet.thrust_max * limit_scale)).collect(),
            force_scale: jets
                .iter()
                .map(|jet| config.force_scale.get(&jet.name).copied().unwrap_or(1.0))
                .collect(),
            failing: config.failure.as_ref().map(failing).transpose()?,
        })
    }

    /// Ratio of the force that a jet exerts to its thrust.
    #[must_use]
    pub fn force_scale(&self, jet: usize) -> f64 {
        self.force_scale[jet]
    }

    /// Limits thrust \[N\] and thrust rate \[N/s\] of a jet after a step of `dt` \[s\], and applies its failure.
    /// Call once per step and jet.
    pub fn limit_thrust(&mut self, jet: usize, thrust: f64, thrust_rate: f64, dt: f64) -> (f64, f64) {
        let (mut thrust, mut thrust_rate) = (thrust, thrust_rate);
        let (least, greatest) = self.limits[jet];
        // Comparisons, because `f64::max` would hide a NaN.
        if thrust < least {
            (thrust, thrust_rate) = (least, thrust_rate.max(0.0));
        }
        if thrust > greatest {
            (thrust, thrust_rate) = (greatest, thrust_rate.min(0.0));
        }
        let Some(failing) = self.failing.as_mut().filter(|failing| failing.jet == jet) else {
            return (thrust, thrust_rate);
        };
        failing.left -= dt;
        // Half a step absorbs rounding in the sum of the steps.
        if failing.left > -0.5 * dt {
            return (thrust, thrust_rate);
        }
        let held = *failing.thrust.get_or_insert(thrust);
        match failing.kind {
            FailureKind::Stuck => (held, 0.0),
            FailureKind::Off if failing.decay > 0.0 => {
                let thrust = held * libm::exp(failing.left / failing.decay);
                (thrust, -thrust / failing.decay)
            }
            FailureKind::Off => (0.0, 0.0),
        }
    }
}
