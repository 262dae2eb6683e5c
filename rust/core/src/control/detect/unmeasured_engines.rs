//! Detection of engines that stop while their thrusts are not measured.
//!
//! ```text
//! w = ŵ + n                                    the unmodelled wrench: the observed one and its residual, M84 and M106
//! w̄ ← w̄ + (1 − e^{−Δt/τ}) (ŵ − w̄)              the one of before
//! m_i = −⟨w − w̄, a_i⟩ / ⟨a_i, a_i⟩              force that jet i lacks, with its column a_i of A_T
//! e_i = ⟨w − w̄, a_i⟩² / (⟨a_i, a_i⟩ ⟨w − w̄, w − w̄⟩)    share of the change that this explains
//! ```
//!
//! A jet is a suspect if its thrust has been missing, or has had the same bits, for two hundredths of a second, or if its
//! sensor was found to be wrong some time ago: then nothing but the momentum shows its engine. Ideal sensors and rounded
//! thrusts repeat bits too, so the momentum decides. If the suspect that explains most lacks much of its thrust for a
//! confirmation time, its engine has stopped, and the observed wrench is the one of before. If the momentum soon shows the
//! thrust that was taken away, or a sensor that measures again and the momentum agree for long enough, the engine works.
//! Times are those that measured momenta cover. What follows from a finding says the table of [`EngineCondition`].
//! Equation M177 of `docs/model`.

use super::detector::{Detector, Evidence, Findings, Setup};
use super::engines::{EXPLAINED, GIVEN, explains, product};
use crate::control::engine_condition::{EngineCondition, EngineFinding, EngineState};
use crate::control::law::momentum::MomentumModel;
use crate::control::limits::Limits;
use crate::control::measure::measurement::{Estimate, Sampling};
use crate::control::modes::{Mode, modes};
use crate::error::BuildError;
use crate::kinematics::{Kinematics, RobotState};
use crate::robot::RobotModel;
use crate::timing::{Exceeded, share};
use nalgebra::{Matrix6xX, Vector6};
use serde::{Deserialize, Serialize};

modes! {
    MODES:
    /// An engine whose thrust is not measured has stopped, as the momentum shows.
    ENGINE_STOPPED = 24, "engine_stopped";
}

/// Time without a new thrust after which a jet is a suspect \[s\].
const REPEATED: f64 = 0.01;

/// Time with measured momentum after which its residual has forgotten the error of a sensor that was found to be wrong \[s\]:
/// five of its time constants.
const FORGOTTEN: f64 = 0.1;

/// Time constant `τ` of the wrench of before \[s\].
const MEMORY: f64 = 1.0;

/// Least share of its thrust that a stopped engine lacks.
const LACKED: f64 = 0.4;

/// Time for which thrust has to be missing, or given \[s\].
const CONFIRMATION: f64 = 0.02;

/// Time after a finding in which the momentum can revoke it \[s\].
const REVOCATION: f64 = 0.5;

/// Time for which a sensor that measures again and the momentum have to agree \[s\].
const AGREEMENT: f64 = 0.5;

/// When an engine without a measured thrust counts as stopped.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UnmeasuredEnginesConfig {
    /// Least force that a stopped engine lacks \[N\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub force_min: f64,
}

impl UnmeasuredEnginesConfig {
    /// Refuses a robot two of whose jets the momentum cannot distinguish, upright with its joints as near to zero as they
    /// come.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key and both jets.
    pub fn check(&self, robot: &RobotModel) -> Result<(), BuildError> {
        let mut state = RobotState::zero(robot.joints.len());
        for (position, joint) in state.joint_position.iter_mut().zip(&robot.joints) {
            *position = 0.0_f64.max(joint.limits.0).min(joint.limits.1);
        }
        let (mut kinematics, mut momentum) = (Kinematics::new(robot), MomentumModel::new(robot));
        kinematics.update(robot, &state);
        momentum.place_jets(robot, &kinematics);
        let columns: Vec<Vector6<f64>> = momentum.a_t.column_iter().map(Into::into).collect();
        for (place, (one, jet)) in columns.iter().zip(&robot.jets).enumerate() {
            for (other, with) in columns.iter().zip(&robot.jets).take(place) {
                let along = product(one, other);
                let share = along * along / (product(one, one) * product(other, other));
                if share > EXPLAINED {
                    let (jet, with) = (&jet.name, &with.name);
                    let key = "controller.fault_detection.unmeasured_engines";
                    let expected = format!(
                        "none for this robot: `{jet}` explains {share:.2} of the wrench of `{with}`, and one that \
                         has stopped is distinguished from others by a share of {EXPLAINED}"
                    );
                    return Err(BuildError::bad_value(key, "given", expected));
                }
            }
        }
        Ok(())
    }
}

/// What is kept of one jet.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Jet {
    /// The last reading of its thrust \[N\], and for how long there has been no other.
    last: Option<f64>,
    silent: Exceeded,
    /// For how long thrust has been missing, or given after a finding.
    exceeded: Exceeded,
    /// For how long sensor and momentum have agreed after one.
    agrees: Exceeded,
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

    /// Takes in what the sensor of a jet says \[N\], NaN for nothing, `dt` \[s\] after the last time.
    pub fn take_in(&mut self, jet: usize, reading: f64, dt: f64) {
        let Jet { last, silent, .. } = &mut self.jets[jet];
        let is_new = reading.is_finite() && last.is_none_or(|last| last.to_bits() != reading.to_bits());
        silent.update(!is_new, dt);
        *last = if is_new { Some(reading) } else { *last };
    }

    /// `w̄` \[N, N m\].
    #[must_use]
    pub fn before(&self) -> &Vector6<f64> {
        &self.before
    }

    /// Of every jet for how long its sensor has said nothing new, for how long thrust has been missing, or given after a
    /// finding, and for how long sensor and momentum have agreed after one \[s\].
    pub fn times(&self) -> impl Iterator<Item = [f64; 3]> {
        self.jets.iter().map(|jet| [jet.silent, jet.exceeded, jet.agrees].map(|of| of.time()))
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
        for (jet, reading) in measured.thrust_reading.iter().enumerate().take(state.jets.len()) {
            state.take_in(jet, *reading, measured.elapsed);
        }
    }

    fn detect(
        &mut self,
        state: &mut UnmeasuredState,
        tick: &Evidence,
        _: &mut Limits,
        findings: &mut Findings,
    ) {
        let Evidence { estimate, momentum, disturbance, covered, engines, is_standing, .. } = *tick;
        if let Some((observer, covered)) = disturbance.zip(covered).filter(|_| !is_standing) {
            let shown = Changed {
                observed: observer.wrench(),
                residual: &observer.residual,
                a_t: &momentum.a_t,
                thrust: &estimate.robot.thrust,
                covered,
                elapsed: estimate.elapsed,
            };
            findings.unmodelled = self.judge(state, engines, &shown, &mut findings.engines);
        } else if estimate.momentum == Sampling::Unknown || is_standing {
            for jet in &mut state.jets {
                (jet.exceeded, jet.agrees) = <_>::default();
            }
        }
    }
}

/// What a measured momentum shows.
#[derive(Debug, Clone, Copy)]
pub struct Changed<'a> {
    /// Observed wrench `ŵ` \[N, N m\].
    pub observed: &'a Vector6<f64>,
    /// Its residual `n` \[N, N m\].
    pub residual: &'a Vector6<f64>,
    /// `A_T`.
    pub a_t: &'a Matrix6xX<f64>,
    /// Thrusts that are used \[N\].
    pub thrust: &'a [f64],
    /// Time since the last measured momentum, and since the last tick \[s\].
    pub covered: f64,
    /// Time since the last tick \[s\].
    pub elapsed: f64,
}

impl UnmeasuredEngines {
    /// Judges the suspects, and what was found of engines in these conditions. What is found joins `findings`. Returns the
    /// wrench of before where it finds or revokes.
    pub fn judge(
        &self,
        state: &mut UnmeasuredState,
        engines: &[EngineCondition],
        shown: &Changed,
        findings: &mut [EngineFinding],
    ) -> Option<Vector6<f64>> {
        let UnmeasuredState { before, jets } = state;
        let Changed { observed, residual, a_t, thrust, covered, elapsed } = *shown;
        let (unmodelled, change) = (observed + residual, observed + residual - *before);
        // What a jet lacks, and which share of the change that explains.
        let lack = |jet: usize| {
            let column: Vector6<f64> = a_t.column(jet).into();
            let (along, square) = (product(&change, &column), product(&column, &column));
            (-along / square, along * along / (square * product(&change, &change)))
        };
        let least = self.0.force_min;
        let mut found = (None, EXPLAINED);
        for (index, (jet, engine)) in jets.iter().zip(engines).enumerate().take(a_t.ncols()) {
            let ((lacked, explained), used) = (lack(index), thrust[index]);
            let is_unused = !engine.is_sensor_used && engine.since + covered > FORGOTTEN;
            let is_unknown = jet.silent.has_lasted(REPEATED, elapsed) || is_unused;
            let is_suspect = !engine.has_stopped() && is_unknown && used > least;
            if is_suspect && lacked > least.max(LACKED * used) && explained > found.1 {
                found = (Some(index), explained);
            }
        }
        let (mut is_settled, mut is_changed) = (true, false);
        for (index, (jet, engine)) in jets.iter_mut().zip(engines).enumerate().take(a_t.ncols()) {
            let is_stopped = engine.state == EngineState::Stopped;
            let since = engine.since + covered;
            let is_recent = is_stopped && since < REVOCATION;
            let is_beyond = if is_stopped {
                is_recent && -lack(index).0 > GIVEN * engine.taken.thrust
            } else {
                found.0 == Some(index)
            };
            is_settled &= !is_recent && !is_beyond;
            jet.exceeded.update(is_beyond, covered);
            let says = jet.last.filter(|_| !jet.silent.has_lasted(REPEATED, elapsed)).unwrap_or(0.0);
            let agrees = is_stopped && says > least && explains(&(-says * a_t.column(index)), &unmodelled);
            jet.agrees.update(agrees, covered);
            let finding = if jet.exceeded.has_lasted(CONFIRMATION, covered) {
                if is_stopped { EngineFinding::Given } else { EngineFinding::Missing }
            } else if jet.agrees.has_lasted(AGREEMENT, covered) {
                EngineFinding::Agreed { thrust: says }
            } else {
                continue;
            };
            (jet.exceeded, jet.agrees) = <_>::default();
            is_changed = true;
            findings[index] = findings[index].or(finding);
        }
        if is_settled {
            *before += share(covered / MEMORY) * (observed - *before);
        }
        is_changed.then_some(*before)
    }
}
