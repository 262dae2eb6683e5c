//! The law that the tick calls: from the set-point to thrust rates and joint velocities, by the momentum QP or a plan.

use crate::aero::AeroModel;
use crate::control::command::Command;
use crate::control::law::attitude::attitude_demand;
use crate::control::law::momentum_qp::TaskInputs;
use crate::control::law::setpoint::{Ahead, Setpoint, SetpointGenerator};
use crate::control::limits::JointCondition;
use crate::control::modes::Modes;
use crate::control::mpc::{PredictiveLaw, Upcoming};
use crate::control::preview::Preview;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::qp::{QpChain, QpSolver, QpStatus};
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{DVector, Matrix3};

/// The law of one controller, with its workspace.
#[derive(Debug)]
pub(crate) struct Law {
    generator: SetpointGenerator,
    solver: QpChain,
    solution: DVector<f64>,
    /// Time from a tick until its command acts \[s\].
    latency: f64,
    /// What the set-points after this tick follow.
    ahead: Ahead,
    predictive: Option<PredictiveLaw>,
}

impl Law {
    /// A law in `unknowns` unknowns that follows a mission, or given set-points; the momentum QP decides where there is no
    /// `predictive` law, or it has no plan.
    #[must_use]
    pub(crate) fn new(
        generator: SetpointGenerator,
        solver: QpChain,
        unknowns: usize,
        latency: f64,
        predictive: Option<PredictiveLaw>,
    ) -> Self {
        let solution = DVector::zeros(unknowns);
        Self { generator, solver, solution, latency, ahead: Ahead::Mission, predictive }
    }

    /// Its set-points from the mission.
    #[must_use]
    pub(crate) fn generator(&self) -> &SetpointGenerator {
        &self.generator
    }

    /// The predictive law, if it plans.
    #[must_use]
    pub(crate) fn predictive(&self) -> Option<&PredictiveLaw> {
        self.predictive.as_ref()
    }

    /// Chooses the set-point of this tick: during a descent that of the descent, otherwise the `given` one, or that of
    /// the mission. Returns whether the given one is valid; if it is not, the robot brakes from the motion of the last
    /// valid one (M115).
    pub(crate) fn choose_setpoint(
        &mut self,
        state: &mut ControllerState,
        given: Option<&Setpoint>,
        terms: &mut Terms,
    ) -> bool {
        let ControllerState { setpoint: state, estimate, descent, contact, .. } = state;
        let is_valid = given.is_none_or(Setpoint::is_valid);
        (self.ahead, terms.setpoint) = match given {
            _ if descent.is_active() => {
                (Ahead::Descent, self.generator.descend(state, terms.contact.stays(contact)))
            }
            None => (Ahead::Mission, self.generator.update(state, estimate.robot.time)),
            Some(given) if is_valid => {
                self.generator.take_motion(state, &given.motion());
                (Ahead::Motion, *given)
            }
            Some(_) => (Ahead::Stop, self.generator.stop(state)),
        };
        let setpoint = &terms.setpoint;
        terms.due = if self.latency > 0.0 { setpoint.after(self.latency) } else { *setpoint };
        is_valid
    }

    /// Goes on with the mission, or the `given` set-point, from where the robot is, after a descent that is revoked in this
    /// tick (M182).
    pub(crate) fn resume(
        &mut self,
        state: &mut ControllerState,
        given: Option<&Setpoint>,
        terms: &mut Terms,
    ) {
        let velocity = terms.dynamics.momentum.fixed_rows::<3>(0) / terms.kinematics.mass();
        self.generator.resume(&mut state.setpoint, &terms.kinematics.com, &velocity);
        state.plan.discard();
        self.choose_setpoint(state, given, terms);
    }

    /// Computes thrust rates and joint velocities that control momentum and attitude.
    pub(crate) fn solve(
        &mut self,
        robot: &RobotModel,
        aero: &mut AeroModel,
        state: &mut ControllerState,
        preview: &Preview,
        terms: &mut Terms,
        command: &mut Command,
    ) {
        let holds_heading = self.predictive.as_ref().is_none_or(PredictiveLaw::holds_heading);
        Self::prepare(holds_heading, state, terms);
        let Self { predictive, generator, ahead, .. } = self;
        let Some(predictive) = predictive.as_mut().filter(|law| law.flies(state, terms)) else {
            state.plan.discard();
            return self.decide(state, terms, command);
        };
        let motion = Upcoming { generator, ahead: *ahead, preview };
        if !predictive.command(robot, aero, state, &motion, terms, command) {
            self.decide(state, terms, command);
            command.modes.insert(Modes::PLAN_MISSING);
        }
    }

    /// Builds the momentum QP of this tick, with its bounds; without an engine the heading is the present one unless the
    /// law holds it.
    fn prepare(holds_heading: bool, state: &mut ControllerState, terms: &mut Terms) {
        let Terms { kinematics, dynamics, momentum, setpoint, due, .. } = terms;
        let robot = &state.estimate.robot;
        let Terms { limits, attitude, momentum_qp, contact, .. } = terms;
        let (_, moment_estimate) = parts(&momentum.rate_estimate);
        let inertia_0_b = &state.inertia_0_b;
        if !limits.holds_position {
            *setpoint = setpoint.without_place(&kinematics.com);
            *due = due.without_place(&kinematics.com);
            if !holds_heading {
                let base = &robot.state.base.rotation;
                state.setpoint.take_heading(base);
                *setpoint = setpoint.with_heading_of(base);
                *due = due.with_heading_of(base);
            }
        }
        *attitude = attitude_demand(
            &limits.gains,
            due,
            &robot.state.base.rotation,
            &robot.state.base_angular_velocity(),
            &moment_estimate,
            inertia_0_b,
            &inertia_0_b.try_inverse().unwrap_or_else(Matrix3::zeros),
        );
        let inputs = TaskInputs {
            state: &robot.state,
            thrust: &robot.thrust[..limits.thrust.len()],
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
        let moving = robot.state.joint_velocity().iter().zip(&limits.joints).enumerate();
        for (joint, (velocity, _)) in moving.filter(|(_, (_, found))| **found == JointCondition::Free) {
            momentum_qp.fix_velocity(joint, *velocity);
        }
    }

    /// Solves the momentum QP.
    fn decide(&mut self, state: &mut ControllerState, terms: &mut Terms, command: &mut Command) {
        let Terms { momentum_qp, contact, .. } = terms;
        let answer = self.solver.solve_from(&mut state.momentum_start, &momentum_qp.problem);
        command.rates_qp = answer;
        self.solution.as_mut_slice().copy_from_slice(self.solver.x());
        if answer.status != QpStatus::Solved {
            command.modes.insert(Modes::MOMENTUM_HELD);
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
