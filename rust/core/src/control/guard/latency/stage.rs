//! Its stage: compares commands and responses of a tick.

use super::{LatencyMonitor, Sample};
use crate::control::guard::stage::{Stage, Tick};
use crate::control::law::limits::JointCondition;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::kinematics::RobotState;

impl Stage for LatencyMonitor {
    fn name(&self) -> &'static str {
        "latency"
    }

    fn start(&self, state: &mut ControllerState, robot: &RobotState, thrust: &[f64]) {
        state.latency = Some(LatencyMonitor::start(self, &robot.joint_position, thrust.len()));
    }

    fn fits(&self, state: &ControllerState) -> bool {
        state.latency.as_ref().is_some_and(|latency| LatencyMonitor::fits(self, latency))
    }

    fn measure(&mut self, tick: &mut Tick) {
        let Some(latency) = &mut tick.state.latency else { return };
        let used = &tick.terms.measurement;
        let accepted = |mode| !used.modes.contains(mode) && !used.modes.contains(Modes::BEGUN_AGAIN);
        let position = accepted(Modes::JOINTS_PREDICTED).then(|| used.state.joint_position.as_slice());
        let thrust = accepted(Modes::THRUST_MODELLED).then_some(&used.thrust[..]);
        LatencyMonitor::measure(self, latency, position, thrust, used.elapsed);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { latency, channels, contact, estimator, .. } = &mut *tick.state;
        let Some(latency) = latency else { return };
        tick.terms.reduce_torque(channels.joint_torque.as_slice());
        let Terms { measurement: used, inverse_mass, limits, acting_torque, .. } = &mut *tick.terms;
        let is_comparable = used.has_momentum
            && inverse_mass.is_known
            && !contact.is_active
            && !used.modes.contains(Modes::FEET_PREDICTED)
            && !limits.joints.contains(&JointCondition::Stuck);
        let sample = Sample {
            acceleration: &channels.acceleration.as_slice()[6..],
            gain: &inverse_mass.joint_gain,
            torque: acting_torque,
            thrust_rate: channels.thrust_rate.as_slice(),
        };
        self.compare(latency, &sample, is_comparable);
        let measured = self.measured(latency);
        let late = self.are_late(latency, measured, used.elapsed);
        if late.contains(&true) {
            used.modes.insert(Modes::LATE);
        }
        if let (true, Some(estimator), Some(torque)) = (late[0], estimator, measured[0]) {
            estimator.use_torque_latency(torque);
        }
        tick.terms.measured_latency = measured;
    }
}
