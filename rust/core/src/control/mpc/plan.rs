//! The plan of the predictive law, a part of the controller's state.

use super::nonlinear::NonlinearPlan;
use crate::qp::{QpAnswer, WarmStart};

/// The plan that is followed.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Inputs by knot and block, in the order of the horizon's unknowns; empty without a predictive law.
    pub(in crate::control) inputs: Vec<f64>,
    /// Time at which it began \[s\]; `None` without a plan.
    pub(in crate::control) since: Option<f64>,
    /// Time of the last attempt \[s\], and its answer; `None` without one.
    pub(in crate::control) tried: f64,
    pub(in crate::control) answer: Option<QpAnswer>,
    pub(in crate::control) warm: WarmStart,
    /// `β` of each engine at the last attempt \[1/s\] (M174); zero for ideal jets.
    pub(in crate::control) damping: Vec<f64>,
    /// The nonlinear plan of a descent, where it is configured.
    pub(in crate::control) nonlinear: Option<NonlinearPlan>,
}

impl Plan {
    /// No plan, in `unknowns` unknowns, for a number of `jets`.
    #[must_use]
    pub fn none(unknowns: usize, jets: usize) -> Self {
        Self {
            inputs: vec![0.0; unknowns],
            since: None,
            tried: f64::NEG_INFINITY,
            answer: None,
            warm: WarmStart::cold(unknowns),
            damping: vec![0.0; jets],
            nonlinear: None,
        }
    }

    /// Answer of the last attempt, with the factorisations of all its QPs; `None` without one.
    #[must_use]
    pub fn answer(&self) -> Option<QpAnswer> {
        self.answer
    }

    /// It is not followed any further, and a new one is due.
    pub(in crate::control) fn discard(&mut self) {
        (self.since, self.tried) = (None, f64::NEG_INFINITY);
        if let Some(plan) = &mut self.nonlinear {
            plan.discard();
        }
    }

    /// Time since it began \[s\].
    pub(in crate::control) fn age(&self, time: f64) -> Option<f64> {
        self.since.map(|since| time - since).filter(|age| *age >= 0.0)
    }
}
