//! Ticks of recorded flights as input of the benchmarks.
#![allow(dead_code)] // each benchmark uses a part of it

use flight_core::control::Present;
use flight_core::control::mpc::PredictiveLaw;
use flight_core::control::mpc::horizon::Horizon;
use flight_core::control::mpc::model::Linearised;
use flight_core::control::mpc::plan::Plan;
use flight_core::control::{ControllerState, Estimate, Terms};
use flight_core::qp::{PrimalActiveSet, QpProblem, QpSolver};
use flight_core::{BuildError, Controller, Measurement};
use flight_io::load_robot;
use flight_sim::disturbances::{FailureKind, JetFailure};
use flight_sim::{Plant, ScenarioConfig, Wind, WindConfig, load_scenario};
use nalgebra::{DVector, Vector3};
use std::hint::black_box;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Measurement of a tick, and the QPs that the controller built from it.
pub struct Tick {
    pub measurement: Measurement,
    pub momentum_qp: QpProblem,
    pub torque_qp: QpProblem,
}

pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Loads a flight of `configs/experiments/`.
pub fn configuration(name: &str) -> Result<ScenarioConfig, BuildError> {
    load_scenario(&repository().join(format!("configs/experiments/{name}.toml")))
}

pub fn controller(config: &ScenarioConfig) -> Result<Controller, BuildError> {
    let robot = load_robot(&config.robot)?;
    config.controller(robot)
}

/// Flies a configuration to a time \[s\], with `visit` after every tick of the controller.
fn fly(
    config: &ScenarioConfig,
    end: f64,
    mut visit: impl FnMut(&Controller, &ControllerState, &Measurement),
) -> Result<(), BuildError> {
    let mut controller = controller(config)?;
    let mut plant = Plant::new(
        load_robot(&config.robot)?,
        &config.simulator,
        &config.disturbances,
        &config.controller.law,
    )?;
    let mut state = None;
    let wind_profile = Wind::new(&config.wind)?;
    let time_step = config.controller.law.time_step;
    let feet = controller.model().feet.len();
    let mut measurement = Measurement::zero(controller.model().joints.len(), controller.n_jets(), feet);
    for tick in 0..=config.n_ticks() {
        let time = tick as f64 * time_step;
        if time > end {
            break;
        }
        let wind = wind_profile.velocity(time);
        plant.observe(&wind);
        (measurement.time, measurement.wind) = (time, wind);
        measurement.state.copy_from(plant.state());
        measurement.thrust.copy_from_slice(plant.jets().thrust_feedback());
        let Some(state) = begin_flight(&mut controller, &mut state, &measurement) else { break };
        controller.tick(state, &measurement);
        visit(&controller, state, &measurement);
        let command = controller.command();
        let (torque, thrust_rate) = (command.joint_torque.as_slice(), command.thrust_rate.as_slice());
        plant.advance(torque, thrust_rate, &wind, time_step);
    }
    Ok(())
}

/// Flies a configuration and records the ticks in a span of time \[s\].
pub fn record(config: &ScenarioConfig, span: &RangeInclusive<f64>) -> Result<Vec<Tick>, BuildError> {
    let mut ticks = Vec::new();
    fly(config, *span.end(), |controller, _, measurement| {
        if span.contains(&measurement.time) {
            ticks.push(Tick {
                measurement: measurement.clone(),
                momentum_qp: controller.terms().momentum_qp.problem.clone(),
                torque_qp: controller.terms().torque_qp.problem.clone(),
            });
        }
    })?;
    Ok(ticks)
}

/// Flights of the predictive law, with the time \[s\] from which their plans count: hovering in the full wind, in
/// turbulence of 18 m/s, and after an arm engine has stopped at once.
pub fn planned_flights() -> Result<[(&'static str, ScenarioConfig, f64); 3], BuildError> {
    let calm = configuration("test2_mpc")?;
    let (mut turbulence, loss) = (calm.clone(), without_engine(calm.clone()));
    turbulence.wind = WindConfig::Turbulent {
        velocity: [0.0, -18.0, 0.0],
        ramp_start: 5.0,
        ramp_end: 10.0,
        std: [3.6, 3.6, 1.8],
        time_scale: 2.0,
        seed: 0,
    };
    Ok([("calm", calm, 10.0), ("turbulence", turbulence, 10.0), ("engine lost", loss, 18.0)])
}

/// A flight in which an arm engine stops at 18 s.
pub fn without_engine(mut config: ScenarioConfig) -> ScenarioConfig {
    config.disturbances.jets.failure =
        Some(JetFailure { jet: "l_arm_jet".into(), time: 18.0, kind: FailureKind::Off, decay: 0.0 });
    config
}

/// Whether the tick at `time` makes a plan.
pub fn makes_plan(config: &ScenarioConfig, time: f64) -> bool {
    let every = config.controller.law.mpc.as_ref().map_or(f64::INFINITY, |mpc| mpc.period);
    (time / every - (time / every).round()).abs() < 1e-6
}

/// What a plan is made from.
pub struct PlannedTick {
    pub model: Linearised,
    pub horizon: Horizon,
    pub terms: Terms,
    pub estimate: Estimate,
    pub joint_limits: Vec<(f64, f64)>,
}

/// Flies a configuration and records the plans in a span of time \[s\].
pub fn record_plans(
    config: &ScenarioConfig,
    span: &RangeInclusive<f64>,
) -> Result<Vec<PlannedTick>, BuildError> {
    let mut plans = Vec::new();
    fly(config, *span.end(), |controller, state, measurement| {
        if !span.contains(&measurement.time) || !makes_plan(config, measurement.time) {
            return;
        }
        let Some((model, horizon)) = controller.prediction() else { return };
        plans.push(PlannedTick {
            model: model.clone(),
            horizon: horizon.clone(),
            terms: controller.terms().clone(),
            estimate: state.estimate().clone(),
            joint_limits: controller.model().joints.iter().map(|joint| joint.limits).collect(),
        });
    })?;
    Ok(plans)
}

/// The law's search for the plan of recorded ticks, each from the plan before.
pub struct Search {
    solver: PrimalActiveSet,
    inputs: Vec<f64>,
    plan: Plan,
}

impl Search {
    pub fn new(unknowns: usize) -> Self {
        Self {
            solver: PrimalActiveSet::new(unknowns),
            inputs: vec![0.0; unknowns],
            plan: Plan::none(unknowns, 0),
        }
    }

    /// The inputs of the plan; `None` if they are not certified.
    pub fn solve(&mut self, tick: &mut PlannedTick) -> Option<&[f64]> {
        let Self { solver, inputs, plan } = self;
        let PlannedTick { model, horizon, terms, estimate, joint_limits } = tick;
        let now = Present { terms, estimate };
        PredictiveLaw::search(horizon, solver, model, now, joint_limits, inputs, plan).then(|| solver.x())
    }
}

/// State of a flight that starts with its first measurement; `None` if it cannot start.
pub fn begin_flight<'a>(
    controller: &mut Controller,
    state: &'a mut Option<ControllerState>,
    measurement: &Measurement,
) -> Option<&'a mut ControllerState> {
    if state.is_none() {
        *state = controller.start(measurement).ok();
    }
    state.as_mut()
}

/// Two seconds of hovering in the full wind: TEST2, few bounds active.
pub fn calm_ticks() -> Result<Vec<Tick>, BuildError> {
    record(&configuration("test2")?, &(10.0..=12.0))
}

/// The last two seconds of TEST1 with the published lever arms: shortly before the fall, many bounds
/// active.
pub fn saturated_ticks() -> Result<Vec<Tick>, BuildError> {
    record(&configuration("test1_published")?, &(19.0..=21.0))
}

/// A tick of a standing robot, with its torque QP.
pub struct StandingTick {
    pub measurement: Measurement,
    pub torque_qp: QpProblem,
}

/// Ten seconds of standing in a side wind that rises to 15 m/s and that only the controller receives. There
/// is no ground: the joints sway by a degree, and the measured weight shifts from one foot to the other.
pub fn standing_ticks() -> Result<Vec<StandingTick>, BuildError> {
    let config = configuration("balancing_lateral")?;
    let mut controller = controller(&config)?;
    let start = config.simulator.initial.state();
    let mut memory = None;
    let mut ticks = Vec::new();
    for tick in 0..1000 {
        let time = f64::from(tick) * config.controller.law.time_step;
        let mut state = start.clone();
        for (joint, s) in state.joint_position.iter_mut().enumerate() {
            *s += 0.02 * (time + joint as f64).sin();
            state.velocity[6 + joint] = 0.02 * (time + joint as f64).cos();
        }
        let shift = 60.0 * time.sin();
        let feet = [shift, -shift].map(|shift| [0.0, 0.0, 212.5 + shift, 0.5, -1.2, 0.0]);
        let measurement = Measurement {
            time,
            state,
            thrust: vec![0.0; controller.n_jets()],
            wind: Vector3::new(0.0, -1.5 * time, 0.0),
            foot_wrenches: DVector::from_vec(feet.concat()),
            ..Measurement::zero(0, 0, 0)
        };
        let Some(memory) = begin_flight(&mut controller, &mut memory, &measurement) else { break };
        controller.tick(memory, &measurement);
        let torque_qp = controller.terms().torque_qp.problem.clone();
        ticks.push(StandingTick { measurement, torque_qp });
    }
    Ok(ticks)
}

/// The p-quantile of sorted times.
pub fn quantile(sorted: &[f64], p: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    // The nearest rank is at most `last`, so the conversion to an index is exact.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let rank = (p * last as f64).round() as usize;
    sorted.get(rank).copied().unwrap_or(f64::NAN)
}

/// Processor time of this thread \[s\]: other programs and threads do not count.
pub fn processor_time() -> f64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `now` is a valid place for the answer; the clock exists on every Unix.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut now) };
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// Times `rounds` rounds of `work` on all `items`, after one that warms up, and prints a line `what <tab> median <tab>
/// minimum` in nanoseconds of processor time per item.
pub fn report<T, R>(what: &str, rounds: usize, items: &[T], mut work: impl FnMut(&T) -> R) {
    let mut round = || {
        let begin = processor_time();
        for item in items {
            black_box(work(black_box(item)));
        }
        1e9 * (processor_time() - begin) / items.len() as f64
    };
    round();
    let mut times: Vec<f64> = (0..rounds).map(|_| round()).collect();
    times.sort_unstable_by(f64::total_cmp);
    println!("{what}\t{:.1}\t{:.1}", quantile(&times, 0.5), quantile(&times, 0.0));
}
