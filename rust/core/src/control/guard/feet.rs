//! The stage that decides whether the feet carry load, and adds them to the momentum. Equation M114 of `docs/model`.

use super::observer::ObserverState;
use super::stage::{Stage, Tick};
use crate::control::law::contact::add_wrenches;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;

/// Decides whether the feet carry load, and adds them to the momentum.
#[derive(Debug, Clone)]
pub struct Feet {
    /// Time between two ticks \[s\].
    pub time_step: f64,
}

impl Stage for Feet {
    fn name(&self) -> &'static str {
        "feet"
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { contact: feet, channels, observer, setpoint: following, .. } = &mut *tick.state;
        let Terms { measurement, setpoint, kinematics, dynamics, momentum, contact, .. } = &mut *tick.terms;
        let climb = setpoint.com_position.z - kinematics.com.z;
        // During a descent the robot must not take off.
        let climb = if channels.is_descending { climb.min(0.0) } else { climb };
        let are_measured = !measurement.modes.contains(Modes::FEET_PREDICTED);
        let unmodelled = observer.wrench[2] + observer.residual[2];
        let carry_unknown = contact.carry_unknown(feet, are_measured, climb, unmodelled, measurement.elapsed);
        if carry_unknown {
            // The observed wrench is the load of the feet.
            *observer = ObserverState::default();
            if are_measured {
                tick.channels.reject_feet(channels, measurement);
            }
        }
        contact.update(
            feet,
            tick.robot,
            kinematics,
            dynamics,
            &measurement.foot_wrenches,
            climb,
            -momentum.rate_estimate[2],
            carry_unknown,
            self.time_step,
        );
        contact.force_of_torques.copy_from(&feet.force);
        // Predicted wrenches of loaded feet are not a measurement of the acting forces.
        measurement.has_momentum &= !(feet.is_active && measurement.modes.contains(Modes::FEET_PREDICTED));
        add_wrenches(
            &contact.soles,
            &measurement.foot_wrenches,
            &kinematics.com,
            &mut momentum.measured_rate,
        );
        if feet.is_active {
            momentum.add_contact(tick.robot, kinematics, dynamics, &contact.soles, &feet.force);
            if let Some(height) = contact.stand_height() {
                following.keep_above(kinematics.com.z - height);
            }
        }
    }
}
