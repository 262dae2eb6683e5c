//! Detection of engines that stop while their thrusts are not measured.
//!
//! ```text
//! w = ŵ + n                                    the unmodelled wrench: the observed one and its residual, M84 and M106
//! w̄ ← w̄ + (1 − e^{−Δt/τ}) (ŵ − w̄)              the one of before
//! m_i = −⟨w − w̄, a_i⟩ / ⟨a_i, a_i⟩              force that jet i lacks, with its column a_i of A_T
//! e_i = ⟨w − w̄, a_i⟩² / (⟨a_i, a_i⟩ ⟨w − w̄, w − w̄⟩)    share of the change that this explains
//! ```
//!
//! A thrust that is missing, or has the same bits, for two ticks says nothing about its engine: the jet is a suspect. Ideal
//! sensors and rounded thrusts repeat bits too, so the momentum decides. If the suspect that explains most lacks much of its
//! thrust for a confirmation time, its engine has stopped: its thrust is zero, its sensor is not used any more, and the
//! observed wrench is the one of before. If the momentum soon shows the thrust that was taken away, the engine works.
//! Equation M177 of `docs/model`.

use super::detector::{Detector, Evidence, Findings, Setup};
use super::engines::product;
use crate::control::limits::Limits;
use crate::control::measure::measurement::{Estimate, Sampling};
use crate::control::modes::{Mode, Modes, modes};
use crate::timing::{Exceeded, share};
use nalgebra::{Matrix6xX, Vector6};
use serde::{Deserialize, Serialize};

modes! {
    MODES:
    /// An engine whose thrust is not measured has stopped, as the momentum shows.
    ENGINE_STOPPED = 24, "engine_stopped";
}

/// Ticks without a new thrust after which a jet is a suspect.
const REPEATED: u32 = 2;

/// Time constant `τ` of the wrench of before \[s\].
const MEMORY: f64 = 1.0;

/// Least share of the change that a stopped engine explains: pushes and gusts mostly have other directions.
const EXPLAINED: f64 = 0.9;

/// Least share of its thrust that a stopped engine lacks, and that one which works gives after it was taken away.
const LACKED: f64 = 0.4;
const GIVEN: f64 = 0.5;

/// Time for which thrust has to be missing, or given \[s\].
const CONFIRMATION: f64 = 0.02;

/// Time after a finding in which the momentum can revoke it \[s\].
const REVOCATION: f64 = 0.5;

/// When an engine without a measured thrust counts as stopped.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UnmeasuredEnginesConfig {
    /// Least force that a stopped engine lacks \[N\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub force_min: f64,
}

/// What is kept of one jet.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Jet {
    /// The last thrust \[N\], and for how many ticks there has been no other.
    last: (f64, u32),
    /// For how long thrust has been missing, or given after a finding.
    exceeded: Exceeded,
    /// Thrust that was taken away \[N\], and the time since then \[s\]; `None` while the engine works.
    stopped: Option<(f64, f64)>,
}

/// State of the detector, kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct UnmeasuredState {
    /// `w̄` \[N, N m\].
    before: Vector6<f64>,
    jets: Vec<Jet>,
}

impl UnmeasuredState {
    /// The state before the first tick, of so many jets.
    #[must_use]
    pub fn new(jets: usize) -> Self {
        Self { before: Vector6::zeros(), jets: vec![Jet::default(); jets] }
    }

    /// Takes in the thrust of a jet \[N\], and its difference from the prediction, zero where it is not measured.
    pub fn take_in(&mut self, jet: usize, thrust: f64, innovation: f64) {
        let last = &mut self.jets[jet].last;
        let is_new = innovation != 0.0 && thrust.to_bits() != last.0.to_bits();
        *last = (thrust, if is_new { 0 } else { last.1.saturating_add(1) });
    }

    /// Whether the engine of a jet has been found to have stopped.
    #[must_use]
    pub fn is_stopped(&self, jet: usize) -> bool {
        self.jets[jet].stopped.is_some()
    }
}

/// The detector of one robot.
#[derive(Debug, Clone, Copy)]
pub struct UnmeasuredEngines(pub UnmeasuredEnginesConfig);

impl Detector for UnmeasuredEngines {
    type Config = UnmeasuredEnginesConfig;
    type State = UnmeasuredState;
    const MODES: &'static [Mode] = &MODES;

    fn build(config: &UnmeasuredEnginesConfig, _: &Setup) -> Self {
        Self(*config)
    }

    fn start(&self, estimate: &Estimate) -> UnmeasuredState {
        UnmeasuredState::new(estimate.robot.thrust.len())
    }

    fn measure(&self, state: &mut UnmeasuredState, measured: &Estimate) {
        let thrusts = measured.robot.thrust.iter().zip(&measured.thrust_innovation);
        for (jet, (thrust, innovation)) in thrusts.enumerate().take(state.jets.len()) {
            state.take_in(jet, *thrust, *innovation);
        }
    }

    fn detect(
        &mut self,
        state: &mut UnmeasuredState,
        tick: &Evidence,
        limits: &mut Limits,
        findings: &mut Findings,
    ) {
        let Evidence { estimate, momentum, disturbance, is_standing, .. } = *tick;
        if let Some(observer) = disturbance.filter(|_| estimate.has_momentum() && !is_standing) {
            let (now, thrust) = ([observer.wrench(), &observer.residual], &estimate.robot.thrust);
            let errors = &mut findings.sensor_error;
            findings.unmodelled = self.judge(state, estimate.elapsed, now, &momentum.a_t, thrust, errors);
        } else if estimate.momentum == Sampling::Unknown || is_standing {
            state.jets.iter_mut().for_each(|jet| jet.exceeded = Exceeded::default());
        }
        let of_law = limits.thrust.iter_mut().zip(&mut limits.works);
        for (jet, (range, works)) in state.jets.iter().zip(of_law) {
            if jet.stopped.is_some() {
                (*range, *works) = ((0.0, 0.0), false);
                findings.modes.insert(Modes::ENGINE_STOPPED);
            }
        }
    }
}

impl UnmeasuredEngines {
    /// Judges the suspects by the observed wrench and its residual \[N, N m\], `dt` \[s\] after the last measured momentum, with
    /// `A_T` and the thrusts that are used \[N\]. Writes the errors of these into `sensor_error`, in each tick those of the
    /// engines that have stopped, whose models would run on at idle. Returns the wrench of before where it finds or revokes.
    pub fn judge(
        &self,
        state: &mut UnmeasuredState,
        dt: f64,
        [observed, residual]: [&Vector6<f64>; 2],
        a_t: &Matrix6xX<f64>,
        thrust: &[f64],
        sensor_error: &mut [Option<f64>],
    ) -> Option<Vector6<f64>> {
        let UnmeasuredState { before, jets } = state;
        let change = observed + residual - *before;
        // What a jet lacks, and which share of the change that explains.
        let lack = |jet: usize| {
            let column: Vector6<f64> = a_t.column(jet).into();
            let (along, square) = (product(&change, &column), product(&column, &column));
            (-along / square, along * along / (square * product(&change, &change)))
        };
        let least = self.0.force_min;
        let mut found = (None, EXPLAINED);
        for (index, jet) in jets.iter().enumerate().take(a_t.ncols()) {
            let ((lacked, explained), used) = (lack(index), thrust[index]);
            let is_suspect = jet.stopped.is_none() && jet.last.1 >= REPEATED && used > least;
            if is_suspect && lacked > least.max(LACKED * used) && explained > found.1 {
                found = (Some(index), explained);
            }
        }
        let (mut is_settled, mut is_changed) = (true, false);
        for (index, jet) in jets.iter_mut().enumerate().take(a_t.ncols()) {
            let is_beyond = match &mut jet.stopped {
                None => found.0 == Some(index),
                Some((taken, since)) => {
                    *since += dt;
                    sensor_error[index] = Some(thrust[index]);
                    is_settled &= *since >= REVOCATION;
                    *since < REVOCATION && -lack(index).0 > GIVEN * *taken
                }
            };
            is_settled &= !is_beyond;
            jet.exceeded.update(is_beyond, dt);
            if jet.exceeded.has_lasted(CONFIRMATION, dt) {
                jet.exceeded = Exceeded::default();
                is_changed = true;
                let taken = jet.stopped.take();
                sensor_error[index] = Some(taken.map_or(thrust[index], |(taken, _)| -taken));
                jet.stopped = if taken.is_none() { Some((thrust[index], 0.0)) } else { None };
            }
        }
        if is_settled {
            *before += share(dt / MEMORY) * (observed - *before);
        }
        is_changed.then_some(*before)
    }
}
