//! Detection of joints that do not follow their torques: stuck, weak, free.
//!
//! ```text
//! r = M ((ν_k − ν_{k−1}) / Δt − ν̇_{k−1}) + (ŵ; 0)      generalised force that the model does not explain, all rows
//! r̄ ← r after a lag of τ_r,  m ← r after a lag of τ_m,  x = r̄ − m
//! ρ_j = |x_j| / (ℓ |x_F| + |x_M| + τ_0)                x_F, x_M: rows of the base
//! ```
//!
//! A joint's fault is internal: it shows in the joint's own row alone. Whatever touches the robot from outside, or errors of
//! thrusts and air, show in the rows of the base, and in those of the joints by at most their reach ℓ times the force. A joint
//! with ρ > 1 for a confirmation time is faulty: stuck if it stands still while it is commanded to move; otherwise the
//! regression of x on the commanded torque gives the share of the torque that acts. What is found is revised in the same way.
//! Equation M143 of `docs/model`; Haddadin, De Luca and Albu-Schäffer, "Robot collisions", IEEE T-RO 2017, have the
//! residual of the momentum.

use super::detector::{Detector, Evidence, Findings, Setup};
use crate::control::command::Command;
use crate::control::limits::{JointCondition, Limits};
use crate::control::measure::measurement::{Estimate, Sampling};
use crate::control::modes::{Mode, Modes, modes};
use crate::robot::RobotModel;
use crate::timing::{Exceeded, share};
use nalgebra::{DVector, Vector3};
use serde::{Deserialize, Serialize};

modes! {
    MODES:
    /// A joint does not follow its torque.
    JOINT_LIMITED = 12, "joint_limited";
}

/// Lag `τ_r` of the residual \[s\].
const LAG: f64 = 0.05;
/// Lag `τ_m` of its mean, which errors of the model have \[s\].
const MEAN_LAG: f64 = 1.0;
/// Distance `ℓ` beyond which no joint carries a body \[m\].
const REACH: f64 = 1.0;
/// Time in which displacements are forgotten \[s\].
const WINDOW: f64 = 0.3;
/// Time without judgement after the start, until the mean is known, and after something was found \[s\].
const SETTLING: f64 = 2.0;
const PAUSE: f64 = 0.2;
/// Share of the commanded displacement that a stuck joint moves at most, and its longest way within [`WINDOW`], with the steps
/// of its encoder \[rad, m\].
const STILL: f64 = 0.1;
const STILL_WAY: f64 = 0.004;
/// Distance from a stop within which a joint may be at it, with an encoder that is wrong by 3° \[rad, m\]: there it is not
/// stuck if it is commanded towards the stop.
const STOP_MARGIN: f64 = 0.087;
/// Least commanded displacement within [`WINDOW`] that shows whether a joint is stuck \[rad, m\].
const COMMANDED: f64 = 0.005;
/// Displacement by which a weak joint differs from a stuck one \[rad, m\].
const MOVED: f64 = 0.002;
/// Displacement by which a stuck joint is found to move again \[rad, m\], and the velocity with which it is tried
/// \[rad/s, m/s\].
const RELEASED: f64 = 0.02;
const TRIED_VELOCITY: f64 = 0.02;
/// Time after which a residual that is not judged is an error of the model \[s\].
const SUSPICION_MAX: f64 = 1.0;
/// Error of a share that a short time shows. With less than twice this a joint is free; with the whole torque but this it is as
/// it should be.
const SHARE_ERROR: f64 = 0.15;
const FREE_SHARE: f64 = 2.0 * SHARE_ERROR;
const HEALTHY_SHARE: f64 = 1.0 - SHARE_ERROR;

/// When a joint counts as stuck, weak or free.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointsConfig {
    /// `τ_0`: unexplained torque that friction and noise cause \[N m, N\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub torque_min: f64,
    /// Time for which a joint has to be suspected \[s\].
    #[schemars(range(min = 0))]
    pub confirmation: f64,
    /// Greatest share of the torque that acts at a weak joint; with more it is not judged.
    #[schemars(range(min = 0, max = 1))]
    pub effectiveness_max: f64,
}

/// That the torque of a joint may not act.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Suspicion {
    /// For how long it has been there.
    lasting: Exceeded,
    /// `Σ x τ` of unexplained and commanded torques, and `Σ τ²`.
    product: f64,
    square: f64,
    /// Position of the joint at the beginning \[rad, m\].
    position: f64,
}

/// State of the detection, kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct JointsState {
    /// `r̄` and `m` \[N, N m\].
    residual: DVector<f64>,
    mean: DVector<f64>,
    /// Last measured positions \[rad, m\].
    position: DVector<f64>,
    /// Length of the measured way of every joint \[rad, m\], forgotten with [`WINDOW`].
    way: DVector<f64>,
    /// Commanded displacement \[rad, m\], likewise.
    commanded: DVector<f64>,
    suspicions: Vec<Suspicion>,
    /// Time until judgement begins \[s\].
    pause: f64,
    /// Condition of every joint, as found.
    pub found: Vec<JointCondition>,
    /// Position in which a joint was found to be stuck \[rad, m\].
    stuck_at: DVector<f64>,
}

/// The detection of one controller, with the workspace of `r`.
#[derive(Debug, Clone)]
pub struct Joints {
    config: JointsConfig,
    time_step: f64,
    /// Stops of the joints, lower and upper \[rad, m\].
    stops: Vec<(f64, f64)>,
    unexplained: DVector<f64>,
    residual: DVector<f64>,
}

impl Joints {
    /// A detection for the joints of `robot`, with ticks every `time_step` \[s\].
    #[must_use]
    pub fn new(config: JointsConfig, robot: &RobotModel, time_step: f64) -> Self {
        let stops: Vec<_> = robot.joints.iter().map(|joint| joint.stops).collect();
        let rows = DVector::zeros(6 + stops.len());
        Self { config, time_step, stops, unexplained: rows.clone(), residual: rows }
    }

    /// What a tick shows of the joints.
    fn sample<'a>(&'a mut self, tick: &Evidence<'a>) -> JointSample<'a> {
        let Evidence { estimate, acting, dynamics, kinematics, momentum, .. } = *tick;
        let velocities = estimate.robot.state.velocity.iter().zip(&acting.velocity);
        for ((to, (now, before)), predicted) in
            self.unexplained.iter_mut().zip(velocities).zip(&acting.acceleration)
        {
            *to = (now - before) / estimate.elapsed - predicted;
        }
        dynamics.add_whole_acceleration(kinematics, &momentum.unmodelled_wrench, &mut self.unexplained);
        self.residual.gemv(1.0, &dynamics.mass_matrix, &self.unexplained, 0.0);
        JointSample {
            dt: estimate.elapsed,
            residual: &self.residual,
            torque: &acting.joint_torque,
            stops: &self.stops,
        }
    }
}

impl Detector for Joints {
    type Config = JointsConfig;
    type State = JointsState;
    const MODES: &'static [Mode] = &MODES;

    fn build(config: &JointsConfig, of: &Setup) -> Self {
        Self::new(*config, of.robot, of.time_step)
    }

    fn start(&self, estimate: &Estimate) -> JointsState {
        JointsState::new(&estimate.robot.state.joint_position)
    }

    fn measure(&self, state: &mut JointsState, measured: &Estimate) {
        let position = &measured.robot.state.joint_position;
        if measured.modes.contains(Modes::BEGUN_AGAIN) {
            state.begin_again(position);
        }
        state.measure(position, !measured.modes.contains(Modes::JOINTS_PREDICTED), measured.elapsed);
    }

    fn detect(
        &mut self,
        state: &mut JointsState,
        tick: &Evidence,
        limits: &mut Limits,
        findings: &mut Findings,
    ) {
        // A first tick is compared with none.
        let is_measured = tick.estimate.momentum == Sampling::Measured;
        if is_measured && tick.inverse_mass.is_known && !tick.is_standing {
            let config = self.config;
            state.update(&config, &self.sample(tick));
        } else {
            state.interrupt();
        }
        limits.joints.copy_from_slice(&state.found);
        if state.found.iter().any(|found| *found != JointCondition::Healthy) {
            findings.modes.insert(Modes::JOINT_LIMITED);
        }
    }

    fn command(&self, state: &mut JointsState, command: &Command) {
        state.command(&command.joint_velocity, self.time_step);
    }
}

/// Values of a tick.
#[derive(Debug)]
pub struct JointSample<'a> {
    /// Time since the last tick \[s\].
    pub dt: f64,
    /// `r`, base first \[N, N m\].
    pub residual: &'a DVector<f64>,
    /// Torques commanded in the last tick, the mean of several \[N m, N\].
    pub torque: &'a DVector<f64>,
    /// Stops of every joint, lower and upper \[rad, m\].
    pub stops: &'a [(f64, f64)],
}

impl JointsState {
    /// State of a flight that starts in these positions \[rad, m\].
    #[must_use]
    pub fn new(position: &DVector<f64>) -> Self {
        let (none, rows) = (DVector::zeros(position.len()), DVector::zeros(6 + position.len()));
        Self {
            residual: rows.clone(),
            mean: rows,
            position: position.clone(),
            way: none.clone(),
            commanded: none.clone(),
            suspicions: vec![Suspicion::default(); position.len()],
            pause: SETTLING,
            found: vec![JointCondition::Healthy; position.len()],
            stuck_at: none,
        }
    }

    /// `m`, the part of the residual that is an error of the model \[N, N m\].
    #[must_use]
    pub fn mean(&self) -> &DVector<f64> {
        &self.mean
    }

    /// Begins again in these positions \[rad, m\]; what is found stays.
    pub fn begin_again(&mut self, position: &DVector<f64>) {
        self.position.copy_from(position);
        self.way.fill(0.0);
        self.commanded.fill(0.0);
        self.mean.fill(0.0);
        self.pause = SETTLING;
        self.interrupt();
    }

    /// Takes in the measured positions of a tick \[rad, m\], `dt` \[s\] after the last one, or that the joints are not
    /// measured in it.
    pub fn measure(&mut self, position: &DVector<f64>, is_measured: bool, dt: f64) {
        let left = libm::exp(-dt / WINDOW);
        for (joint, position) in position.iter().enumerate() {
            let moved = if is_measured { (position - self.position[joint]).abs() } else { 0.0 };
            self.way[joint] = left * self.way[joint] + moved;
            self.commanded[joint] *= left;
            if is_measured {
                self.position[joint] = *position;
            }
        }
    }

    /// Takes in the velocities that are commanded from this tick on \[rad/s\].
    pub fn command(&mut self, velocity: &DVector<f64>, time_step: f64) {
        self.commanded.axpy(time_step, velocity, 1.0);
    }

    /// Forgets what is not explained, in a tick in which nothing can be compared, and judges nothing for a while.
    pub fn interrupt(&mut self) {
        self.pause = self.pause.max(PAUSE);
        self.residual.copy_from(&self.mean);
        self.suspicions.fill(Suspicion::default());
    }

    /// Compares a tick with the last one, and changes [`Self::found`] where a joint is found to be otherwise.
    pub fn update(&mut self, config: &JointsConfig, sample: &JointSample) {
        let JointSample { dt, residual, .. } = *sample;
        let (fast, slow) = (share(dt / LAG), share(dt / MEAN_LAG));
        for (to, now) in self.residual.iter_mut().zip(residual) {
            *to += fast * (now - *to);
        }
        self.pause -= dt;
        // Half a tick absorbs rounding.
        if self.pause < 0.5 * dt {
            self.suspect(config, sample);
            self.release();
        }
        self.rest(sample.stops);
        if self.suspicions.iter().all(|now| now.lasting.time() == 0.0 || now.lasting.time() > SUSPICION_MAX) {
            for (to, now) in self.mean.iter_mut().zip(residual) {
                *to += slow * (now - *to);
            }
        }
    }

    /// Follows joints whose rows are more than a touch can cause, until it is known what they do.
    fn suspect(&mut self, config: &JointsConfig, sample: &JointSample) {
        let JointSample { dt, residual, torque, .. } = *sample;
        let x = |row: usize| self.residual[row] - self.mean[row];
        let norm = |first: usize| Vector3::from_fn(|axis, _| x(first + axis)).norm();
        let bound = REACH * norm(0) + norm(3) + config.torque_min;
        let mut worst: Option<(usize, f64, JointCondition)> = None;
        for joint in 0..self.found.len() {
            let (size, last) = (x(6 + joint).abs(), self.found[joint]);
            if size <= bound || last == JointCondition::Stuck {
                self.suspicions[joint] = Suspicion::default();
                continue;
            }
            let now = &mut self.suspicions[joint];
            if now.lasting.time() == 0.0 {
                now.position = self.position[joint];
            }
            now.lasting.update(true, dt);
            // Without the lag, which a regression over a short time would take for a share.
            now.product += (residual[6 + joint] - self.mean[6 + joint]) * torque[joint];
            now.square += torque[joint] * torque[joint];
            if !now.lasting.has_lasted(config.confirmation, dt) {
                continue;
            }
            let has_moved = (self.position[joint] - now.position).abs() > MOVED;
            let acting = last.effectiveness() + now.product / now.square;
            let greatest =
                if last == JointCondition::Healthy { config.effectiveness_max } else { 1.0 + SHARE_ERROR };
            let found = if self.is_still(sample, joint) {
                JointCondition::Stuck
            } else if has_moved && acting > -FREE_SHARE && acting < greatest {
                JointCondition::of_effectiveness(acting)
            } else {
                continue;
            };
            if worst.is_none_or(|(_, greatest, _)| size > greatest) {
                worst = Some((joint, size, found));
            }
        }
        if let Some((joint, _, found)) = worst {
            self.found[joint] = found;
            self.stuck_at[joint] = self.position[joint];
            self.interrupt();
        }
    }

    /// Whether a joint stands still although it is commanded to move, against a torque that the model does not contain, and
    /// not by a stop.
    fn is_still(&self, sample: &JointSample, joint: usize) -> bool {
        let (commanded, position) = (self.commanded[joint], self.position[joint]);
        let (lower, upper) = sample.stops[joint];
        let (mut ahead, mut behind) = (upper - position, position - lower);
        if commanded < 0.0 {
            (ahead, behind) = (behind, ahead);
        }
        let (residual, mean) = (self.residual[6 + joint], self.mean[6 + joint]);
        // The mean contains what a stop behind the joint carries, which is no resistance when it carries less.
        let resisted = if behind > STOP_MARGIN { residual - mean } else { residual };
        let opposes = resisted * commanded < 0.0;
        commanded.abs() > COMMANDED
            && opposes
            && ahead > STOP_MARGIN
            && self.way[joint] < STILL_WAY.min(STILL * commanded.abs())
    }

    /// Takes weak and free joints that rest at a stop for stuck: the stop carries what their torques do not.
    fn rest(&mut self, stops: &[(f64, f64)]) {
        for (joint, (lower, upper)) in stops.iter().enumerate() {
            let position = self.position[joint];
            let is_at_stop = (position - lower).min(upper - position) < STOP_MARGIN;
            let lacks_torque = matches!(self.found[joint], JointCondition::Weak(_) | JointCondition::Free);
            if lacks_torque && is_at_stop && self.way[joint] < STILL_WAY {
                self.found[joint] = JointCondition::Stuck;
                self.stuck_at[joint] = position;
            }
        }
    }

    /// Takes up stuck joints that move.
    fn release(&mut self) {
        for (joint, found) in self.found.iter_mut().enumerate() {
            if *found == JointCondition::Stuck
                && (self.position[joint] - self.stuck_at[joint]).abs() > RELEASED
            {
                *found = JointCondition::Healthy;
            }
        }
    }
}

impl JointCondition {
    /// The condition of a joint at which this share of the torque acts.
    #[must_use]
    pub fn of_effectiveness(share: f64) -> Self {
        match share {
            _ if share < FREE_SHARE => Self::Free,
            _ if share > HEALTHY_SHARE => Self::Healthy,
            _ => Self::Weak(share),
        }
    }

    /// Greatest velocity that is commanded, where it is `usual` for a joint that follows \[rad/s, m/s\]: a stuck joint is
    /// tried slowly, a free one is not.
    #[must_use]
    pub fn velocity_max(self, usual: f64) -> f64 {
        match self {
            Self::Healthy | Self::Weak(_) => usual,
            Self::Stuck => usual.min(TRIED_VELOCITY),
            Self::Free => 0.0,
        }
    }
}
