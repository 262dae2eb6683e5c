//! Its stage: the wind of the next tick from the wrench of this one.

use super::WindObserver;
use crate::control::command::Command;
use crate::control::guard::stage::{Stage, Tick};
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::kinematics::RobotState;

impl Stage for WindObserver {
    fn name(&self) -> &'static str {
        "wind observer"
    }

    fn start(&self, state: &mut ControllerState, _: &RobotState, _: &[f64]) {
        state.wind = Some(WindObserver::start(self));
    }

    fn predict(&mut self, tick: &mut Tick, _: &Command) {
        let Terms { measurement, kinematics, dynamics, momentum, contact, .. } = &*tick.terms;
        if let Some(wind) = &mut tick.state.wind {
            self.update(wind, measurement, kinematics, &dynamics.momentum, &momentum.a_t, &contact.soles);
        }
    }
}
