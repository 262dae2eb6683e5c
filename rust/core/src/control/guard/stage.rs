//! The trait of a stage of the guard, and the guard: channels and stages, in the order in which a tick calls them.

use super::channels::{Channels, ChannelsState};
use crate::control::command::Command;
use crate::control::law::contact::WRENCH;
use crate::control::law::limits::Limits;
use crate::control::measurement::{BadStart, Measurement};
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::kinematics::RobotState;
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{DVector, Vector6};
use std::fmt::Debug;

/// What the stages work on in a tick.
#[derive(Debug)]
pub struct Tick<'a> {
    /// The controller's model of the robot.
    pub robot: &'a RobotModel,
    /// Channels of the measurement.
    pub channels: &'a mut Channels,
    /// State of the controller.
    pub state: &'a mut ControllerState,
    /// Values of the tick as far as they are computed.
    pub terms: &'a mut Terms,
}

/// An optional part of the guard. A tick calls it in three places; where a stage has no function, it does nothing.
pub trait Stage: Debug + Send + Sync {
    /// Name of the stage, unique within a controller.
    fn name(&self) -> &'static str;
    /// Sets the stage's own part of the state of a controller that starts in `robot` with these thrusts \[N\].
    fn start(&self, _state: &mut ControllerState, _robot: &RobotState, _thrust: &[f64]) {}
    /// Whether its part of a state has the sizes of this stage.
    fn fits(&self, _state: &ControllerState) -> bool {
        true
    }
    /// Before the model is computed: improves the measurement.
    fn measure(&mut self, _tick: &mut Tick) {}
    /// After the model: compares it with the measurement.
    fn judge(&mut self, _tick: &mut Tick) {}
    /// After the command: what it lets expect, for the next tick.
    fn predict(&mut self, _tick: &mut Tick, _command: &Command) {}
}

/// Channels and stages of one controller, with their workspace.
#[derive(Debug)]
pub struct Guard {
    channels: Channels,
    /// In the order of the list above.
    stages: Vec<Box<dyn Stage>>,
    /// Limits of the law while the stages find nothing.
    usual: Limits,
    acceleration: DVector<f64>,
}

impl Guard {
    /// A guard with these stages, in the order in which a tick calls them; `usual` are the limits of the law while they
    /// find nothing.
    #[must_use]
    pub fn new(channels: Channels, stages: Vec<Box<dyn Stage>>, usual: Limits, robot: &RobotModel) -> Self {
        Self { channels, stages, usual, acceleration: DVector::zeros(6 + robot.joints.len()) }
    }

    /// Names of the stages.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.stages.iter().map(|stage| stage.name())
    }

    /// Channels of a controller that starts with this measurement.
    ///
    /// # Errors
    /// As [`Channels::start`].
    pub fn start_channels(&mut self, measurement: &Measurement) -> Result<ChannelsState, BadStart> {
        self.channels.start(measurement)
    }

    /// Sets the parts of the stages in the state of a controller that starts in `robot`.
    pub fn start(&self, state: &mut ControllerState, robot: &RobotState) {
        let thrust = self.channels.thrust(&state.channels).to_vec();
        state.stages = self.names().collect();
        for stage in &self.stages {
            stage.start(state, robot, &thrust);
        }
    }

    /// Whether a state has the parts and sizes of this guard.
    #[must_use]
    pub fn fits(&self, state: &ControllerState) -> bool {
        self.channels.fit_state(&state.channels)
            && self.names().eq(state.stages.iter().copied())
            && self.stages.iter().all(|stage| stage.fits(state))
    }

    /// Processes a measurement and advances the time; returns whether the measurement has the sizes of this robot.
    pub fn measure(
        &mut self,
        measurement: &Measurement,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
    ) -> bool {
        let Self { channels, stages, .. } = self;
        let is_usable = channels.fit(measurement);
        if is_usable {
            terms.estimates.read(measurement, state.wind.as_ref());
            let measurement = Measurement { wind: terms.estimates.wind, ..*measurement };
            channels.update(&mut state.channels, &measurement, &mut terms.measurement);
        } else {
            channels.update_unmeasured(&mut state.channels, measurement.time, &mut terms.measurement);
        }
        let mut tick = Tick { robot, channels, state, terms };
        for stage in stages {
            stage.measure(&mut tick);
        }
        is_usable
    }

    /// Compares the model of this tick with its measurement.
    pub fn judge(&mut self, robot: &RobotModel, state: &mut ControllerState, terms: &mut Terms) {
        terms.limits.copy_from(&self.usual);
        let mut tick = Tick { robot, channels: &mut self.channels, state, terms };
        for stage in &mut self.stages {
            stage.judge(&mut tick);
        }
    }

    /// Stores what the command of this tick lets expect in the next.
    pub fn predict(
        &mut self,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
        command: &Command,
    ) {
        self.predict_acceleration(robot, state, terms, command);
        let mut tick = Tick { robot, channels: &mut self.channels, state, terms };
        for stage in &mut self.stages {
            stage.predict(&mut tick, command);
        }
    }

    /// Predicts the acceleration under the command, for the channels of the next tick (M101):
    /// `ν̇ = M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a + J_cᵀ f_c + S τ + ŵ − h)`, with the observed wrench `ŵ` on the base.
    fn predict_acceleration(
        &mut self,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
        command: &Command,
    ) {
        terms.reduce_torque(command.joint_torque.as_slice());
        let Terms { measurement, kinematics, inverse_mass, free_acceleration, momentum, contact, .. } = terms;
        let (acceleration, acting) = (&mut self.acceleration, &terms.acting_torque);
        acceleration.fill(0.0);
        if inverse_mass.is_known {
            let wrench = &momentum.unmodelled_wrench;
            let arm = kinematics.com - kinematics.bodies[0].i_from_b.position;
            let (force, moment) = parts(wrench);
            acceleration.fixed_rows_mut::<3>(0).copy_from(&force);
            acceleration.fixed_rows_mut::<3>(3).copy_from(&(moment + arm.cross(&force)));
            acceleration.rows_mut(6, acting.len()).copy_from(acting);
            // The wrenches that keep the feet at rest, because those of an impact last for less than a tick.
            let wrenches = contact.force_of_torques.as_slice().chunks_exact(WRENCH);
            for ((foot, sole), wrench) in robot.feet.iter().zip(&contact.soles).zip(wrenches) {
                let (body, wrench) = (foot.frame.body, Vector6::from_column_slice(wrench));
                kinematics.add_generalised_wrench(body, &sole.position, &wrench, acceleration);
            }
            inverse_mass.multiply_in_place(acceleration);
            *acceleration += &*free_acceleration;
        }
        let known = &mut state.channels;
        known.acceleration.copy_from(acceleration);
        known.commanded_in.copy_from(&measurement.state);
        known.joint_torque.copy_from(&command.joint_torque);
        known.thrust_rate.copy_from(&command.thrust_rate);
        known.foot_wrenches.copy_from(&contact.force_of_torques);
    }

    /// Corrects what was predicted: the torques of `command` act for a `share` of the tick in place of the last ones.
    pub fn change_torques(
        &mut self,
        state: &mut ControllerState,
        terms: &mut Terms,
        command: &Command,
        share: f64,
    ) {
        let ControllerState { channels: last, between, estimator, contact, .. } = state;
        let is_used = terms.inverse_mass.is_known && !contact.is_active; // under load, as in `replace_command`
        let change = &mut self.acceleration;
        change.fill(0.0);
        for (joint, torque) in command.joint_torque.iter().enumerate() {
            let more = torque - between.torque[joint];
            between.torque[joint] = *torque;
            if is_used {
                last.joint_torque[joint] += share * more;
                change[6 + joint] = terms.limits.joints[joint].share() * more;
            }
        }
        if !is_used {
            return;
        }
        terms.inverse_mass.multiply_in_place(change);
        last.acceleration.axpy(share, change, 1.0);
        between.acceleration += change.rows_range(6..);
        if let Some(memory) = estimator {
            terms.reduce_torque(last.joint_torque.as_slice());
            memory.replace_command(last.thrust_rate.as_slice(), terms.acting_torque.as_slice());
        }
    }

    /// Corrects what was predicted: other thrust rates \[N/s\] and torques \[N m\] than those of the last command act. While
    /// the feet carry load, other torques change the load on the feet more than the motion of the robot: only the
    /// thrust rates are used.
    pub fn replace_command(
        &mut self,
        robot: &RobotModel,
        state: &mut ControllerState,
        terms: &mut Terms,
        thrust_rate: &[f64],
        joint_torque: &[f64],
    ) {
        let Terms { kinematics, dynamics, inverse_mass, limits, .. } = terms;
        let (last, acceleration) = (&mut state.channels, &mut self.acceleration);
        if !state.contact.is_active {
            // ν̇ is linear in the torques: it changes by M⁻¹ S (τ′ − τ). The state may be that of another tick than the
            // controller's last one.
            kinematics.update(robot, &last.commanded_in);
            dynamics.update(robot, &last.commanded_in, kinematics);
            inverse_mass.update(&dynamics.mass_matrix);
            if inverse_mass.is_known {
                acceleration.fill(0.0);
                let torques = joint_torque.iter().zip(&last.joint_torque).zip(&limits.joints);
                for (entry, ((new, old), found)) in acceleration.as_mut_slice()[6..].iter_mut().zip(torques) {
                    *entry = found.share() * (new - old);
                }
                inverse_mass.multiply_in_place(acceleration);
                last.acceleration += &*acceleration;
            }
            last.joint_torque.copy_from_slice(joint_torque);
        }
        last.thrust_rate.copy_from_slice(thrust_rate);
        state.between.replace_torque(joint_torque, last.acceleration.rows_range(6..));
        if let Some(memory) = &mut state.estimator {
            terms.reduce_torque(last.joint_torque.as_slice());
            memory.replace_command(last.thrust_rate.as_slice(), terms.acting_torque.as_slice());
        }
    }
}
