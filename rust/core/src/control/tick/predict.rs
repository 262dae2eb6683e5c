//! What a command lets expect: the acceleration under it, for the next tick, and its corrections.

use super::Controller;
use crate::control::law::contact::WRENCH;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use nalgebra::Vector6;

impl Controller {
    /// Stores the command, and what it lets expect in the next tick.
    pub(super) fn predict(&mut self, state: &mut ControllerState) {
        self.predict_acceleration(state);
        let Terms { kinematics, dynamics, momentum, contact, .. } = &self.terms;
        let ControllerState { estimate, acting, wind, .. } = state;
        if let Some((observer, wind)) = self.wind.as_mut().zip(wind.as_mut()) {
            observer.update(wind, estimate, kinematics, &dynamics.momentum, &momentum.a_t, &contact.soles);
        }
        self.detectors.command(&mut state.detectors, &self.command);
        if let Some(memory) = &mut state.estimator {
            memory.command(acting, &momentum.unmodelled_wrench, &estimate.robot.wind);
        }
    }

    /// Predicts the acceleration under the command, for the channels of the next tick (M101):
    /// `ν̇ = M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a + J_cᵀ f_c + S τ − h)`, and what the observed wrench gives the robot as one body.
    fn predict_acceleration(&mut self, state: &mut ControllerState) {
        let Self { model, terms, command, .. } = self;
        let Terms {
            kinematics, dynamics, inverse_mass, free_acceleration, momentum, contact, limits, ..
        } = terms;
        let acting = &mut state.acting;
        acting.thrust_rate.copy_from(&command.thrust_rate);
        acting.joints.copy_from_slice(&limits.joints);
        acting.set_torque(command.joint_torque.iter().copied());
        acting.foot_wrenches.copy_from(&contact.force_of_torques);
        acting.velocity.copy_from(&state.estimate.robot.state.velocity);
        let acceleration = &mut acting.acceleration;
        acceleration.fill(0.0);
        if inverse_mass.is_known {
            acceleration.rows_mut(6, acting.torque.len()).copy_from(&acting.torque);
            // The wrenches that keep the feet at rest, because those of an impact last for less than a tick.
            let wrenches = acting.foot_wrenches.as_slice().chunks_exact(WRENCH);
            for ((foot, sole), wrench) in model.feet.iter().zip(&contact.soles).zip(wrenches) {
                let (body, wrench) = (foot.frame.body, Vector6::from_column_slice(wrench));
                kinematics.add_generalised_wrench(body, &sole.position, &wrench, acceleration);
            }
            inverse_mass.multiply_in_place(acceleration);
            *acceleration += &*free_acceleration;
            dynamics.add_whole_acceleration(kinematics, &momentum.unmodelled_wrench, acceleration);
        }
    }

    /// Corrects what was predicted: the torques of the command act for a `share` of the tick in place of the last ones.
    pub(super) fn change_torques(&mut self, state: &mut ControllerState, share: f64) {
        let Self { terms, command, change, .. } = self;
        let ControllerState { acting, inner_loop, contact, .. } = state;
        let is_used = terms.inverse_mass.is_known && !contact.is_active; // under load, as in `replace_command`
        change.fill(0.0);
        for (joint, torque) in command.joint_torque.iter().enumerate() {
            let more = torque - inner_loop.torque[joint];
            inner_loop.torque[joint] = *torque;
            if is_used {
                acting.joint_torque[joint] += share * more;
                change[6 + joint] = acting.joints[joint].effectiveness() * more;
            }
        }
        if !is_used {
            return;
        }
        terms.inverse_mass.multiply_in_place(change);
        acting.acceleration.axpy(share, change, 1.0);
        inner_loop.acceleration += change.rows_range(6..);
        acting.reduce();
        if let Some(memory) = &mut state.estimator {
            memory.replace_command(acting);
        }
    }

    /// Corrects what was predicted: other thrust rates \[N/s\] and torques \[N m\] than those of the last command act. While
    /// the feet carry load, other torques change the load on the feet more than the motion of the robot: only the
    /// thrust rates are used.
    pub(super) fn replace_acting(
        &mut self,
        state: &mut ControllerState,
        thrust_rate: &[f64],
        joint_torque: &[f64],
    ) {
        let Self { model, terms: Terms { kinematics, dynamics, inverse_mass, .. }, change, .. } = self;
        let ControllerState { acting, estimate, .. } = state;
        if !state.contact.is_active {
            // ν̇ is linear in the torques: it changes by M⁻¹ S (τ′ − τ). The state may be that of another tick than the
            // controller's last one.
            kinematics.update(model, &estimate.robot.state);
            dynamics.update(model, &estimate.robot.state, kinematics);
            inverse_mass.update(&dynamics.mass_matrix);
            if inverse_mass.is_known {
                change.fill(0.0);
                let torques = joint_torque.iter().zip(&acting.joint_torque).zip(&acting.joints);
                for (entry, ((new, old), found)) in change.as_mut_slice()[6..].iter_mut().zip(torques) {
                    *entry = found.effectiveness() * (new - old);
                }
                inverse_mass.multiply_in_place(change);
                acting.acceleration += &*change;
            }
            acting.set_torque(joint_torque.iter().copied());
        }
        acting.thrust_rate.copy_from_slice(thrust_rate);
        state.inner_loop.replace_torque(joint_torque, acting.acceleration.rows_range(6..));
        if let Some(memory) = &mut state.estimator {
            memory.replace_command(acting);
        }
    }
}
