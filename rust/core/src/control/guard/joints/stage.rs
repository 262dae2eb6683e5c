//! Its stage: the residual of a tick, and the limits that follow from what is found.

use super::{JointsConfig, JointsState, Sample, modes};
use crate::control::command::Command;
use crate::control::guard::channels::ChannelsState;
use crate::control::guard::stage::{Stage, Tick};
use crate::control::law::limits::JointCondition;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::kinematics::RobotState;
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::DVector;

/// Finds joints that do not follow their torques, and bounds what the law demands of them.
#[derive(Debug, Clone)]
pub struct Joints {
    config: JointsConfig,
    time_step: f64,
    /// Stops of the joints, lower and upper \[rad, m\].
    stops: Vec<(f64, f64)>,
    unexplained: DVector<f64>,
    residual: DVector<f64>,
}

impl Joints {
    /// The stage for the joints of `robot`, with ticks every `time_step` \[s\].
    #[must_use]
    pub fn new(config: JointsConfig, robot: &RobotModel, time_step: f64) -> Self {
        let stops: Vec<_> = robot.joints.iter().map(|joint| joint.stops).collect();
        let rows = DVector::zeros(6 + stops.len());
        Self { config, time_step, stops, unexplained: rows.clone(), residual: rows }
    }

    /// `r` of a tick.
    fn update(&mut self, terms: &Terms, last: &ChannelsState) {
        let Terms { measurement: used, dynamics, kinematics, momentum, .. } = terms;
        let velocities = used.state.velocity.iter().zip(&last.commanded_in.velocity);
        for ((to, (now, before)), predicted) in
            self.unexplained.iter_mut().zip(velocities).zip(&last.acceleration)
        {
            *to = (now - before) / used.elapsed - predicted;
        }
        self.residual.gemv(1.0, &dynamics.mass_matrix, &self.unexplained, 0.0);
        let (force, moment) = parts(&momentum.unmodelled_wrench);
        let arm = kinematics.com - kinematics.bodies[0].i_from_b.position;
        let mut rows = self.residual.fixed_rows_mut::<3>(0);
        rows += force;
        let mut rows = self.residual.fixed_rows_mut::<3>(3);
        rows += moment + arm.cross(&force);
    }
}

impl Stage for Joints {
    fn name(&self) -> &'static str {
        "joints"
    }

    fn start(&self, state: &mut ControllerState, robot: &RobotState, _: &[f64]) {
        state.joints = Some(JointsState::new(&robot.joint_position));
    }

    fn fits(&self, state: &ControllerState) -> bool {
        state.joints.as_ref().is_some_and(|joints| joints.fits(self.stops.len()))
    }

    fn measure(&mut self, tick: &mut Tick) {
        let Some(joints) = &mut tick.state.joints else { return };
        let used = &tick.terms.measurement;
        if used.modes.contains(Modes::BEGUN_AGAIN) {
            joints.begin_again(&used.state.joint_position);
        }
        let is_measured = !used.modes.contains(Modes::JOINTS_PREDICTED);
        joints.measure(&used.state.joint_position, is_measured, used.elapsed);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { joints, channels, contact, velocity_error_integral, .. } = &mut *tick.state;
        let Some(joints) = joints else { return };
        let used = &tick.terms.measurement;
        if used.has_momentum && tick.terms.inverse_mass.is_known && !contact.is_active {
            self.update(tick.terms, channels);
            let (residual, torque, stops) = (&self.residual, &channels.joint_torque, &self.stops[..]);
            joints.judge(&self.config, &Sample { dt: used.elapsed, residual, torque, stops });
        } else {
            joints.hold();
        }
        let Terms { measurement: used, limits, .. } = &mut *tick.terms;
        limits.joints.copy_from_slice(&joints.found);
        for (joint, found) in joints.found.iter().enumerate() {
            limits.joint_velocity[joint] = found.velocity_max(limits.joint_velocity[joint]);
            if matches!(found, JointCondition::Stuck | JointCondition::Free) {
                velocity_error_integral[joint] = 0.0; // it follows no velocity
            }
        }
        used.modes.insert(modes(&joints.found));
    }

    fn predict(&mut self, tick: &mut Tick, command: &Command) {
        if let Some(joints) = &mut tick.state.joints {
            joints.command(&command.joint_velocity, self.time_step);
        }
    }
}
