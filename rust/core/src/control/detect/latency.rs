//! The time from a command to its effect, measured from the response of joints and thrusts.
//!
//! ```text
//! torques        y = Δ(s̈_m − s̈_0),  s̈_m = (s_k − 2 s_{k−1} + s_{k−2}),    u = Δ(G τ) Δt²
//! thrust rates   y = T_k − T_{k−1},                                          u = Ṫ* Δt
//! ν, φ ← y, u after lags                J_d = ⟨(ν_k − φ_{k−d})²⟩,   d = −1, 0, 1, … ticks
//! L_d = Σ_j J_dj / (J_d̂j + σ²)          d̂ = argmin L, with a parabola through its neighbours
//! ```
//!
//! Both sides pass the same filter, which removes what the model does not contain and changes slowly. Each joint or thrust
//! counts by what its best delay leaves unexplained. The result contains lags of drives and engines, and half of the tick
//! for which a torque is held. It is known while its standard deviation, were the residuals white, is small enough.
//! Equations M164 and M165 of `docs/model`.

use super::detector::{Detector, Evidence, Findings, Setup};
use crate::control::estimate::estimator::EstimatorConfig;
use crate::control::limits::{JointCondition, Limits};
use crate::control::measure::measurement::{Estimate, Sampling};
use crate::control::modes::{Mode, Modes, modes};
use crate::linalg::add_mat_vec;
use crate::timing::{Exceeded, share};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

modes! {
    MODES:
    /// Commands act later or earlier than the controller knows.
    LATE = 16, "late";
}

/// Greatest delay that is looked for: the greatest known one and a little more \[s\].
const DELAY_MAX: f64 = 0.25;
/// Time in which residuals are forgotten \[s\].
const MEMORY: f64 = 3.0;
/// Filter times after a gap until residuals count.
const SETTLING: f64 = 3.0;
/// Share of a tick by which the time between two measurements may differ from it.
const JITTER: f64 = 0.1;

/// What of one kind of command is compared.
#[derive(Debug, Clone, Copy)]
struct Filter {
    /// Lags of the filter, and their time constant \[s\].
    lags: usize,
    lag: f64,
    /// `σ`: what a model and a sensor leave unexplained at best \[rad, m; N\].
    least_deviation: f64,
    /// Greatest standard deviation of a known delay \[s\].
    deviation_max: f64,
}

/// Positions: three lags, as of an observer with three poles. Encoders have steps of a milliradian.
const TORQUE: Filter = Filter { lags: 3, lag: 0.025, least_deviation: 1e-4, deviation_max: 6e-4 };
/// Thrusts, with a noise of a newton.
const THRUST: Filter = Filter { lags: 1, lag: 0.3, least_deviation: 0.1, deviation_max: 4e-3 };

/// When commands count as late.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LatencyDetectorConfig {
    /// Greatest difference of the measured latency of torques from `controller.estimator.latency` \[s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub torque_max: f64,
    /// Greatest difference of that of thrust rates \[s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub thrust_max: f64,
    /// Time for which one of them has to be exceeded \[s\].
    #[schemars(range(min = 0))]
    pub confirmation: f64,
}

/// Compares a response with commands of different ages.
#[derive(Debug, Clone)]
struct Bank {
    kind: Filter,
    time_step: f64,
    /// Number of delays, from −1 tick on.
    delays: usize,
    /// Ticks after a gap until residuals count.
    wait: usize,
    /// What a tick leaves of the filter's states, and what it adds to the mean squares.
    pole: f64,
    share: f64,
}

/// State of the comparison of one kind of command, kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
struct BankState {
    /// Lags of response and command, one column each.
    response: DMatrix<f64>,
    command: DMatrix<f64>,
    /// `ν` of the last tick.
    last: DVector<f64>,
    /// `φ` of the last ticks, a ring of columns, the latest at `head`.
    line: DMatrix<f64>,
    head: usize,
    /// `J`: mean squares by joint or thrust, and delay.
    square: DMatrix<f64>,
    /// Number of the best delay.
    best: usize,
    /// Ticks since the last gap.
    ticks: usize,
}

impl Bank {
    fn new(kind: Filter, time_step: f64) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        // positive, and at most 0.25 s / 0.2 ms
        let ticks = |time: f64| (time / time_step).ceil() as usize;
        let delays = ticks(DELAY_MAX) + 2;
        Self {
            kind,
            time_step,
            delays,
            wait: delays + ticks(SETTLING * kind.lags as f64 * kind.lag),
            pole: libm::exp(-time_step / kind.lag),
            share: share(time_step / MEMORY),
        }
    }

    /// A bank for torques, and one for thrust rates.
    #[must_use]
    fn pair(time_step: f64) -> [Self; 2] {
        [Self::new(TORQUE, time_step), Self::new(THRUST, time_step)]
    }

    /// State before the first tick, for so many joints or thrusts.
    #[must_use]
    fn start(&self, size: usize) -> BankState {
        let lags = DMatrix::zeros(size, self.kind.lags);
        BankState {
            response: lags.clone(),
            command: lags,
            last: DVector::zeros(size),
            line: DMatrix::zeros(size, self.delays),
            head: 0,
            square: DMatrix::zeros(size, self.delays),
            best: 1,
            ticks: 0,
        }
    }

    /// Takes in the response `y` of the last tick, and the command `u` that was given in it.
    fn update(&self, state: &mut BankState, response: &[f64], command: &[f64]) {
        let BankState { response: of_response, command: of_command, last, line, head, square, best, ticks } =
            state;
        let (delays, counts) = (self.delays, *ticks >= self.wait);
        *head = (*head + delays - 1) % delays;
        for (entry, (response, command)) in response.iter().zip(command).enumerate() {
            let now = self.filter(of_response, entry, *response);
            line[(entry, *head)] = self.filter(of_command, entry, *command);
            let then = std::mem::replace(&mut last[entry], now);
            for delay in 0..if counts { delays } else { 0 } {
                let residual = then - line[(entry, (*head + delay) % delays)];
                let mean = &mut square[(entry, delay)];
                *mean += self.share * (residual * residual - *mean);
            }
        }
        *ticks = ticks.saturating_add(1);
        let (mut least, weights) = (f64::INFINITY, *best);
        for delay in 0..delays {
            let sum = self.sum(square, weights, delay);
            if sum < least {
                (least, *best) = (sum, delay);
            }
        }
    }

    /// A value after the lags.
    fn filter(&self, lags: &mut DMatrix<f64>, entry: usize, value: f64) -> f64 {
        let mut value = value;
        for lag in 0..self.kind.lags {
            value += self.pole * lags[(entry, lag)];
            lags[(entry, lag)] = value;
        }
        value
    }

    /// `L` of a delay, with the weights of another one.
    fn sum(&self, square: &DMatrix<f64>, weights: usize, delay: usize) -> f64 {
        let variance = self.kind.least_deviation * self.kind.least_deviation;
        (0..square.nrows()).map(|entry| square[(entry, delay)] / (square[(entry, weights)] + variance)).sum()
    }

    /// The measured delay \[s\]; `None` while it is not known.
    #[must_use]
    fn delay(&self, state: &BankState) -> Option<f64> {
        let (best, h) = (state.best, self.time_step);
        if best == 0 || best + 1 == self.delays {
            return None;
        }
        let [before, at, after] =
            [best - 1, best, best + 1].map(|delay| self.sum(&state.square, best, delay));
        let curvature = before - 2.0 * at + after;
        // The residuals of a time of 2 MEMORY count; the likelihood is exp(−n L / 2).
        let is_known = curvature * MEMORY / h * self.kind.deviation_max * self.kind.deviation_max > h * h;
        is_known.then(|| h * (best as f64 - 1.0 + 0.5 * (before - after) / curvature))
    }
}

impl BankState {
    /// Begins again after a gap; what was measured stays.
    fn interrupt(&mut self) {
        if self.ticks > 0 {
            self.response.fill(0.0);
            self.command.fill(0.0);
            self.last.fill(0.0);
            self.line.fill(0.0);
            self.ticks = 0;
        }
    }
}

/// What a tick compares, by joint and jet.
#[derive(Debug)]
pub struct LatencySample<'a> {
    /// Predicted accelerations of the joints under the command of the last tick \[rad/s²\].
    pub acceleration: &'a [f64],
    /// `G` \[1/(kg m²)\].
    pub gain: &'a DMatrix<f64>,
    /// Torques that were to act in the last tick \[N m\].
    pub torque: &'a DVector<f64>,
    /// Thrust rates commanded in the last tick \[N/s\].
    pub thrust_rate: &'a [f64],
}

/// Measures latencies of one robot; its state is a [`LatencyState`].
#[derive(Debug, Clone)]
pub struct LatencyMonitor {
    config: LatencyDetectorConfig,
    banks: [Bank; 2],
    time_step: f64,
    /// Configured latencies of torques and thrust rates \[s\].
    known: [f64; 2],
    /// Ages of the measured joints and thrusts, the former with the mean time after a tick at which its torques are given
    /// \[s\].
    ages: [f64; 2],
    /// Ticks, a whole number and the rest, after which a predicted acceleration is measured.
    lead: (usize, f64),
    /// `G τ` \[rad/s²\].
    by_torque: DVector<f64>,
    response: Vec<f64>,
    command: Vec<f64>,
}

/// State of the measurement of latencies, kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct LatencyState {
    /// Torques, and thrust rates.
    banks: [BankState; 2],
    /// Measured joint positions of the last ticks, the latest first \[rad, m\], and how many follow each other.
    positions: [DVector<f64>; 3],
    measured: usize,
    /// Measured thrusts of this tick and the last one \[N\], and how many follow each other.
    thrusts: [DVector<f64>; 2],
    measured_thrusts: usize,
    /// Accelerations without torques of the last ticks, the latest first \[rad/s²\].
    free: Vec<DVector<f64>>,
    /// `y` and `u` of the torques before differences.
    last: [DVector<f64>; 2],
    /// For how long each has differed from what is known.
    exceeded: [Exceeded; 2],
}

impl Detector for LatencyMonitor {
    type Config = LatencyDetectorConfig;
    type State = LatencyState;
    const MODES: &'static [Mode] = &MODES;

    fn build(config: &LatencyDetectorConfig, of: &Setup) -> Self {
        let (joints, jets) = (of.robot.joints.len(), of.robot.jets.len());
        Self::new(*config, of.estimator, of.torque_steps, joints, jets, of.time_step)
    }

    fn start(&self, estimate: &Estimate) -> LatencyState {
        self.start_of(self.by_torque.len(), estimate.robot.thrust.len())
    }

    fn sizes(&self) -> [usize; 3] {
        [self.lead.0, self.response.len(), self.banks[0].delays]
    }

    fn measure(&self, state: &mut LatencyState, measured: &Estimate) {
        let Estimate { robot, modes, elapsed, .. } = measured;
        let lacks = |mode| modes.contains(mode) || modes.contains(Modes::BEGUN_AGAIN);
        let position = robot.state.joint_position.as_slice();
        let position = (!lacks(Modes::JOINTS_PREDICTED)).then_some(position);
        let thrust = (!lacks(Modes::THRUST_MODELLED)).then_some(&robot.thrust[..]);
        self.take_in(state, position, thrust, *elapsed);
    }

    fn detect(&mut self, state: &mut LatencyState, tick: &Evidence, _: &mut Limits, findings: &mut Findings) {
        let Evidence { estimate, acting, inverse_mass, is_standing, .. } = *tick;
        let is_comparable = estimate.momentum != Sampling::Unknown
            && inverse_mass.is_known
            && !is_standing
            && !estimate.modes.contains(Modes::FEET_PREDICTED)
            && !acting.joints.contains(&JointCondition::Stuck);
        let sample = LatencySample {
            acceleration: &acting.acceleration.as_slice()[6..],
            gain: &inverse_mass.joint_gain,
            torque: &acting.torque,
            thrust_rate: acting.thrust_rate.as_slice(),
        };
        self.compare(state, &sample, is_comparable);
        findings.latency = self.measured(state);
        let late = self.are_late(state, findings.latency, estimate.elapsed);
        if late.contains(&true) {
            findings.modes.insert(Modes::LATE);
        }
        findings.torque_latency = self.to_use(findings.latency[0], late[0]);
    }
}

impl LatencyMonitor {
    /// A monitor for ticks every `time_step` \[s\], in each of which torques are computed `torque_steps` times, beside this
    /// estimator.
    #[must_use]
    pub fn new(
        config: LatencyDetectorConfig,
        estimator: Option<&EstimatorConfig>,
        torque_steps: u32,
        joints: usize,
        jets: usize,
        time_step: f64,
    ) -> Self {
        let known = estimator.map_or([0.0; 2], |of| [of.latency.torque, of.latency.thrust]);
        let mut ages = estimator.map_or([0.0; 2], |of| [of.joint_position.delay, of.thrust.delay]);
        // Decimal fractions are not exact.
        let lead = ((known[0] + ages[0]) / time_step * 1e6).round() / 1e6;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 0.4 s
        let lead = (lead.floor() as usize, lead.fract());
        // The mean of several torques is compared, which are given after the tick.
        ages[0] += 0.5 * time_step * (1.0 - 1.0 / f64::from(torque_steps));
        let size = joints.max(jets);
        Self {
            config,
            banks: Bank::pair(time_step),
            time_step,
            known,
            ages,
            lead,
            by_torque: DVector::zeros(joints),
            response: vec![0.0; size],
            command: vec![0.0; size],
        }
    }

    /// State of a flight with so many joints and jets.
    #[must_use]
    pub fn start_of(&self, joints: usize, jets: usize) -> LatencyState {
        let (none, no_jets) = (DVector::zeros(joints), DVector::zeros(jets));
        LatencyState {
            banks: [self.banks[0].start(joints), self.banks[1].start(jets)],
            positions: std::array::from_fn(|_| none.clone()),
            measured: 0,
            thrusts: [no_jets.clone(), no_jets],
            measured_thrusts: 0,
            free: vec![none.clone(); self.lead.0 + 2],
            last: [none.clone(), none],
            exceeded: [Exceeded::default(); 2],
        }
    }

    /// Takes in what a tick measures, `elapsed` \[s\] after the last one: positions \[rad, m\] and thrusts \[N\], where they
    /// are measured.
    pub fn take_in(
        &self,
        state: &mut LatencyState,
        position: Option<&[f64]>,
        thrust: Option<&[f64]>,
        elapsed: f64,
    ) {
        let is_next = (elapsed - self.time_step).abs() < JITTER * self.time_step;
        let count = |last: usize, is_measured: bool| match (is_measured, is_next) {
            (true, true) => last.saturating_add(1),
            (true, false) => 1,
            (false, _) => 0,
        };
        state.measured = count(state.measured, position.is_some());
        state.measured_thrusts = count(state.measured_thrusts, thrust.is_some());
        if let Some(position) = position {
            state.positions.rotate_right(1);
            state.positions[0].copy_from_slice(position);
        }
        if let Some(thrust) = thrust {
            state.thrusts.rotate_right(1);
            state.thrusts[0].copy_from_slice(thrust);
        }
    }

    /// Compares a tick with the commands before it; torques only where they are comparable.
    pub fn compare(&mut self, state: &mut LatencyState, sample: &LatencySample, is_torque_comparable: bool) {
        let Self { banks, response, command, lead, by_torque, time_step, .. } = self;
        let LatencyState {
            banks: states, positions, measured, thrusts, measured_thrusts, free, last, ..
        } = state;
        let (joints, jets, h) = (positions[0].len(), thrusts[0].len(), *time_step);
        by_torque.fill(0.0);
        add_mat_vec(by_torque.as_mut_slice(), sample.gain.as_slice(), joints, sample.torque.as_slice());
        free.rotate_right(1);
        for (joint, by_torque) in by_torque.iter().enumerate() {
            free[0][joint] = sample.acceleration[joint] - by_torque;
        }
        if is_torque_comparable && *measured > 2 && free[0].iter().all(|x| x.is_finite()) {
            for joint in 0..joints {
                let [now, before, first] = [0, 1, 2].map(|age: usize| positions[age][joint]);
                let free = (1.0 - lead.1) * free[lead.0][joint] + lead.1 * free[lead.0 + 1][joint];
                let moved = now - 2.0 * before + first - h * h * free;
                let driven = h * h * by_torque[joint];
                response[joint] = moved - std::mem::replace(&mut last[0][joint], moved);
                command[joint] = driven - std::mem::replace(&mut last[1][joint], driven);
            }
            banks[0].update(&mut states[0], &response[..joints], &command[..joints]);
        } else {
            states[0].interrupt();
        }
        if *measured_thrusts > 1 {
            for jet in 0..jets {
                response[jet] = thrusts[0][jet] - thrusts[1][jet];
                command[jet] = h * sample.thrust_rate[jet];
            }
            banks[1].update(&mut states[1], &response[..jets], &command[..jets]);
        } else {
            states[1].interrupt();
        }
    }

    /// The measured latencies of torques and thrust rates \[s\]; `None` while they are not known.
    #[must_use]
    pub fn measured(&self, state: &LatencyState) -> [Option<f64>; 2] {
        std::array::from_fn(|of| self.banks[of].delay(&state.banks[of]).map(|delay| delay - self.ages[of]))
    }

    /// The latency of the torques that an estimator is to use from now on \[s\]: the measured one while they are late, else
    /// the known one; `None` while it is not measured.
    #[must_use]
    pub fn to_use(&self, measured: Option<f64>, are_late: bool) -> Option<f64> {
        measured.map(|measured| if are_late { measured } else { self.known[0] })
    }

    /// Whether torques and thrust rates are late, or earlier than is known, `elapsed` \[s\] after the last tick.
    pub fn are_late(&self, state: &mut LatencyState, measured: [Option<f64>; 2], elapsed: f64) -> [bool; 2] {
        let greatest = [self.config.torque_max, self.config.thrust_max];
        for of in 0..2 {
            let differs = measured[of].is_some_and(|delay| (delay - self.known[of]).abs() > greatest[of]);
            state.exceeded[of].update(differs, elapsed);
        }
        state.exceeded.map(|exceeded| exceeded.has_lasted(self.config.confirmation, elapsed))
    }
}
