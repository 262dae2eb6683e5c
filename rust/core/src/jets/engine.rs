//! The model of a jet engine, its state, and the throttle loop that tracks a thrust rate.
//!
//! Equations M33, M34, M144 and M173 of `docs/model`.

use super::second_order::SecondOrder;
use super::shaft::Shaft;

/// An engine. Its states are thrust and thrust rate, of which speed and wanted speed of a shaft are functions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EngineModel {
    /// A polynomial (M32).
    SecondOrder(SecondOrder),
    /// An engine of the shaft's speed (M176).
    Shaft(Shaft),
}

impl From<SecondOrder> for EngineModel {
    fn from(engine: SecondOrder) -> Self {
        Self::SecondOrder(engine)
    }
}

impl EngineModel {
    /// Throttle \[%\] within the limits that brings the thrust rate to a commanded one \[N, N/s\], a second-order engine
    /// with this thrust acceleration \[N/s²\]; `None` where the throttle does not act on the thrust.
    #[must_use]
    pub fn throttle_for(
        &self,
        thrust: f64,
        thrust_rate: f64,
        command: f64,
        acceleration: f64,
    ) -> Option<f64> {
        match self {
            Self::SecondOrder(engine) => engine.throttle_for(thrust, thrust_rate, acceleration),
            Self::Shaft(engine) => engine.throttle_for(thrust, command),
        }
    }

    /// Throttle \[%\] that holds a thrust, as nearly as the limits allow.
    #[must_use]
    pub fn steady_throttle(&self, thrust: f64) -> f64 {
        match self {
            Self::SecondOrder(engine) => engine.steady_throttle(thrust),
            Self::Shaft(engine) => engine.steady_throttle(thrust),
        }
    }

    /// Thrust rate \[N/s\] after `dt` \[s\] at the throttle within the limits that brings it nearest to a commanded one.
    #[must_use]
    pub fn nearest_rate(&self, thrust: f64, thrust_rate: f64, command: f64, dt: f64) -> f64 {
        let (least, greatest) = self.acceleration_range(thrust, thrust_rate);
        let (lowest, highest) = self.rate_range(thrust);
        let command = command.max(lowest).min(highest);
        thrust_rate + (command - thrust_rate).max(dt * least).min(dt * greatest)
    }

    /// Least and greatest thrust acceleration \[N/s²\]: between the limits of the throttle, or of the ramps.
    #[must_use]
    pub fn acceleration_range(&self, thrust: f64, thrust_rate: f64) -> (f64, f64) {
        match self {
            Self::SecondOrder(engine) => engine.acceleration_range(thrust, thrust_rate),
            Self::Shaft(engine) => engine.acceleration_range(thrust, thrust_rate),
        }
    }

    /// That of inputs which may last: the rate of a shaft ends where the gas limits it.
    #[must_use]
    pub fn lasting_range(&self, thrust: f64, thrust_rate: f64) -> (f64, f64) {
        match self {
            Self::SecondOrder(engine) => engine.acceleration_range(thrust, thrust_rate),
            Self::Shaft(engine) => engine.lasting_range(thrust, thrust_rate),
        }
    }

    /// Least and greatest thrust rate \[N/s\] at a thrust; a second-order engine has no bounds.
    #[must_use]
    pub fn rate_range(&self, thrust: f64) -> (f64, f64) {
        match self {
            Self::SecondOrder(_) => (f64::NEG_INFINITY, f64::INFINITY),
            Self::Shaft(engine) => engine.rate_range(thrust),
        }
    }

    /// Derivatives of the thrust acceleration by thrust \[1/s²\] and thrust rate \[1/s\], about the steady state at a thrust;
    /// the sign of `thrust_rate` is whether it rises or falls.
    #[must_use]
    pub fn steady_slopes(&self, thrust: f64, thrust_rate: f64) -> (f64, f64) {
        match self {
            Self::SecondOrder(engine) => {
                engine.acceleration_slopes(thrust, 0.0, engine.steady_throttle(thrust))
            }
            Self::Shaft(engine) => engine.acceleration_slopes(thrust_rate >= 0.0),
        }
    }
}

/// State of one engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EngineDynamics {
    model: EngineModel,
    /// Thrust `T` \[N\].
    pub thrust: f64,
    /// Thrust rate `Ṫ` \[N/s\].
    pub thrust_rate: f64,
    /// Speed and wanted speed of a shaft, shares of the full speed.
    speeds: [f64; 2],
}

impl EngineDynamics {
    /// An engine at a thrust \[N\] and thrust rate \[N/s\].
    #[must_use]
    pub fn new(model: impl Into<EngineModel>, thrust: f64, thrust_rate: f64) -> Self {
        let model = model.into();
        let speeds = match &model {
            EngineModel::SecondOrder(_) => [0.0; 2],
            EngineModel::Shaft(shaft) => [shaft.speed(thrust); 2],
        };
        Self { model, thrust, thrust_rate, speeds }
    }

    /// The engine's equations.
    #[must_use]
    pub fn model(&self) -> &EngineModel {
        &self.model
    }

    /// Advances the engine by `dt` \[s\] at a constant throttle \[%\], limited to the engine's range.
    ///
    /// ```text
    /// second order   T ← T + Ṫ dt + T̈ dt²/2,   Ṫ ← Ṫ + T̈ dt,   T̈ at the start of the step
    /// shaft          n ← n + ṅ dt,   T = T(n)                     M176
    /// ```
    ///
    /// Source: the published simulator. The range of the thrust is left to the simulated jets. A NaN throttle results in
    /// NaN.
    pub fn step(&mut self, throttle: f64, dt: f64) {
        match &self.model {
            EngineModel::SecondOrder(engine) => {
                let acceleration = engine.thrust_acceleration(self.thrust, self.thrust_rate, throttle);
                self.thrust += dt * (self.thrust_rate + 0.5 * dt * acceleration);
                self.thrust_rate += dt * acceleration;
            }
            EngineModel::Shaft(shaft) => {
                let [mut speed, wanted] = self.speeds;
                if shaft.thrust(speed).to_bits() != self.thrust.to_bits() {
                    speed = shaft.speed(self.thrust); // a fault has replaced the thrust
                }
                let (speed, wanted, rate) = shaft.step(speed, wanted, throttle, dt);
                self.speeds = [speed, wanted];
                (self.thrust, self.thrust_rate) = (shaft.thrust(speed), rate);
            }
        }
    }
}

/// Gain of the throttle loop \[1/s\], of the published controller. The error decays only if `k_p dt < 2`; with the
/// published 1.5 it changes sign and halves every tick.
pub const RATE_GAIN: f64 = 150.0;

/// Throttle loop: feedback linearisation of an [`EngineModel`] to `T̈ = −k_p (Ṫ − Ṫ*)`, `k_p` = [`RATE_GAIN`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThrustRateController {
    /// Last throttle \[%\].
    throttle: f64,
}

impl ThrustRateController {
    /// A loop with the initial throttle \[%\].
    #[must_use]
    pub fn new(throttle: f64) -> Self {
        Self { throttle }
    }

    /// Last throttle \[%\].
    #[must_use]
    pub fn throttle(&self) -> f64 {
        self.throttle
    }

    /// Returns the throttle \[%\] for a commanded thrust rate \[N/s\].
    ///
    /// Source: the published controller. Where no throttle is found it is held, instead of a division by zero.
    pub fn update(&mut self, model: &EngineModel, thrust: f64, thrust_rate: f64, command: f64) -> f64 {
        let acceleration = RATE_GAIN * (command - thrust_rate);
        if let Some(throttle) = model.throttle_for(thrust, thrust_rate, command, acceleration) {
            self.throttle = throttle;
        }
        self.throttle
    }
}
