//! A residual in a tick: it is added to the answer of the law, or replaces it, and the wrench is observed that the next
//! one is given.

use crate::control::command::Command;
use crate::control::estimate::disturbance_observer::{DisturbanceObserverConfig, MomentumSample};
use crate::control::law::residual::{Policy, Residual, Sight};
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;

/// Observer of the wrench that a policy is given.
const OBSERVER: DisturbanceObserverConfig = DisturbanceObserverConfig {
    gain_force: 3.0,
    gain_moment: 3.0,
    force_max: f64::INFINITY,
    moment_max: f64::INFINITY,
};

/// Adds the residual of a tick to the answer of the law, or replaces it (M172), and, from the first one on, observes the wrench for the
/// next tick. A given residual takes the place of the policy's.
pub(super) fn steer(
    policy: Option<&mut Policy>,
    given: Option<&Residual>,
    state: &mut ControllerState,
    terms: &mut Terms,
    command: &mut Command,
) {
    let wrench = state.residual_wrench();
    let replaces = match (given, policy) {
        (Some(given), _) => {
            given.write(command.thrust_rate.len(), command.joint_velocity.len(), &mut terms.residual);
            Some(given.replaces)
        }
        (None, Some(policy)) => {
            let Terms { kinematics, due, residual, .. } = terms;
            let robot = &state.estimate.robot;
            let seen = Sight {
                robot: &robot.state,
                thrust: robot.thrust.as_slice(),
                kinematics,
                due,
                posture: &state.posture,
                wrench: &wrench,
            };
            policy.act(&seen, residual);
            Some(policy.replaces())
        }
        (None, None) => None,
    };
    if let Some(replaces) = replaces {
        add(replaces, terms, command);
    } else if state.residual_observer.is_none() {
        return;
    }
    let sample = MomentumSample { momentum: terms.dynamics.momentum, rate: terms.momentum.rate_estimate };
    let observer = state.residual_observer.get_or_insert_default();
    observer.observe(&OBSERVER, state.estimate.momentum, state.estimate.elapsed, sample);
}

/// `u = clip( ζ u* + r, l, u )`.
fn add(replaces: bool, terms: &Terms, command: &mut Command) {
    let Terms { residual, momentum_qp, .. } = terms;
    if !residual.iter().all(|number| number.is_finite()) {
        command.modes.insert(Modes::RESIDUAL_IGNORED);
        return;
    }
    if command.modes.is_held() {
        return;
    }
    let (unknowns, problem) = (&momentum_qp.unknowns, &momentum_qp.problem);
    let (rates, velocities) = residual.as_slice().split_at(command.thrust_rate.len());
    for (to, added, range) in [
        (&mut command.thrust_rate, rates, unknowns.thrust_rate.clone()),
        (&mut command.joint_velocity, velocities, unknowns.joint_velocity.clone()),
    ] {
        for ((to, added), unknown) in to.iter_mut().zip(added).zip(range) {
            let own = if replaces { 0.0 } else { *to };
            *to = (own + added).max(problem.lower[unknown]).min(problem.upper[unknown]);
        }
    }
}
