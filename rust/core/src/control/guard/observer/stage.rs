//! Its stage: the unmodelled wrench is added to the momentum.

use super::{ObserverConfig, Sample};
use crate::control::guard::stage::{Stage, Tick};
use crate::control::terms::Terms;

impl Stage for ObserverConfig {
    fn name(&self) -> &'static str {
        "observer"
    }

    fn judge(&mut self, tick: &mut Tick) {
        let (observer, Terms { measurement, dynamics, momentum, .. }) =
            (&mut tick.state.observer, &mut *tick.terms);
        let sample = Sample { momentum: dynamics.momentum, rate: momentum.measured_rate };
        momentum.add_unmodelled(if measurement.has_momentum {
            observer.update(self, measurement.elapsed, sample)
        } else {
            observer.hold()
        });
    }
}
