//! Its stage: the state that the measurement is replaced by.

use super::Estimator;
use crate::control::command::Command;
use crate::control::guard::stage::{Stage, Tick};
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::kinematics::RobotState;

impl Stage for Estimator {
    fn name(&self) -> &'static str {
        "estimator"
    }

    fn start(&self, state: &mut ControllerState, robot: &RobotState, thrust: &[f64]) {
        state.estimator = Some(Estimator::start(self, robot, thrust));
    }

    fn fits(&self, state: &ControllerState) -> bool {
        state.estimator.as_ref().is_some_and(|memory| Estimator::fits(self, memory))
    }

    fn measure(&mut self, tick: &mut Tick) {
        let (Some(memory), channels) = (&mut tick.state.estimator, &mut *tick.channels) else { return };
        let Terms { estimates, measurement: used, .. } = &mut *tick.terms;
        channels.select_accepted(&tick.state.channels, &mut estimates.reading);
        if used.pause > 0.0 || used.modes.contains(Modes::BEGUN_AGAIN) {
            memory.restart();
        }
        let (innovation, rate) = (&mut used.thrust_innovation, &mut used.thrust_rate);
        self.update(memory, &mut estimates.reading, used.elapsed, innovation, rate);
        channels.replace(&mut estimates.reading, used);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let Some(memory) = &mut tick.state.estimator else { return };
        for (jet, error) in tick.terms.measurement.sensor_error.iter().enumerate() {
            if let Some(error) = error {
                memory.correct_thrust(jet, *error);
            }
        }
    }

    fn predict(&mut self, tick: &mut Tick, command: &Command) {
        let Some(memory) = &mut tick.state.estimator else { return };
        let Terms { momentum, measurement: used, contact, acting_torque, .. } = &*tick.terms;
        memory.command(
            command.thrust_rate.as_slice(),
            acting_torque.as_slice(),
            &momentum.unmodelled_wrench,
            &used.wind,
            contact.force_of_torques.as_slice(),
        );
    }
}
