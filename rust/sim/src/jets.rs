//! The simulated jet engines: thrust from the commanded thrust rate.
//!
//! ```text
//! thrust_rate_command ──Jets::advance──► thrust (physics),  thrust_feedback (controller)
//! ```
//!
//! Three dynamics: `ideal` follows the command exactly, as in every published flight; `throttled` is an
//! [`EngineModel`] with the throttle loop that the real robot needs, and, without a shaft, its thrust estimator;
//! `measured` is a network's table, whose throttle is that of the rate nearest to the command.
//!
//! Thrust is never below the least of a running engine, unless a fault stops the engine.
//!
//! Equation M31 of `docs/model`.

use crate::disturbances::{JetFaults, JetFaultsConfig};
use crate::turbine::TurbineConfig;
use flight_core::error::{BuildError, check};
use flight_core::jets::{
    EngineDynamics, EngineModel, SecondOrder, Shaft, ShaftConfig, ThrustEkf, ThrustRateController,
};
use flight_core::robot::Jet;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Dynamics of the thrust under a commanded thrust rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "dynamics", rename_all = "snake_case", deny_unknown_fields)]
pub enum JetsConfig {
    /// Thrust is the integral of the command.
    // With braces, because serde accepts unknown keys after a unit variant.
    Ideal {},
    /// Identified engines with a throttle loop.
    Throttled(ThrottledConfig),
    /// A network's table of a turbine, partly extrapolated, the same for every jet.
    Measured(TurbineConfig),
}

impl JetsConfig {
    /// Value of the key `dynamics`.
    #[must_use]
    pub fn dynamics(&self) -> &'static str {
        match self {
            Self::Ideal {} => "ideal",
            Self::Throttled(_) => "throttled",
            Self::Measured(_) => "measured",
        }
    }
}

/// Parameters of the engines; the defaults are the published ones.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ThrottledConfig {
    /// Thrust that the flight controller receives; the throttle loop always uses the estimate.
    pub feedback: ThrustFeedback,
    /// Engine of each jet, by name; by default those of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub engines: Option<Vec<String>>,
    /// Engines of the shaft's speed in place of them: at full speed they give the greatest thrusts of the jets.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shaft: Option<ShaftConfig>,
}

/// Thrust that the flight controller receives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ThrustFeedback {
    /// The true thrust, without noise.
    #[default]
    Measured,
    /// The estimate of the [`ThrustEkf`].
    Estimated,
    /// None but the speed of the shaft; errors of thrust sensors and their outages are then those of the thrust at this
    /// speed.
    Speed,
}

/// One second-order jet: the engine, its throttle loop and its estimator.
#[derive(Debug, Clone)]
struct ThrottledEngine {
    engine: EngineDynamics,
    controller: ThrustRateController,
    /// None with a shaft, whose speed is known.
    ekf: Option<ThrustEkf>,
}

impl ThrottledEngine {
    /// Thrust \[N\] and thrust rate \[N/s\] that the throttle loop takes for the engine's.
    fn known(&self) -> (f64, f64) {
        let of_engine = (self.engine.thrust, self.engine.thrust_rate);
        self.ekf.as_ref().map_or(of_engine, |ekf| (ekf.thrust(), ekf.thrust_rate()))
    }
}

/// Dynamics of the thrusts.
#[derive(Debug, Clone)]
enum Dynamics {
    Ideal,
    Throttled { jets: Vec<ThrottledEngine>, feedback: ThrustFeedback },
    Measured { map: TurbineConfig, throttle: Vec<f64> },
}

/// The jets of a robot and their present thrust.
#[derive(Debug, Clone)]
pub struct Jets {
    dynamics: Dynamics,
    faults: JetFaults,
    thrust: Vec<f64>,
    thrust_rate: Vec<f64>,
    /// Empty for ideal dynamics.
    estimate: Vec<f64>,
}

impl Jets {
    /// Jets at `initial_thrust` \[N\], in the order of `jets`, with thrust rate zero.
    ///
    /// # Errors
    /// The thrust of a jet is missing or not finite; for second-order dynamics also an engine that does not exist.
    pub fn new(
        config: &JetsConfig,
        jets: &[Jet],
        engines: &BTreeMap<String, SecondOrder>,
        initial_thrust: &[f64],
    ) -> Result<Self, BuildError> {
        check_one_per_jet("initial_thrust", initial_thrust.len(), jets)?;
        for (jet, thrust) in jets.iter().zip(initial_thrust) {
            let item = format!("initial thrust of jet `{}`", jet.name);
            check(&item, *thrust, |_| true, "a finite force in N")?;
        }
        let mut new = Self {
            dynamics: Dynamics::Ideal,
            faults: JetFaults::new(&JetFaultsConfig::default(), jets)?,
            thrust: initial_thrust.to_vec(),
            thrust_rate: vec![0.0; jets.len()],
            estimate: Vec::new(),
        };
        let config = match config {
            JetsConfig::Ideal {} => return Ok(new),
            JetsConfig::Measured(map) => {
                map.check()?;
                let throttle = initial_thrust.iter().map(|thrust| map.nearest(*thrust, 0.0).0).collect();
                new.dynamics = Dynamics::Measured { map: map.clone(), throttle };
                return Ok(new);
            }
            JetsConfig::Throttled(config) => config,
        };
        if let Some(names) = &config.engines {
            check_one_per_jet("engines", names.len(), jets)?;
            if config.shaft.is_some() {
                let expected = "none beside simulator.jets.shaft";
                return Err(BuildError::bad_value("simulator.jets.engines", format!("{names:?}"), expected));
            }
        }
        if config.feedback == ThrustFeedback::Speed && config.shaft.is_none() {
            let expected = "measured or estimated without simulator.jets.shaft";
            return Err(BuildError::bad_value("simulator.jets.feedback", "speed", expected));
        }
        let jets: Vec<ThrottledEngine> = jets
            .iter()
            .zip(initial_thrust)
            .enumerate()
            .map(|(i, (jet, &thrust))| {
                let named = config.engines.as_ref().and_then(|names| names.get(i));
                let model = match (&config.shaft, named) {
                    (Some(shaft), _) => {
                        EngineModel::Shaft(Shaft::new("simulator.jets.shaft", *shaft, jet.thrust_max)?)
                    }
                    (None, None) => jet.engine,
                    (None, Some(name)) => (*engines.get(name).ok_or_else(|| {
                        BuildError::unknown_name(
                            format!("engine of jet `{}`", jet.name),
                            name,
                            engines.keys(),
                        )
                    })?)
                    .into(),
                };
                let throttle = model.steady_throttle(thrust);
                Ok(ThrottledEngine {
                    engine: EngineDynamics::new(model, thrust, 0.0),
                    controller: ThrustRateController::new(throttle),
                    ekf: match model {
                        EngineModel::SecondOrder(engine) => Some(ThrustEkf::new(engine, thrust)),
                        EngineModel::Shaft(_) => None,
                    },
                })
            })
            .collect::<Result<_, BuildError>>()?;
        new.estimate = jets.iter().map(|jet| jet.known().0).collect();
        new.dynamics = Dynamics::Throttled { jets, feedback: config.feedback };
        Ok(new)
    }

    /// Returns these jets with faults.
    ///
    /// # Errors
    /// As [`JetFaultsConfig::check`]; also measurement noise without an estimator that uses the measurement.
    pub fn with_faults(mut self, config: &JetFaultsConfig, jets: &[Jet]) -> Result<Self, BuildError> {
        if config.measurement_noise.is_some() && !matches!(self.dynamics, Dynamics::Throttled { .. }) {
            let of = if matches!(self.dynamics, Dynamics::Ideal) { "ideal" } else { "measured" };
            return Err(BuildError::bad_value(
                "simulator.jets.dynamics",
                of,
                "second_order, whose estimators disturbances.jets.measurement_noise disturbs",
            ));
        }
        self.faults = JetFaults::new(config, jets)?;
        Ok(self)
    }

    /// Advances every jet by `dt` \[s\] with constant commanded thrust rates \[N/s\].
    ///
    /// Ideal: `T ← max(T_min, T + Ṫ* dt)`; upper bounds are left to the controller. Measured: the same with the rate of the
    /// map nearest to the command. Second order: throttle from the present estimate, then estimator and engine over `dt`. Faults act on the command before and on the thrust
    /// after. A jet without a command does not change. Does not allocate.
    pub fn advance(&mut self, thrust_rate_command: &[f64], dt: f64) {
        let commands = self.faults.response.delay_rates(thrust_rate_command, dt);
        match &mut self.dynamics {
            Dynamics::Ideal => {
                let jets = self.thrust.iter_mut().zip(&mut self.thrust_rate);
                for ((thrust, thrust_rate), &command) in jets.zip(commands) {
                    (*thrust, *thrust_rate) = (*thrust + dt * command, command);
                }
            }
            Dynamics::Measured { map, throttle } => {
                let jets = self.thrust.iter_mut().zip(&mut self.thrust_rate).zip(throttle);
                for (((thrust, thrust_rate), throttle), &command) in jets.zip(commands) {
                    (*throttle, *thrust_rate) = map.nearest(*thrust, command);
                    *thrust += dt * *thrust_rate;
                }
            }
            Dynamics::Throttled { jets, .. } => {
                let thrusts = self.thrust.iter_mut().zip(&mut self.thrust_rate);
                let jets = jets.iter_mut().zip(thrusts.zip(&mut self.estimate));
                for ((jet, ((thrust, thrust_rate), estimate)), &command) in jets.zip(commands) {
                    let (known, rate) = jet.known();
                    let throttle = jet.controller.update(jet.engine.model(), known, rate, command);
                    if let Some(ekf) = &mut jet.ekf {
                        ekf.update(self.faults.sensor.measure_thrust(jet.engine.thrust), throttle, dt);
                    }
                    jet.engine.step(throttle, dt);
                    *thrust = jet.engine.thrust;
                    *thrust_rate = jet.engine.thrust_rate;
                    *estimate = jet.known().0;
                }
            }
        }
        for jet in 0..self.thrust.len() {
            let given = self.faults.limit_thrust(jet, self.thrust[jet], self.thrust_rate[jet], dt);
            (self.thrust[jet], self.thrust_rate[jet]) = given;
            if let Dynamics::Throttled { jets, .. } = &mut self.dynamics {
                (jets[jet].engine.thrust, jets[jet].engine.thrust_rate) = given;
            }
        }
    }

    /// True thrust \[N\] of each jet.
    #[must_use]
    pub fn thrust(&self) -> &[f64] {
        &self.thrust
    }

    /// Force that a jet exerts along its axis \[N\].
    #[must_use]
    pub fn force(&self, jet: usize) -> f64 {
        self.thrust[jet] * self.faults.force_scale(jet)
    }

    /// Thrust that the flight controller receives \[N\], of each jet.
    #[must_use]
    pub fn thrust_feedback(&self) -> &[f64] {
        match self.dynamics {
            Dynamics::Throttled { feedback: ThrustFeedback::Estimated, .. } => &self.estimate,
            _ => &self.thrust,
        }
    }

    /// Engines whose speed the flight controller receives in place of the thrust, by jet; empty if it does not.
    #[must_use]
    pub fn measured_shafts(&self) -> Vec<Shaft> {
        let Dynamics::Throttled { jets, feedback: ThrustFeedback::Speed } = &self.dynamics else {
            return Vec::new();
        };
        let shaft = |jet: &ThrottledEngine| match jet.engine.model() {
            EngineModel::Shaft(shaft) => Some(*shaft),
            EngineModel::SecondOrder(_) => None,
        };
        jets.iter().filter_map(shaft).collect()
    }

    /// True thrust rate \[N/s\] of each jet; for ideal dynamics the last command, or zero at zero thrust.
    #[must_use]
    pub fn thrust_rate(&self) -> &[f64] {
        &self.thrust_rate
    }

    /// Throttle of the last step \[%\] of each jet; initially that which holds the initial thrust. Empty for
    /// ideal dynamics, which have no throttle.
    #[must_use]
    pub fn throttle(&self) -> Vec<f64> {
        match &self.dynamics {
            Dynamics::Ideal => Vec::new(),
            Dynamics::Throttled { jets, .. } => jets.iter().map(|jet| jet.controller.throttle()).collect(),
            Dynamics::Measured { throttle, .. } => throttle.clone(),
        }
    }
}

/// Checks that a list has one entry for each jet.
fn check_one_per_jet(item: &str, count: usize, jets: &[Jet]) -> Result<(), BuildError> {
    if count == jets.len() {
        return Ok(());
    }
    let names: Vec<&str> = jets.iter().map(|jet| jet.name.as_str()).collect();
    Err(BuildError::bad_value(
        item,
        format!("{count} entries long"),
        format!("{} entries, one per jet ({})", jets.len(), names.join(", ")),
    ))
}
