//! Detection of joints that do not follow their torques: stuck, weak, free.
//!
//! ```text
//! e = (ν_k − ν_{k−1}) / Δt − ν̇_{k−1}          acceleration of the joints that the model does not explain
//! ē ← e after a lag of τ_e,  m ← e after a lag of τ_m,  x = ē − m
//! z_j = g_jᵀ x / |g_j|                       its part along G's column g_j: what a torque of joint j causes
//! ```
//!
//! Air, thrusts and masses that differ from the model accelerate several joints at once; a faulty joint causes `x` along
//! one column. While it does, the regression of the unexplained torque on the commanded one gives the share of the torque
//! that acts: that of a weak joint, or about zero for a free one. A stuck joint does not move while it is commanded to.
//! What is found is revised in the same way: a share by the regression, a stuck joint when it moves.
//!
//! A push on a body that one joint carries causes `x` along one column as well. It changes the momentum, which no torque of
//! a joint does: nothing is judged while the moment's residual of [`super::observer`] exceeds a share of its greatest.
//! Equation M143 of `docs/model`.

use super::observer::ObserverConfig;
use super::{Stage, Tick};
use crate::control::command::Command;
use crate::control::law::limits::JointCondition;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::error::{BuildError, Table};
use crate::kinematics::RobotState;
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Lag `τ_e` of the unexplained acceleration \[s\].
const LAG: f64 = 0.02;
/// Lag `τ_m` of its mean, which errors of the model have \[s\].
const MEAN_LAG: f64 = 0.3;
/// Lag of the mean of `z²`, which errors of the model have in wind, and how often its root `z` has to be \[s\].
const LEVEL_LAG: f64 = 1.0;
const LEVELS: f64 = 4.0;
/// Time in which displacements are forgotten \[s\].
const WINDOW: f64 = 0.3;
/// Time without judgement after the start, until the mean is known \[s\].
const SETTLING: f64 = 2.0;
/// Share of `|x|²` that is along one column if one joint causes it.
const DOMINANCE: f64 = 0.75;
/// Share of `|x|²` along its column that a stuck joint has at least, and of `acceleration_max`: it shows by its
/// displacement, too.
const STUCK_DOMINANCE: f64 = 0.5;
const STUCK_SHARE: f64 = 0.4;
/// Share of the commanded displacement that a stuck joint moves at most.
const STILL: f64 = 0.1;
/// Longest way within [`WINDOW`] of a joint that stands still, with the steps of its encoder \[rad, m\].
const STILL_WAY: f64 = 0.004;
/// Distance from a stop within which a joint may be at it: 3° of an encoder's offset and some more \[rad, m\]. There it is
/// not stuck if it is commanded towards the stop, or if the stop may be what is not explained.
const STOP_MARGIN: f64 = 0.087;
/// Time for which a joint has to stand still in the latter case \[s\].
const STOP_CONFIRMATION: f64 = 0.3;
/// A joint is judged when it was suspected for this time with the least `z` of a suspicion, or for less with more, but for
/// two ticks \[s\].
const CONFIRMATION: f64 = 0.06;
/// Time for which a joint that is commanded to move has to stand still \[s\].
const STUCK_CONFIRMATION: f64 = 0.03;
/// A suspicion that is not confirmed in this time is an error of the model \[s\].
const SUSPICION_MAX: f64 = 0.2;
/// Time without judgement after something was found, because estimates follow late; and least time of a suspicion that
/// changes what was found \[s\].
const PAUSE: f64 = 0.2;
const REVISION: f64 = 0.1;
/// A joint with less of its torque is free, and one with more is as it should be.
const FREE_SHARE: f64 = 0.15;
const HEALTHY_SHARE: f64 = 0.85;
/// Share of the observer's greatest moment that its residual has in a push, and beyond which nothing is judged.
pub const PUSH_SHARE: f64 = 0.05;
/// Displacement by which a weak joint differs from a stuck one \[rad, m\].
const MOVED: f64 = 0.002;
/// Displacement by which a stuck joint is found to move again \[rad, m\], and the velocity with which it is tried
/// \[rad/s, m/s\].
const RELEASED: f64 = 0.02;
const TRIED_VELOCITY: f64 = 0.02;

/// When a joint counts as stuck, weak or free.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct JointsConfig {
    /// Greatest unexplained acceleration in the direction of one joint's torque \[rad/s²\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub acceleration_max: f64,
    /// Greatest share of the torque that acts at a weak joint; with more it is not judged.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 1)))]
    pub share_max: f64,
    /// Least commanded displacement within 0.3 s that shows whether a joint is stuck \[rad, m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub displacement_min: f64,
}

impl JointsConfig {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let table = Table("controller.joints");
        table.check_positive("acceleration_max", self.acceleration_max)?;
        table.check("share_max", self.share_max, |x| (0.0..=1.0).contains(&x), "a share from 0 to 1")?;
        table.check_positive("displacement_min", self.displacement_min)
    }
}

/// That the torque of a joint may not act.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Suspicion {
    /// Time since its first tick; zero without a suspicion \[s\].
    time: f64,
    /// Time that counts for the judgement \[s\].
    evidence: f64,
    /// `Σ u τ` of unexplained and commanded torques, and `Σ τ²`.
    product: f64,
    square: f64,
    /// Position of the joint at the beginning \[rad, m\].
    position: f64,
}

/// State of the detection, kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct JointsState {
    /// `ē` \[rad/s²\].
    acceleration: DVector<f64>,
    /// `m` \[rad/s²\].
    mean: DVector<f64>,
    /// Mean of `z²` of every joint \[rad²/s⁴\].
    level: DVector<f64>,
    /// Last measured positions \[rad, m\].
    position: DVector<f64>,
    /// Length of the measured way of every joint \[rad, m\], forgotten with [`WINDOW`].
    way: DVector<f64>,
    /// Commanded displacement \[rad, m\], likewise.
    commanded: DVector<f64>,
    /// Time for which the joint has stood still against its command \[s\].
    still: DVector<f64>,
    suspicions: Vec<Suspicion>,
    /// Time until judgement begins \[s\].
    pause: f64,
    /// Condition of every joint, as found.
    pub found: Vec<JointCondition>,
    /// Position in which a joint was found to be stuck \[rad, m\].
    stuck_at: DVector<f64>,
}

/// Values of a tick, by joint.
#[derive(Debug)]
pub struct Sample<'a> {
    /// Time since the last tick \[s\].
    pub dt: f64,
    /// `e` \[rad/s²\].
    pub unexplained: &'a DVector<f64>,
    /// `G` \[1/(kg m²)\].
    pub gain: &'a DMatrix<f64>,
    /// Torques commanded in the last tick, the mean of several \[N m\].
    pub torque: &'a DVector<f64>,
    /// Stops of every joint, lower and upper \[rad, m\].
    pub stops: &'a [(f64, f64)],
}

impl JointsState {
    /// State of a flight that starts in these positions \[rad, m\].
    #[must_use]
    pub fn new(position: &DVector<f64>) -> Self {
        let none = DVector::zeros(position.len());
        Self {
            acceleration: none.clone(),
            mean: none.clone(),
            level: none.clone(),
            position: position.clone(),
            way: none.clone(),
            commanded: none.clone(),
            still: none.clone(),
            suspicions: vec![Suspicion::default(); position.len()],
            pause: SETTLING,
            found: vec![JointCondition::Healthy; position.len()],
            stuck_at: none,
        }
    }

    /// Whether it has the sizes of a robot with `joints` joints.
    #[must_use]
    pub fn fits(&self, joints: usize) -> bool {
        self.found.len() == joints && self.position.len() == joints
    }

    /// Begins again in these positions \[rad, m\]; what is found stays.
    pub fn begin_again(&mut self, position: &DVector<f64>) {
        self.position.copy_from(position);
        self.way.fill(0.0);
        self.commanded.fill(0.0);
        self.mean.fill(0.0);
        self.level.fill(0.0);
        self.pause = SETTLING;
        self.hold();
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
    pub fn hold(&mut self) {
        self.pause = self.pause.max(PAUSE);
        self.acceleration.copy_from(&self.mean);
        self.still.fill(0.0);
        self.suspicions.fill(Suspicion::default());
    }

    /// Compares a tick with the last one, and changes [`Self::found`] where a joint is found to be otherwise.
    pub fn judge(&mut self, config: &JointsConfig, sample: &Sample) {
        let Sample { dt, unexplained, .. } = *sample;
        let share = |lag: f64| -libm::expm1(-dt / lag);
        let (fast, slow, slowest) = (share(LAG), share(MEAN_LAG), share(LEVEL_LAG));
        for (to, e) in self.acceleration.iter_mut().zip(unexplained) {
            *to += fast * (e - *to);
        }
        self.pause -= dt;
        // Half a tick absorbs rounding.
        if self.pause < 0.5 * dt {
            self.suspect(config, sample);
            self.find_stuck(config, sample);
            self.release();
        }
        let is_usual = |now: &Suspicion| now.time == 0.0 || now.time > SUSPICION_MAX;
        for joint in 0..self.found.len() {
            if is_usual(&self.suspicions[joint]) {
                let (z, _) = self.along(sample.gain, joint);
                self.level[joint] += slowest * (z * z - self.level[joint]);
            }
        }
        if self.suspicions.iter().all(is_usual) {
            for (to, e) in self.mean.iter_mut().zip(unexplained) {
                *to += slow * (e - *to);
            }
        }
    }

    /// `x` along `g_j`, and the norm of `g_j`.
    fn along(&self, gain: &DMatrix<f64>, joint: usize) -> (f64, f64) {
        let column = gain.column(joint);
        let norm = column.norm();
        ((column.dot(&self.acceleration) - column.dot(&self.mean)) / norm, norm)
    }

    fn size_squared(&self) -> f64 {
        self.acceleration.iter().zip(&self.mean).map(|(e, mean)| (e - mean) * (e - mean)).sum()
    }

    /// Follows joints along whose columns `x` is, until their shares of the torque are known.
    fn suspect(&mut self, config: &JointsConfig, sample: &Sample) {
        let Sample { dt, unexplained, gain, torque, .. } = *sample;
        let size = self.size_squared();
        let mut worst: Option<(usize, f64, JointCondition)> = None;
        for joint in 0..self.found.len() {
            let (along, norm) = self.along(gain, joint);
            let (z, last) = (along.abs(), self.found[joint]);
            let is_known = last != JointCondition::Healthy;
            let level = if is_known { 0.0 } else { self.level[joint] };
            let least = config.acceleration_max.max(LEVELS * level.sqrt());
            if last == JointCondition::Stuck || z <= least || z * z <= DOMINANCE * size {
                self.suspicions[joint] = Suspicion::default();
                continue;
            }
            let now = &mut self.suspicions[joint];
            let is_second = now.time > 0.0;
            if !is_second {
                now.position = self.position[joint];
            }
            let column = gain.column(joint);
            let u = (column.dot(unexplained) - column.dot(&self.mean)) / (norm * norm);
            now.time += dt;
            now.evidence += dt * z / least;
            now.product += u * torque[joint];
            now.square += torque[joint] * torque[joint];
            let is_sure =
                if is_known { now.time > REVISION } else { is_second && now.evidence > CONFIRMATION };
            let has_moved = (self.position[joint] - now.position).abs() > MOVED;
            let acting = last.share() + now.product / now.square;
            let greatest = if is_known { 1.0 + FREE_SHARE } else { config.share_max };
            let is_share = acting > -2.0 * FREE_SHARE && acting < greatest;
            if is_sure && has_moved && is_share && worst.is_none_or(|(_, greatest, _)| z > greatest) {
                worst = Some((joint, z, JointCondition::of_share(acting)));
            }
        }
        if let Some((joint, _, found)) = worst {
            self.found[joint] = found;
            self.hold();
        }
    }

    /// Finds joints that stand still although they are commanded to move, and are unexplained in that direction.
    fn find_stuck(&mut self, config: &JointsConfig, sample: &Sample) {
        let size = self.size_squared();
        for joint in 0..self.found.len() {
            let commanded = self.commanded[joint];
            let (z, _) = self.along(sample.gain, joint);
            let (position, (lower, upper)) = (self.position[joint], sample.stops[joint]);
            let (mut ahead, mut behind) = (upper - position, position - lower);
            if commanded < 0.0 {
                (ahead, behind) = (behind, ahead);
            }
            let opposes = |z: f64| -z * commanded.signum() > STUCK_SHARE * config.acceleration_max;
            // The mean contains what a stop behind the joint carries.
            let column = sample.gain.column(joint);
            let with_mean = column.dot(&self.acceleration) / column.norm();
            let is_still = self.found[joint] != JointCondition::Stuck
                && commanded.abs() > config.displacement_min
                && ahead > STOP_MARGIN
                && (behind > STOP_MARGIN || opposes(with_mean))
                && self.way[joint] < STILL_WAY.min(STILL * commanded.abs())
                && opposes(z)
                && z * z > STUCK_DOMINANCE * size;
            self.still[joint] = if is_still { self.still[joint] + sample.dt } else { 0.0 };
            let confirmation = if behind > STOP_MARGIN { STUCK_CONFIRMATION } else { STOP_CONFIRMATION };
            if self.still[joint] > confirmation - 0.5 * sample.dt {
                self.found[joint] = JointCondition::Stuck;
                self.stuck_at[joint] = self.position[joint];
                self.still[joint] = 0.0;
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
    pub fn of_share(share: f64) -> Self {
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

/// Modes of joints in these conditions.
#[must_use]
pub fn modes(found: &[JointCondition]) -> Modes {
    if found.iter().all(|found| *found == JointCondition::Healthy) {
        Modes::default()
    } else {
        Modes::JOINT_LIMITED
    }
}

/// Finds joints that do not follow their torques, and bounds what the law demands of them.
#[derive(Debug, Clone)]
pub struct Joints {
    config: JointsConfig,
    time_step: f64,
    /// Residual of the moment beyond which something pushes the robot \[N m\].
    moment_max: f64,
    /// Stops of the joints, lower and upper \[rad, m\].
    stops: Vec<(f64, f64)>,
    unexplained: DVector<f64>,
}

impl Joints {
    /// The stage for the joints of `robot`, with ticks every `time_step` \[s\], beside this observer.
    #[must_use]
    pub fn new(
        config: JointsConfig,
        observer: Option<&ObserverConfig>,
        robot: &RobotModel,
        time_step: f64,
    ) -> Self {
        let stops: Vec<_> = robot.joints.iter().map(|joint| joint.stops).collect();
        let moment_max = observer.map_or(f64::INFINITY, |observer| PUSH_SHARE * observer.moment_max);
        Self { config, time_step, moment_max, unexplained: DVector::zeros(stops.len()), stops }
    }
}

impl Stage for Joints {
    fn name(&self) -> &'static str {
        "joints"
    }

    fn start(&self, state: &mut ControllerState, robot: &RobotState, _: &[f64]) {
        state.joints = Some(JointsState::new(&robot.joint_position));
    }

    fn fits(&self, state: &ControllerState) -> bool {
        state.joints.as_ref().is_some_and(|joints| joints.fits(self.unexplained.len()))
    }

    fn measure(&mut self, tick: &mut Tick) {
        let Some(joints) = &mut tick.state.joints else { return };
        let used = &tick.terms.measurement;
        if used.modes.contains(Modes::BEGUN_AGAIN) {
            joints.begin_again(&used.state.joint_position);
        }
        let is_measured = !used.modes.contains(Modes::JOINTS_PREDICTED);
        joints.measure(&used.state.joint_position, is_measured, used.elapsed);
    }

    fn judge(&mut self, tick: &mut Tick) {
        let ControllerState { joints, engines, channels, contact, observer, velocity_error_integral, .. } =
            &mut *tick.state;
        let Some(joints) = joints else { return };
        let Terms { measurement: used, inverse_mass, limits, .. } = &mut *tick.terms;
        let is_comparable = used.has_momentum && inverse_mass.is_known && !contact.is_active;
        let is_pushed = parts(&observer.residual).1.norm() > self.moment_max;
        if is_comparable && !is_pushed && !engines.iter().any(|engine| engine.is_doubted) {
            let last = channels.commanded_in.joint_velocity();
            let predicted = channels.acceleration.rows(6, self.unexplained.len());
            for (joint, velocity) in used.state.joint_velocity().iter().enumerate() {
                self.unexplained[joint] = (velocity - last[joint]) / used.elapsed - predicted[joint];
            }
            joints.judge(
                &self.config,
                &Sample {
                    dt: used.elapsed,
                    unexplained: &self.unexplained,
                    gain: &inverse_mass.joint_gain,
                    torque: &channels.joint_torque,
                    stops: &self.stops,
                },
            );
        } else {
            joints.hold();
        }
        limits.joints.copy_from_slice(&joints.found);
        for (joint, found) in joints.found.iter().enumerate() {
            limits.joint_velocity[joint] = found.velocity_max(limits.joint_velocity[joint]);
            if matches!(found, JointCondition::Stuck | JointCondition::Free) {
                velocity_error_integral[joint] = 0.0; // it follows no velocity
            }
        }
        used.modes.insert(modes(&joints.found));
    }

    fn predict(&mut self, tick: &mut Tick, command: &Command) {
        if let Some(joints) = &mut tick.state.joints {
            joints.command(&command.joint_velocity, self.time_step);
        }
    }
}
