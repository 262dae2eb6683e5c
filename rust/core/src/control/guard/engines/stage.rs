//! Its stage: limits of the thrusts, and sensors that are no longer used.

use super::{EngineSample, EngineState, Engines};
use crate::control::guard::stage::{Stage, Tick};
use crate::control::measurement::UsedMeasurement;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::kinematics::RobotState;

impl Stage for Engines {
    fn name(&self) -> &'static str {
        "engines"
    }

    fn start(&self, state: &mut ControllerState, _: &RobotState, _: &[f64]) {
        state.engines = Engines::start(self);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { engines, observer, channels, contact, .. } = &mut *tick.state;
        let Terms { measurement, momentum, limits, .. } = &mut *tick.terms;
        let UsedMeasurement { thrust, thrust_innovation, sensor_error, elapsed, has_momentum, modes, .. } =
            &mut *measurement;
        let is_measured = !modes.contains(Modes::THRUST_MODELLED);
        let samples = |jet: usize| EngineSample {
            thrust: thrust[jet],
            innovation: thrust_innovation[jet],
            is_measured,
            command: channels.thrust_rate[jet],
        };
        let residual = has_momentum.then_some((&momentum.a_t, &observer.residual));
        self.update(engines, *elapsed, samples, residual, sensor_error);
        for (jet, error) in sensor_error.iter().enumerate() {
            if let Some(error) = error {
                tick.channels.reject_sensor(channels, jet, *error);
            }
        }
        if engines.iter().any(EngineState::is_limited) {
            measurement.modes.insert(Modes::ENGINE_LIMITED);
        }
        channels.is_descending |= self.limit(engines, contact.is_active, limits);
    }
}
