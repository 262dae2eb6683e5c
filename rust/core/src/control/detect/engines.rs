//! Detection of engines that do not follow their commands, and of faulty thrust sensors.
//!
//! ```text
//! d ← e^{−Δt/τ} d + (T_k − T̂_k)              deviation of the thrust from the commanded one, T̂ by M31
//! l ← e^{−Δt/τ} l + Δt (Ṫ_e − Ṫ*)             that of an engine at the limits of its throttle
//! d̄ ← d − [0, λ l] after lags of τ_e and τ_n  the part outside, delayed as the momentum is
//! n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)       residual of the momentum with respect to the observed wrench
//! ```
//!
//! If `|d̄|` stays above its limit for a confirmation time, either the engine does not reach its commanded thrust or
//! its sensor is wrong. Wrong sensors add `−d` times their jets' columns of `A_T` to the residual of the momentum,
//! engines add nothing; several that deviate at once are one or the other together. The thrust at which an engine
//! stops becomes a bound on its commanded thrust, and an engine whose bounds are close together is lost. Equations
//! M105, M106, M144 and M176 of `docs/model`.
//!
//! Where the speed of a shaft is measured, it alone judges the engine: a deviation beyond that of engines whose ramps are
//! slower and faster than known is the engine's, whatever the momentum shows.

use super::detector::{Detector, Evidence, Findings, Setup};
use crate::control::estimate::disturbance_observer::residual_share;
use crate::control::law::attitude::MomentumGains;
use crate::control::limits::Limits;
use crate::control::measure::measurement::{Estimate, Sampling};
use crate::control::modes::{Mode, Modes, modes};
use crate::jets::{EngineModel, JetDynamics};
use crate::robot::{Joint, JointKind, RobotModel};
use crate::spatial::parts;
use crate::timing::Exceeded;
use nalgebra::{Matrix6xX, Vector6};
use serde::{Deserialize, Serialize};

modes! {
    MODES:
    /// An engine does not reach its commanded thrust.
    ENGINE_LIMITED = 10, "engine_limited";
}

/// Lever arm that makes a force comparable with a moment \[m\]: that of the air that no model contains. Gyroscopes are
/// less noisy than velocities, and aerodynamic forces change more than their moments.
const FORCE_ARM: f64 = 0.04;

/// Ramps of a healthy engine, relative to those known.
const RAMPS: [f64; 2] = [0.7, 1.3];

/// Time constant `τ` with which deviations of the thrust decay \[s\].
const MEMORY: f64 = 0.5;

/// Time for which a deviation has to exceed its limit \[s\].
const CONFIRMATION: f64 = 0.03;

/// When an engine counts as not reaching its thrust, and when as lost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnginesConfig {
    /// Greatest deviation of a thrust from the commanded one \[N\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub deviation_max: f64,
    /// Levelling and descent after the loss of an engine; without it the mission continues.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub descent: Option<DescentConfig>,
}

/// Descent without an engine: attitude has priority, the position is not held, and joints are fast.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DescentConfig {
    /// An engine is lost if its least and greatest thrust differ by less than this fraction of the jet's greatest
    /// thrust.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub range_fraction_min: f64,
    /// Gains in place of `controller.momentum`.
    pub momentum: MomentumGains,
    /// Greatest joint velocity during the descent \[deg/s\], for revolute joints whose own limit is lower.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_velocity_max_deg: f64,
    /// Greatest rate of a joint torque during the descent \[N m/s\], for revolute joints whose own limit is lower.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub torque_rate_max: f64,
}

impl DescentConfig {
    /// Greatest velocity of a joint during the descent \[rad/s, m/s\].
    #[must_use]
    pub fn velocity_max(&self, joint: &Joint) -> f64 {
        match joint.kind {
            JointKind::Revolute => joint.velocity_max.max(self.joint_velocity_max_deg.to_radians()),
            JointKind::Prismatic => joint.velocity_max,
        }
    }

    /// Greatest torque rate of a joint during the descent \[N m/s, N/s\].
    #[must_use]
    pub fn torque_rate_max(&self, joint: &Joint) -> f64 {
        match joint.kind {
            JointKind::Revolute => joint.torque_rate_max.max(self.torque_rate_max),
            JointKind::Prismatic => joint.torque_rate_max,
        }
    }
}

/// Monitor state of one engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EngineState {
    /// `d` \[N\].
    pub deviation: f64,
    /// Thrust rate of an engine that follows the commands at the limits of its throttle, `Ṫ_e` \[N/s\].
    rate: f64,
    /// `l` \[N\].
    pub lag: f64,
    /// Thrust rates of engines of the shaft's speed with the ramps that are known, slower and faster ones \[N/s\], and what
    /// the last two deviate from the first \[N\].
    ramping: ([f64; 3], [f64; 2]),
    /// `Σ d l` and `Σ l²`, which give `λ` \[N²\].
    fit: [f64; 2],
    /// The part of `d` outside `[0, λ l]` after the first lag and after both, `d̄`, as late as the momentum's force
    /// and as its moment \[N\].
    late: [[f64; 2]; 2],
    /// Whether the speed of its shaft is measured, which judges it.
    is_of_speed: bool,
    /// Whether the part of `d` outside exceeds half of its limit: the thrust may not be the one that is used.
    pub is_doubted: bool,
    /// For how long `|d̄|` has exceeded its limit.
    suspected: Exceeded,
    /// Least and greatest thrust that the engine has been found to reach \[N\].
    pub range: (f64, f64),
}

/// What the monitor of an engine is given in a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EngineSample {
    /// Thrust \[N\].
    pub thrust: f64,
    /// Its difference from the prediction \[N\].
    pub innovation: f64,
    /// Whether all thrusts are measured: otherwise how engines follow their commands is not learnt.
    pub is_measured: bool,
    /// Whether the thrust is that of a measured speed: then the momentum is not used.
    pub is_of_speed: bool,
    /// The thrust rate that was commanded since the last tick \[N/s\].
    pub command: f64,
}

impl Default for EngineState {
    fn default() -> Self {
        Self {
            deviation: 0.0,
            rate: 0.0,
            lag: 0.0,
            ramping: Default::default(),
            fit: [0.0; 2],
            late: [[0.0; 2]; 2],
            is_of_speed: false,
            is_doubted: false,
            suspected: Exceeded::default(),
            range: (0.0, f64::INFINITY),
        }
    }
}

impl EngineState {
    /// Whether a limit of the engine's thrust has been found.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.range != Self::default().range
    }

    /// Whether the thrust range is too small for flight; `thrust_max` is the greatest thrust of the jet \[N\].
    #[must_use]
    pub fn is_lost(&self, descent: &DescentConfig, thrust_max: f64) -> bool {
        self.range.1 - self.range.0 < descent.range_fraction_min * thrust_max
    }

    /// Updates the monitor `dt` \[s\] after the last tick.
    ///
    /// `momentum_fractions` are the fractions of a change of force and moment that appear in the estimated momentum per
    /// tick, 1 where it is measured. Without a measured momentum lags and confirmation time restart.
    pub fn update(
        &mut self,
        config: &EnginesConfig,
        models: &Models,
        dt: f64,
        sample: EngineSample,
        momentum_fractions: Option<[f64; 2]>,
    ) {
        let EngineSample { thrust, innovation, is_measured, is_of_speed, command } = sample;
        let kept = libm::exp(-dt / MEMORY);
        self.deviation = kept * self.deviation + innovation;
        self.is_of_speed = is_of_speed;
        if let Some(shafts) = &models.ramping {
            let (rates, band) = &mut self.ramping;
            let before = *rates;
            for (rate, shaft) in rates.iter_mut().zip(shafts) {
                *rate = shaft.nearest_rate(thrust, *rate, command, dt);
            }
            let mean: [f64; 3] = std::array::from_fn(|of| 0.5 * (before[of] + rates[of]));
            *band = std::array::from_fn(|of| kept * band[of] + dt * (mean[1 + of] - mean[0]));
        }
        if let Some(model) = &models.lagging {
            let rate = model.nearest_rate(thrust, self.rate, command, dt);
            self.lag = kept * self.lag + dt * (0.5 * (self.rate + rate) - command);
            self.rate = rate;
        }
        let half = 0.5 * config.deviation_max;
        // A deviation that may be a fault teaches nothing.
        if is_measured && self.deviation.abs() <= half {
            self.fit[0] += self.deviation * self.lag;
            self.fit[1] += self.lag * self.lag;
        }
        let [d_l, l_l] = self.fit.map(|sum| half * half + sum);
        let lag = self.lag * (d_l / l_l).clamp(0.0, 1.0);
        let (_, [slower, faster]) = self.ramping;
        let (least, greatest) = (lag.min(slower).min(faster).min(0.0), lag.max(slower).max(faster).max(0.0));
        let outside = self.deviation - self.deviation.max(least).min(greatest);
        self.is_doubted = outside.abs() > half;
        match momentum_fractions {
            _ if is_of_speed => self.late = [[outside; 2]; 2],
            None => {
                (self.late, self.suspected) = ([[0.0; 2]; 2], Exceeded::default());
                return;
            }
            Some(shares) => {
                for ([estimated, late], share) in self.late.iter_mut().zip(shares) {
                    *estimated += share * (outside - *estimated);
                    *late += residual_share(dt) * (*estimated - *late);
                }
            }
        }
        // Nothing else can have moved a measured speed.
        let greatest = if is_of_speed { half } else { config.deviation_max };
        self.suspected.update(self.late()[1].abs() > greatest, dt);
    }

    /// `d̄` \[N\], as late as the momentum's force and as its moment.
    fn late(&self) -> [f64; 2] {
        self.late.map(|[_, late]| late)
    }

    /// Whether the sensor may be wrong: half of the limit is enough beside another one.
    fn is_suspect(&self, config: &EnginesConfig) -> bool {
        !self.is_limited() && !self.is_of_speed && 2.0 * self.late()[1].abs() > config.deviation_max
    }

    /// Narrows the range by the thrust \[N\] at which the engine stopped.
    fn narrow(&mut self, thrust: f64) {
        let (least, greatest) = self.range;
        let is_short = self.late()[1] < 0.0;
        self.range = if is_short { (least.min(thrust), thrust) } else { (thrust, greatest.max(thrust)) };
    }
}

/// What a healthy engine may do beside the prediction.
#[derive(Debug, Clone)]
pub struct Models {
    /// An engine that the predictions do not contain.
    lagging: Option<EngineModel>,
    /// An engine of the shaft's speed: as known, and with slower and faster ramps.
    ramping: Option<[EngineModel; 3]>,
}

impl Models {
    fn new(engine: EngineModel, dynamics: JetDynamics) -> Self {
        let ramping = match engine {
            EngineModel::Shaft(shaft) => {
                let [slower, faster] = RAMPS.map(|scale| EngineModel::Shaft(shaft.with_ramps(scale)));
                Some([engine, slower, faster])
            }
            EngineModel::SecondOrder(_) => None,
        };
        Self { lagging: (dynamics == JetDynamics::Ideal).then_some(engine), ramping }
    }
}

/// Monitors of all engines of a robot, and the limits of the law that follow from them.
#[derive(Debug, Clone)]
pub struct Engines {
    config: EnginesConfig,
    /// Fractions of a change of force and moment that appear in the estimated momentum per tick, 1 where measured.
    momentum_fractions: [f64; 2],
    models: Vec<Models>,
    usual: Limits,
    /// Limits after the loss of an engine.
    descending: Option<(DescentConfig, Limits)>,
}

impl Detector for Engines {
    type Config = EnginesConfig;
    type State = Vec<EngineState>;
    const MODES: &'static [Mode] = &MODES;

    fn build(config: &EnginesConfig, of: &Setup) -> Self {
        Self::new(config, of.usual, of.robot, of.momentum_fractions, of.jet_dynamics)
    }

    fn start(&self, _: &Estimate) -> Self::State {
        vec![EngineState::default(); self.usual.thrust.len()]
    }

    fn detect(
        &mut self,
        engines: &mut Self::State,
        tick: &Evidence,
        limits: &mut Limits,
        findings: &mut Findings,
    ) {
        let Evidence { estimate, acting, momentum, disturbance, is_standing, .. } = *tick;
        let is_measured = !estimate.modes.contains(Modes::THRUST_MODELLED);
        let samples = |jet: usize| EngineSample {
            thrust: estimate.robot.thrust[jet],
            innovation: estimate.thrust_innovation[jet],
            is_measured,
            is_of_speed: estimate.is_of_speed[jet],
            command: acting.thrust_rate[jet],
        };
        let residual =
            disturbance.filter(|_| estimate.has_momentum()).map(|of| (&momentum.a_t, &of.residual));
        let is_between = estimate.momentum == Sampling::Between && disturbance.is_some();
        self.update(engines, estimate.elapsed, samples, residual, is_between, &mut findings.sensor_error);
        if engines.iter().any(EngineState::is_limited) {
            findings.modes.insert(Modes::ENGINE_LIMITED);
        }
        findings.descends |= self.limit(engines, is_standing, limits);
    }
}

impl Engines {
    /// Monitors of the engines of `robot`, for a law with these limits while all engines work.
    #[must_use]
    pub fn new(
        config: &EnginesConfig,
        usual: &Limits,
        robot: &RobotModel,
        momentum_fractions: [f64; 2],
        dynamics: JetDynamics,
    ) -> Self {
        let models = robot.jets.iter().map(|jet| Models::new(jet.engine, dynamics)).collect();
        let joints = robot.joints.iter();
        let descending = |descent: DescentConfig| Limits {
            gains: descent.momentum,
            holds_position: false,
            joint_velocity: joints.clone().map(|joint| descent.velocity_max(joint)).collect(),
            torque_rate: joints.map(|joint| descent.torque_rate_max(joint)).collect(),
            ..usual.clone()
        };
        let descending = config.descent.map(|descent| (descent, descending(descent)));
        Self { config: *config, momentum_fractions, models, usual: usual.clone(), descending }
    }

    /// Processes a sample of each engine, `dt` \[s\] after the last; `sensor_error` \[N\] is written for the sensors that
    /// are found to be wrong, whose engines are as at the start, and the range of engines that do not reach their
    /// thrust is narrowed.
    ///
    /// `momentum` is `A_T` and the residual of the momentum \[N, N m\], where it is measured; otherwise nothing is judged,
    /// and the monitors start anew unless the tick `is_between` two measurements.
    pub fn update(
        &self,
        engines: &mut [EngineState],
        dt: f64,
        samples: impl Fn(usize) -> EngineSample,
        momentum: Option<(&Matrix6xX<f64>, &Vector6<f64>)>,
        is_between: bool,
        sensor_error: &mut [Option<f64>],
    ) {
        let Self { config, models, .. } = self;
        let shares = (momentum.is_some() || is_between).then_some(self.momentum_fractions);
        let is_confirmed = |engine: &EngineState| engine.suspected.has_lasted(CONFIRMATION, dt);
        for (jet, (engine, models)) in engines.iter_mut().zip(models).enumerate() {
            engine.update(config, models, dt, samples(jet), shares);
            if engine.is_of_speed && is_confirmed(engine) {
                engine.narrow(samples(jet).thrust);
            }
        }
        let Some((a_t, residual)) = momentum else { return };
        if !engines.iter().any(is_confirmed) {
            return;
        }
        let mut wrench = Vector6::zeros();
        for (column, engine) in
            a_t.column_iter().zip(&*engines).filter(|(_, engine)| engine.is_suspect(config))
        {
            wrench += Vector6::from_fn(|row, _| column[row] * engine.late()[row / 3]);
        }
        let are_sensors = explains(&wrench, residual);
        for (jet, engine) in engines.iter_mut().enumerate() {
            if are_sensors && engine.is_suspect(config) {
                sensor_error[jet] = Some(engine.deviation);
                *engine = EngineState::default();
            } else if is_confirmed(engine) {
                engine.narrow(samples(jet).thrust);
            }
        }
    }

    /// Writes the limits of the law: of a limited engine the thrusts it reaches, so that the others take over its share;
    /// after the loss of an engine those of the descent, unless the robot is standing. An engine may be lost by the thrusts
    /// that the limits have before. Returns whether one is lost.
    pub fn limit(&self, engines: &[EngineState], is_standing: bool, limits: &mut Limits) -> bool {
        let thrusts = engines.iter().zip(&self.usual.thrust).zip(&limits.thrust);
        let descending = self.descending.as_ref().filter(|(descent, _)| {
            thrusts.clone().any(|((engine, (_, thrust_max)), (_, greatest))| {
                engine.is_lost(descent, *thrust_max) || *greatest < descent.range_fraction_min * thrust_max
            })
        });
        if let Some((_, of_descent)) = descending.filter(|_| !is_standing) {
            limits.descend(of_descent);
        }
        let of_law = limits.thrust.iter_mut().zip(&mut limits.works);
        for (engine, (range, works)) in engines.iter().zip(of_law) {
            *works &= !engine.is_limited();
            let greatest = engine.range.1.min(range.1);
            *range = (engine.range.0.max(range.0).min(greatest), greatest);
        }
        descending.is_some()
    }
}

/// Whether sensors that are wrong explain the residual `n` of the momentum: `|n + Σ a_i d̄_i| < |n|`, forces at
/// `FORCE_ARM`. `wrench` is `Σ a_i d̄_i` \[N, N m\]. Where it says as little, engines fail, the worse of the two cases.
#[must_use]
pub fn explains(wrench: &Vector6<f64>, residual: &Vector6<f64>) -> bool {
    let square = |wrench: Vector6<f64>| product(&wrench, &wrench);
    square(residual + wrench) < square(*residual)
}

/// Product of two wrenches, with forces at `FORCE_ARM` \[N² m²\].
pub(super) fn product(one: &Vector6<f64>, other: &Vector6<f64>) -> f64 {
    let ((force, moment), (other_force, other_moment)) = (parts(one), parts(other));
    FORCE_ARM * FORCE_ARM * force.dot(&other_force) + moment.dot(&other_moment)
}
