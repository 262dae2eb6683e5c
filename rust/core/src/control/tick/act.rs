//! From commanded joint velocities to torques, by the torque QP and a rate limiter.
//!
//! Compensated friction is `F = f tanh(ṡ* / v)` in flight: of the commanded velocity, since that of a joint that sticks has no
//! sign.
//!
//! This file has the integral of M68 and the friction of M69 of `docs/model`.

use crate::control::command::Command;
use crate::control::law::torque::limit_rate;
use crate::control::limits::JointCondition;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::qp::{QpAnswer, QpChain, QpSolver, QpStatus};
use nalgebra::DVector;

/// Limit of the published integrator of the joint velocity error \[rad\]; no flight comes near it.
const INTEGRAL_LIMIT: f64 = 20.0;

/// Commanded velocity at which three quarters of the friction are compensated \[rad/s\].
const SLIP: f64 = 0.02;

/// The torque law of one controller, with its workspace.
#[derive(Debug)]
pub(crate) struct Torques {
    solver: QpChain,
    velocity_error: DVector<f64>,
    /// Dry friction of the drives \[N m\].
    friction: Vec<f64>,
    /// Accelerations of base and joints without torques, under it.
    free: DVector<f64>,
    /// Time between two ticks of the torques \[s\].
    period: f64,
}

impl Torques {
    /// Torques of `joints` joints, every `period` \[s\].
    #[must_use]
    pub(crate) fn new(solver: QpChain, friction: Vec<f64>, period: f64) -> Self {
        Self {
            solver,
            velocity_error: DVector::zeros(friction.len()),
            free: DVector::zeros(6 + friction.len()),
            friction,
            period,
        }
    }

    /// Computes torques that let the joints follow the commanded velocities.
    pub(super) fn solve(&mut self, state: &mut ControllerState, terms: &mut Terms, command: &mut Command) {
        let Terms { inverse_mass, free_acceleration, contact, limits, torque_qp, .. } = terms;
        let friction = &mut state.acting.friction;
        self.compare(state.estimate.robot.state.joint_velocity(), command);
        // Known too large, it would fell a robot that stands, whose joints hardly move.
        let have_friction = !state.contact.is_active && self.friction.iter().any(|friction| *friction > 0.0);
        for (joint, (to, friction)) in friction.iter_mut().zip(&self.friction).enumerate() {
            *to =
                if have_friction { friction * libm::tanh(command.joint_velocity[joint] / SLIP) } else { 0.0 };
        }
        for (integral, found) in state.velocity_error_integral.iter_mut().zip(&limits.joints) {
            if matches!(found, JointCondition::Stuck | JointCondition::Free) {
                *integral = 0.0; // it follows no velocity
            }
        }
        if inverse_mass.is_known {
            torque_qp.limit(&limits.joints);
            self.free.fill(0.0);
            if have_friction {
                self.free.rows_range_mut(6..).axpy(-1.0, friction, 0.0);
                inverse_mass.multiply_in_place(&mut self.free);
            }
            self.free += &*free_acceleration;
            torque_qp.update(
                contact,
                &state.contact,
                inverse_mass,
                &self.free,
                &self.velocity_error,
                &state.velocity_error_integral,
            );
        }
        self.decide(state, terms, command);
    }

    /// Computes them again for other joint velocities \[rad/s, m/s\], with the model of the last [`Self::solve`].
    pub(crate) fn solve_again(
        &mut self,
        joint_velocity: &[f64],
        state: &mut ControllerState,
        terms: &mut Terms,
        command: &mut Command,
    ) {
        self.compare(joint_velocity, command);
        terms.torque_qp.update_error(&state.contact, &self.velocity_error, &state.velocity_error_integral);
        self.decide(state, terms, command);
    }

    /// `ṡ − ṡ*`
    fn compare(&mut self, joint_velocity: &[f64], command: &Command) {
        for (joint, velocity) in joint_velocity.iter().enumerate() {
            self.velocity_error[joint] = velocity - command.joint_velocity[joint];
        }
    }

    fn decide(&mut self, state: &mut ControllerState, terms: &mut Terms, command: &mut Command) {
        let Terms { inverse_mass, contact, limits, torque_qp, unlimited_torque, .. } = terms;
        let answer = if inverse_mass.is_known {
            self.solver.solve_from(&mut state.torque_start, &torque_qp.problem)
        } else {
            QpAnswer::from_status(QpStatus::NotPositiveDefinite)
        };
        command.torque_qp = answer;
        if answer.status == QpStatus::Solved {
            let (forces, torques) = self.solver.x().split_at(torque_qp.foot_force.end);
            if state.contact.is_active {
                contact.force_of_torques.copy_from_slice(forces);
            }
            for (joint, found) in limits.joints.iter().enumerate() {
                unlimited_torque[joint] = torque_qp.commanded(joint, *found, torques, inverse_mass);
            }
            if !state.torque_is_known {
                // The published rate limiter starts from its first input.
                state.joint_torque.copy_from(unlimited_torque);
                state.torque_is_known = true;
            }
            let rate_max = limits.torque_rate.iter().copied();
            limit_rate(&mut state.joint_torque, unlimited_torque.as_slice(), rate_max, self.period);
            command.joint_torque.copy_from(&state.joint_torque);
        } else {
            command.modes.insert(Modes::TORQUE_HELD);
        }
        // Forward Euler: used first, advanced after. Without a commanded velocity there is no error to integrate; with
        // held torques the integral would grow without effect on the torques.
        if !command.modes.is_held() {
            let integral = state.velocity_error_integral.iter_mut();
            for (integral, error) in integral.zip(&self.velocity_error) {
                *integral = (*integral + self.period * error).clamp(-INTEGRAL_LIMIT, INTEGRAL_LIMIT);
            }
        }
    }
}
