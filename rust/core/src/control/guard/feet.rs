//! Whether the feet carry load, which is then a part of the momentum. Equation M114 of `docs/model`.

use super::observer::ObserverState;
use super::{Guard, GuardState};
use crate::control::law::contact::{ContactState, add_wrenches};
use crate::control::law::setpoint::SetpointState;
use crate::control::modes::Modes;
use crate::control::terms::Terms;
use crate::robot::RobotModel;

impl Guard {
    /// Decides whether the feet carry load, and adds them to the momentum.
    pub(super) fn place_feet(
        &self,
        robot: &RobotModel,
        state: &mut GuardState,
        feet: &mut ContactState,
        followed: &mut SetpointState,
        terms: &mut Terms,
    ) {
        let GuardState { channels, observer, .. } = state;
        let Terms { measurement, setpoint, kinematics, dynamics, momentum, contact, .. } = terms;
        let climb = setpoint.com_position.z - kinematics.com.z;
        // During a descent the robot must not take off.
        let climb = if channels.is_descending { climb.min(0.0) } else { climb };
        let are_measured = !measurement.modes.contains(Modes::FEET_PREDICTED);
        let unmodelled = observer.as_ref().map_or(0.0, |of| of.wrench[2] + of.residual[2]);
        let carry_unknown = contact.carry_unknown(feet, are_measured, climb, unmodelled, measurement.elapsed);
        if carry_unknown {
            // The observed wrench is the load of the feet.
            *observer = observer.map(|_| ObserverState::default());
            if are_measured {
                self.channels.reject_feet(channels, measurement);
            }
        }
        contact.update(
            feet,
            robot,
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
        if feet.is_active && measurement.modes.contains(Modes::FEET_PREDICTED) {
            (measurement.has_momentum, measurement.gap) = (false, f64::INFINITY);
        }
        let (wrenches, com) = (&measurement.foot_wrenches, &kinematics.com);
        add_wrenches(&contact.soles, wrenches, com, &mut momentum.measured_rate);
        if feet.is_active {
            momentum.add_contact(robot, kinematics, dynamics, &contact.soles, &feet.force);
            if let Some(height) = contact.stand_height() {
                followed.keep_above(kinematics.com.z - height);
            }
        }
    }
}
