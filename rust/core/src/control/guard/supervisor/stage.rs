//! Its stage: straying flights are reported.

use super::{Errors, SupervisorConfig};
use crate::control::guard::stage::{Stage, Tick};
use crate::control::modes::Modes;
use crate::control::terms::Terms;

impl Stage for SupervisorConfig {
    fn name(&self) -> &'static str {
        "supervisor"
    }

    fn judge(&mut self, tick: &mut Tick) {
        let Terms { measurement, due, kinematics, dynamics, .. } = &mut *tick.terms;
        let errors = Errors::ahead(self.horizon, &measurement.state, kinematics, dynamics, due);
        if self.update(&mut tick.state.exceeded, measurement.elapsed, &errors) {
            measurement.modes.insert(Modes::STRAYING);
        }
    }
}
