//! The law that the tick calls: from the set-point to thrust rates and joint velocities, by the momentum QP.

use super::attitude::attitude_demand;
use super::limits::JointCondition;
use super::momentum_qp::TaskInputs;
use super::mpc::horizon::Horizon;
use super::mpc::model::Linearised;
use super::setpoint::{Setpoint, SetpointGenerator};
use crate::aero::AeroModel;
use crate::control::command::{Command, CommandStatus};
use crate::control::preview::Preview;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::qp::{QpChain, QpSolver, QpStatus};
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{DVector, Matrix3};
use std::fmt::Debug;

/// A law that a tick calls.
pub trait Law: Debug + Send + Sync {
    /// Its set-points from the mission.
    fn generator(&self) -> &SetpointGenerator;

    /// Number of unknowns of its plan, which is a part of the state; zero if it does not plan.
    fn unknowns(&self) -> usize {
        0
    }

    /// Linearised model and horizon of its last plan, if it plans.
    fn prediction(&self) -> Option<(&Linearised, &Horizon)> {
        None
    }

    /// Chooses the set-point of this tick: during a descent that of the descent, otherwise the `given` one, or that of
    /// the mission. Returns whether the given one is valid; if it is not, the robot brakes from the motion of the last
    /// valid one (M115).
    fn follow(&mut self, state: &mut ControllerState, given: Option<&Setpoint>, terms: &mut Terms) -> bool;

    /// Computes thrust rates and joint velocities that control momentum and attitude.
    fn solve(
        &mut self,
        robot: &RobotModel,
        aero: &mut AeroModel,
        state: &mut ControllerState,
        preview: &Preview,
        terms: &mut Terms,
        command: &mut Command,
    );
}

/// The momentum law of one controller, with its workspace.
#[derive(Debug)]
pub struct MomentumLaw {
    /// Set-points from the mission.
    pub generator: SetpointGenerator,
    solver: QpChain,
    solution: DVector<f64>,
    /// Time from a tick until its command acts \[s\].
    latency: f64,
}

impl MomentumLaw {
    /// A law in `unknowns` unknowns that follows a mission, or given set-points.
    #[must_use]
    pub fn new(generator: SetpointGenerator, solver: QpChain, unknowns: usize, latency: f64) -> Self {
        Self { generator, solver, solution: DVector::zeros(unknowns), latency }
    }

    /// Time from a tick until its command acts \[s\].
    #[must_use]
    pub fn latency(&self) -> f64 {
        self.latency
    }

    /// Builds the momentum QP of this tick, with its bounds.
    pub fn prepare(&self, state: &ControllerState, terms: &mut Terms) {
        let Terms { measurement, kinematics, dynamics, momentum, setpoint, due, .. } = terms;
        let Terms { limits, attitude, momentum_qp, contact, .. } = terms;
        let (_, moment_estimate) = parts(&momentum.rate_estimate);
        let inertia_0_b = &state.inertia_0_b;
        if !limits.holds_position {
            *setpoint = setpoint.without_place(&kinematics.com);
            *due = due.without_place(&kinematics.com);
        }
        *attitude = attitude_demand(
            &limits.gains,
            due,
            &measurement.state.base.rotation,
            &measurement.state.base_angular_velocity(),
            &moment_estimate,
            inertia_0_b,
            &inertia_0_b.try_inverse().unwrap_or_else(Matrix3::zeros),
        );
        let inputs = TaskInputs {
            state: &measurement.state,
            thrust: &measurement.thrust[..limits.thrust.len()],
            kinematics,
            dynamics,
            momentum,
            setpoint: due,
            attitude,
            inertia_0_b,
            posture: &state.posture,
            contact,
            contact_state: &state.contact,
            gains: &limits.gains,
        };
        momentum_qp.update(&inputs);
        let velocity_max = limits.joint_velocity.iter().copied();
        momentum_qp.update_bounds(&inputs, limits.thrust.iter().copied(), velocity_max);
        let moving = measurement.state.joint_velocity().iter().zip(&limits.joints).enumerate();
        for (joint, (velocity, _)) in moving.filter(|(_, (_, found))| **found == JointCondition::Free) {
            momentum_qp.fix_velocity(joint, *velocity);
        }
    }

    /// Solves the momentum QP.
    pub fn decide(&mut self, state: &mut ControllerState, terms: &mut Terms, command: &mut Command) {
        let Terms { momentum_qp, contact, .. } = terms;
        let answer = self.solver.solve_from(&mut state.momentum_start, &momentum_qp.problem);
        command.momentum_qp = answer;
        self.solution.as_mut_slice().copy_from_slice(self.solver.x());
        command.status =
            if command.modes.is_empty() { CommandStatus::Nominal } else { CommandStatus::Degraded };
        if answer.status != QpStatus::Solved {
            command.status = CommandStatus::MomentumHeld;
            // Zero rates, as far as the bounds allow.
            self.solution.fill(0.0);
            momentum_qp.problem.clamp(self.solution.as_mut_slice());
        }
        let (unknowns, u) = (&momentum_qp.unknowns, self.solution.as_slice());
        let thrust_rate = &u[unknowns.thrust_rate.clone()];
        command.thrust_rate.fill(0.0); // also of unused jets, whose rates may have been replaced
        command.thrust_rate.as_mut_slice()[..thrust_rate.len()].copy_from_slice(thrust_rate);
        command.joint_velocity.copy_from_slice(&u[unknowns.joint_velocity.clone()]);
        contact.store_rate(&mut state.contact, &u[unknowns.force_rate.clone()]);
    }
}

impl Law for MomentumLaw {
    fn generator(&self) -> &SetpointGenerator {
        &self.generator
    }

    fn follow(&mut self, state: &mut ControllerState, given: Option<&Setpoint>, terms: &mut Terms) -> bool {
        let ControllerState { setpoint: state, channels, contact, .. } = state;
        let is_valid = given.is_none_or(Setpoint::is_valid);
        terms.setpoint = match given {
            _ if channels.is_descending => self.generator.descend(state, terms.contact.stays(contact)),
            None => self.generator.update(state, terms.measurement.time),
            Some(given) if is_valid => {
                self.generator.follow(state, &given.motion());
                *given
            }
            Some(_) => self.generator.stop(state),
        };
        let setpoint = &terms.setpoint;
        terms.due = if self.latency > 0.0 { setpoint.after(self.latency) } else { *setpoint };
        is_valid
    }

    fn solve(
        &mut self,
        _: &RobotModel,
        _: &mut AeroModel,
        state: &mut ControllerState,
        _: &Preview,
        terms: &mut Terms,
        command: &mut Command,
    ) {
        self.prepare(state, terms);
        self.decide(state, terms, command);
    }
}
