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
//! engines add nothing; several that deviate at once are one or the other together. What follows from a finding says the
//! table of [`EngineCondition`]. Equations M105, M106, M144, M176 and M181 of `docs/model`.
//!
//! While no momentum is measured, a sensor that shows that most of the thrust is missing counts, if it is the only one:
//! an engine that stops turns the robot over in less time than a gap may last. The momentum revokes that, or confirms it,
//! when it is measured again.
//!
//! Where the speed of a shaft is measured, it alone judges the engine: a deviation beyond that of engines whose ramps are
//! slower and faster than known is the engine's, whatever the momentum shows.

use super::detector::{Detector, Evidence, Findings, Setup};
use crate::control::engine_condition::{EngineCondition, EngineFinding, EngineState};
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

/// Without momentum: time for which most of the thrust has to be missing \[s\], by how many limits, and which share of the
/// commanded thrust that is.
const UNSEEN_CONFIRMATION: f64 = 0.05;
const UNSEEN_LIMITS: f64 = 2.0;
const UNSEEN_SHARE: f64 = 0.75;

/// Time of measured momentum in which an unseen stop is revoked, and after which it is kept \[s\].
const REVOCATION: f64 = 0.02;

/// Least share of a change of the unmodelled wrench that one engine explains, and of its thrust that one which works gives
/// after it was taken away: pushes and gusts mostly have other directions.
pub(super) const EXPLAINED: f64 = 0.9;
pub(super) const GIVEN: f64 = 0.5;
const KEEPING: f64 = 0.1;

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

/// Monitor of one engine.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EngineMonitor {
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
    /// The part of `d` outside `[0, λ l]` \[N\].
    pub outside: f64,
    /// For how long `|d̄|` has exceeded its limit.
    suspected: Exceeded,
    /// For how long the sensor has said that most of the commanded thrust is missing.
    lacking: Exceeded,
    /// For how long of measured momentum that has shown what an unseen stop took away, and has not.
    given: Exceeded,
    kept: Exceeded,
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

impl EngineMonitor {
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
        // Without momentum nothing is forgotten: an error of the sensor that comes and goes leaves nothing to be judged.
        let kept = momentum_fractions.map_or(1.0, |_| libm::exp(-dt / MEMORY));
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
        self.outside = outside;
        let lacked = (UNSEEN_LIMITS * config.deviation_max).max(UNSEEN_SHARE * (thrust - outside));
        self.lacking.update(-outside > lacked && !is_of_speed, dt);
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

    /// For how long `|d̄|` has exceeded its limit, and the sensor has said that most of the thrust is missing; and for how long
    /// of measured momentum that has shown what an unseen stop took away, and has not \[s\].
    #[must_use]
    pub fn times(&self) -> [f64; 4] {
        [self.suspected, self.lacking, self.given, self.kept].map(|of| of.time())
    }

    /// `d̄` \[N\], as late as the momentum's force and as its moment.
    #[must_use]
    pub fn late(&self) -> [f64; 2] {
        self.late.map(|[_, late]| late)
    }

    /// Whether the sensor of an engine that works may be wrong: half of the limit is enough beside another one.
    fn is_suspect(&self, config: &EnginesConfig, condition: &EngineCondition) -> bool {
        condition.works() && !self.is_of_speed && 2.0 * self.late()[1].abs() > config.deviation_max
    }

    /// The finding of an engine that does not follow its commands.
    fn out_of_reach(&self, thrust: f64) -> EngineFinding {
        EngineFinding::OutOfReach { thrust, is_short: self.late()[1] < 0.0 }
    }
}

/// What a tick shows of the momentum.
#[derive(Debug, Clone, Copy)]
pub enum Shown<'a> {
    /// It is measured.
    Measured {
        /// `A_T`.
        a_t: &'a Matrix6xX<f64>,
        /// Residual of the momentum \[N, N m\].
        residual: &'a Vector6<f64>,
        /// Time that this measurement covers \[s\].
        covered: f64,
    },
    /// The tick is between two measurements.
    Between,
    /// It is not measured.
    Nothing,
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

/// Monitors of all engines of a robot.
#[derive(Debug, Clone)]
pub struct Engines {
    config: EnginesConfig,
    /// Fractions of a change of force and moment that appear in the estimated momentum per tick, 1 where measured.
    momentum_fractions: [f64; 2],
    models: Vec<Models>,
}

impl Detector for Engines {
    type Config = EnginesConfig;
    type State = Vec<EngineMonitor>;
    const MODES: &'static [Mode] = &MODES;

    fn build(config: &EnginesConfig, of: &Setup) -> Self {
        let mut engines = Self::new(config, of.robot, of.momentum_fractions, of.jet_dynamics);
        engines.models.truncate(of.usual.thrust.len()); // none for a controller that does not use them
        engines
    }

    fn start(&self, _: &Estimate) -> Self::State {
        vec![EngineMonitor::default(); self.models.len()]
    }

    fn detect(
        &mut self,
        monitors: &mut Self::State,
        tick: &Evidence,
        _: &mut Limits,
        findings: &mut Findings,
    ) {
        let Evidence { estimate, acting, momentum, disturbance, covered, engines, .. } = *tick;
        let is_measured = !estimate.modes.contains(Modes::THRUST_MODELLED);
        let samples = |jet: usize| EngineSample {
            thrust: estimate.robot.thrust[jet],
            innovation: estimate.thrust_innovation[jet],
            is_measured,
            is_of_speed: estimate.is_of_speed[jet],
            command: acting.thrust_rate[jet],
        };
        let shown = match disturbance.zip(covered) {
            Some((observer, covered)) => {
                Shown::Measured { a_t: &momentum.a_t, residual: &observer.residual, covered }
            }
            None if estimate.momentum == Sampling::Unknown => Shown::Nothing,
            None => Shown::Between,
        };
        self.update(monitors, engines, estimate.elapsed, samples, shown, &mut findings.engines);
    }
}

impl Engines {
    /// Monitors of the engines of `robot`.
    #[must_use]
    pub fn new(
        config: &EnginesConfig,
        robot: &RobotModel,
        momentum_fractions: [f64; 2],
        dynamics: JetDynamics,
    ) -> Self {
        let models = robot.jets.iter().map(|jet| Models::new(jet.engine, dynamics)).collect();
        Self { config: *config, momentum_fractions, models }
    }

    /// Processes a sample of each engine in its condition, `dt` \[s\] after the last, and what is shown of the momentum.
    /// What is found joins `findings`. Between two measurements of the momentum nothing is judged; while it is not
    /// measured the monitors start anew, and only an engine that has stopped is found.
    pub fn update(
        &self,
        monitors: &mut [EngineMonitor],
        engines: &[EngineCondition],
        dt: f64,
        samples: impl Fn(usize) -> EngineSample,
        shown: Shown,
        findings: &mut [EngineFinding],
    ) {
        let shares = (!matches!(shown, Shown::Nothing)).then_some(self.momentum_fractions);
        for (jet, (monitor, models)) in monitors.iter_mut().zip(&self.models).enumerate() {
            monitor.update(&self.config, models, dt, samples(jet), shares);
            if monitor.is_of_speed && monitor.suspected.has_lasted(CONFIRMATION, dt) {
                findings[jet] = findings[jet].or(monitor.out_of_reach(samples(jet).thrust));
            }
        }
        match shown {
            Shown::Measured { a_t, residual, covered } => {
                Self::judge_unconfirmed(monitors, engines, a_t, residual, covered, findings);
                self.judge(monitors, engines, dt, samples, a_t, residual, findings);
            }
            Shown::Between => (),
            Shown::Nothing => Self::judge_unseen(monitors, engines, dt, samples, findings),
        }
    }

    /// Engines or sensors: what has deviated for long enough, by the residual of the momentum.
    #[allow(
        clippy::too_many_arguments,
        reason = "monitors, conditions, samples and the momentum of one tick"
    )]
    fn judge(
        &self,
        monitors: &mut [EngineMonitor],
        engines: &[EngineCondition],
        dt: f64,
        samples: impl Fn(usize) -> EngineSample,
        a_t: &Matrix6xX<f64>,
        residual: &Vector6<f64>,
        findings: &mut [EngineFinding],
    ) {
        let is_confirmed = |monitor: &EngineMonitor, engine: &EngineCondition| {
            engine.state != EngineState::Unconfirmed && monitor.suspected.has_lasted(CONFIRMATION, dt)
        };
        if !monitors.iter().zip(engines).any(|(monitor, engine)| is_confirmed(monitor, engine)) {
            return;
        }
        let mut wrench = Vector6::zeros();
        let all = monitors.iter().zip(engines);
        for (column, (monitor, _)) in a_t
            .column_iter()
            .zip(all)
            .filter(|(_, (monitor, engine))| monitor.is_suspect(&self.config, engine))
        {
            wrench += Vector6::from_fn(|row, _| column[row] * monitor.late()[row / 3]);
        }
        let are_sensors = explains(&wrench, residual);
        for (jet, (monitor, engine)) in monitors.iter_mut().zip(engines).enumerate() {
            if are_sensors && monitor.is_suspect(&self.config, engine) {
                findings[jet] = findings[jet].or(EngineFinding::WrongSensor { error: monitor.deviation });
                *monitor = EngineMonitor::default();
            } else if is_confirmed(monitor, engine) {
                findings[jet] = findings[jet].or(monitor.out_of_reach(samples(jet).thrust));
            }
        }
    }

    /// Without momentum: an engine has stopped if its sensor alone says so. Where several do it is the sensors.
    fn judge_unseen(
        monitors: &mut [EngineMonitor],
        engines: &[EngineCondition],
        dt: f64,
        samples: impl Fn(usize) -> EngineSample,
        findings: &mut [EngineFinding],
    ) {
        let is_lacking = |(monitor, engine): &(&EngineMonitor, &EngineCondition)| {
            monitor.lacking.time() > 0.0 && !engine.has_stopped()
        };
        let is_alone = monitors.iter().zip(engines).filter(is_lacking).count() == 1;
        for (jet, (monitor, engine)) in monitors.iter_mut().zip(engines).enumerate() {
            (monitor.given, monitor.kept) = <_>::default();
            if is_alone && !engine.has_stopped() && monitor.lacking.has_lasted(UNSEEN_CONFIRMATION, dt) {
                let found =
                    EngineFinding::StoppedUnseen { thrust: samples(jet).thrust, lacks: -monitor.outside };
                findings[jet] = findings[jet].or(found);
            }
        }
    }

    /// What the momentum says of a stop that was found without it: the thrust that its sensor lacks is there, or not.
    fn judge_unconfirmed(
        monitors: &mut [EngineMonitor],
        engines: &[EngineCondition],
        a_t: &Matrix6xX<f64>,
        residual: &Vector6<f64>,
        covered: f64,
        findings: &mut [EngineFinding],
    ) {
        for (jet, (monitor, engine)) in monitors.iter_mut().zip(engines).enumerate().take(a_t.ncols()) {
            let is_unconfirmed = engine.state == EngineState::Unconfirmed;
            // By size and direction: where a gap ends the estimated velocity steps, in any direction.
            let column: Vector6<f64> = a_t.column(jet).into();
            let (along, square) = (product(residual, &column), product(&column, &column));
            let is_aligned = along * along > EXPLAINED * square * product(residual, residual);
            let gives = is_aligned && along > GIVEN * engine.taken.thrust * square;
            monitor.given.update(is_unconfirmed && gives, covered);
            monitor.kept.update(is_unconfirmed && !gives, covered);
            if monitor.given.has_lasted(REVOCATION, covered) {
                findings[jet] = findings[jet].or(EngineFinding::Given);
                *monitor = EngineMonitor::default();
            } else if monitor.kept.has_lasted(KEEPING, covered) {
                findings[jet] = findings[jet].or(EngineFinding::Kept);
            }
        }
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
