//! A residual in a tick: it is added to the answer of the law, and the wrench is observed that the next one sees.

use crate::control::command::Command;
use crate::control::estimate::disturbance_observer::{DisturbanceObserverConfig, MomentumSample};
use crate::control::law::residual::{Policy, Residual};
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;

/// Observer of the wrench that a policy sees.
const OBSERVER: DisturbanceObserverConfig = DisturbanceObserverConfig {
    gain_force: 3.0,
    gain_moment: 3.0,
    force_max: f64::INFINITY,
    moment_max: f64::INFINITY,
};

/// Adds the residual of a tick to the answer of the law (M172), and, from the first one on, observes the wrench for the
/// next tick. A given residual takes the place of the policy's.
pub(super) fn steer(
    policy: Option<&mut Policy>,
    given: Option<&Residual>,
    state: &mut ControllerState,
    terms: &mut Terms,
    command: &mut Command,
) {
    let wrench = state.residual_wrench();
    let has_residual = given.is_some() || policy.is_some();
    match (given, policy) {
        (Some(given), _) => {
            given.write(command.thrust_rate.len(), command.joint_velocity.len(), &mut terms.residual);
        }
        (None, Some(policy)) => {
            let Terms { kinematics, due, residual, .. } = terms;
            policy.act(&state.estimate.robot.state, kinematics, due, &wrench, residual);
        }
        (None, None) => {}
    }
    if has_residual {
        add(given.is_some_and(|given| given.replaces), terms, command);
    } else if state.residual_observer.is_none() {
        return;
    }
    let sample = MomentumSample { momentum: terms.dynamics.momentum, rate: terms.momentum.rate_estimate };
    let observer = state.residual_observer.get_or_insert_default();
    observer.observe(&OBSERVER, state.estimate.momentum, state.estimate.elapsed, sample);
}

/// `u = clip( u* + r, l, u )`.
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
