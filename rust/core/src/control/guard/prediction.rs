//! What a command lets expect: the acceleration under it, for the next tick, and its corrections.

use super::{Guard, GuardState};
use crate::control::command::Command;
use crate::control::law::contact::WRENCH;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::Vector6;

impl Guard {
    /// Predicts the acceleration under the command, for the channels of the next tick (M101):
    /// `ν̇ = M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a + J_cᵀ f_c + S τ + ŵ − h)`, with the observed wrench `ŵ` on the base.
    pub(super) fn predict_acceleration(
        &mut self,
        robot: &RobotModel,
        state: &mut GuardState,
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
        let ControllerState { guard: GuardState { channels: last, estimator, .. }, between, contact, .. } =
            state;
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
        let (last, acceleration) = (&mut state.guard.channels, &mut self.acceleration);
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
        if let Some(memory) = &mut state.guard.estimator {
            terms.reduce_torque(last.joint_torque.as_slice());
            memory.replace_command(last.thrust_rate.as_slice(), terms.acting_torque.as_slice());
        }
    }
}
