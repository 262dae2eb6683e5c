//! Random flights: robots, configurations, states, winds and faults drawn from a seed, and what must hold in each tick.

#![allow(dead_code, reason = "no binary needs everything")]
#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::counting::allocations;
use crate::common::{at, configs, every_controller, hover_of, loaded, random_state, random_vector, robot};
use flight_core::control::config::Solver;
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::{ControllerState, Given, Measurement, Modes, Preview};
use flight_core::qp::{KKT_TOLERANCE, QpProblem, QpStatus, kkt_residual};
use flight_core::robot::RobotModel;
use flight_core::{BuildError, Controller};
use flight_io::{from_value, load_robot};
use flight_sim::disturbances::{FailureKind, JetFailure, Outage, OutageChannel, OutageKind, Outages};
use flight_sim::{Plant, ScenarioConfig};
use nalgebra::{DVector, Unit, Vector3};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde_json::Value;
use std::time::{Duration, Instant};

/// Numbers that no measurement and no set-point has.
const ABSURD: [f64; 9] =
    [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e300, 1e-320, 1e12, -1e6, f64::MIN_POSITIVE];

/// What must not happen in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Finding {
    /// It allocated.
    Allocation,
    /// A command is neither certified nor the one of a tick without an answer.
    Uncertified,
    /// A command is not finite.
    NonFinite,
}

/// What a tick did.
#[derive(Debug, Clone, Copy)]
pub struct Ticked {
    /// How long `Controller::tick` took.
    pub duration: Duration,
    pub modes: Modes,
    pub finding: Option<Finding>,
}

/// Where random flights are drawn from.
pub struct Episodes {
    seed: u64,
    flights: Vec<(ScenarioConfig, RobotModel)>,
}

impl Episodes {
    /// A flight of every controller, and small robots.
    pub fn new(seed: u64) -> Self {
        let mut scenarios: Vec<_> = every_controller().into_iter().map(|(_, scenario)| scenario).collect();
        scenarios.extend(["sparrow", "slider"].map(hover));
        let flights = scenarios.into_iter().map(|mut scenario| {
            scenario.simulator.ground = None; // the wrenches of the feet are made up
            let robot = load_robot(&scenario.robot).unwrap();
            (scenario, robot)
        });
        Self { seed, flights: flights.collect() }
    }

    /// Flight `number` before its first tick; an error if its configuration or its first measurement is refused.
    pub fn draw(&self, number: u64) -> Result<Episode, BuildError> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(number);
        let (scenario, robot) = &self.flights[rng.random_range(0..self.flights.len())];
        let mut robot = robot.clone();
        if rng.random_bool(0.5) {
            change_robot(&mut rng, &mut robot);
        }
        let mut scenario = scenario.clone();
        if rng.random_bool(0.5) {
            let share = [0.02, 0.2][rng.random_range(0..2)];
            scenario = change_controller(&mut rng, scenario, share)?;
        }
        disturb(&mut rng, &mut scenario, &robot);
        Episode::new(rng, &scenario, robot)
    }
}

/// The platform's flight with another robot.
fn hover(name: &str) -> ScenarioConfig {
    let robot = robot(name);
    let mut scenario = hover_of(&robot);
    scenario.robot = configs("robot").join(name).with_extension("toml");
    scenario.simulator.initial.joint_position = vec![0.0; robot.joints.len()];
    scenario.simulator.initial.thrust = robot.jets.iter().map(|jet| 0.4 * jet.thrust_max).collect();
    scenario
}

/// A factor within `10^±decades`.
fn factor(rng: &mut ChaCha8Rng, decades: f64) -> f64 {
    10_f64.powf(rng.random_range(-decades..decades))
}

/// Other masses, inertias, limits, jets.
fn change_robot(rng: &mut ChaCha8Rng, robot: &mut RobotModel) {
    for body in &mut robot.bodies {
        let scale = factor(rng, 0.5);
        body.mass *= scale;
        body.inertia_b *= scale * factor(rng, 0.3);
        body.com_b += random_vector(rng, 0.02);
    }
    for joint in &mut robot.joints {
        joint.torque_max *= factor(rng, 1.0);
        joint.velocity_max *= factor(rng, 0.5).min(1.0);
        joint.limits.0 *= factor(rng, 0.3);
        joint.limits.1 *= factor(rng, 0.3);
    }
    for jet in &mut robot.jets {
        jet.thrust_max *= factor(rng, 0.5);
        jet.axis_f = Unit::new_normalize(jet.axis_f.into_inner() + random_vector(rng, 0.2));
    }
}

/// Changes this share of a configuration's numbers and switches.
pub fn change_values(rng: &mut ChaCha8Rng, value: &mut Value, share: f64) {
    match value {
        Value::Object(table) => table.values_mut().for_each(|value| change_values(rng, value, share)),
        Value::Array(items) => items.iter_mut().for_each(|value| change_values(rng, value, share)),
        Value::Bool(switch) if rng.random_bool(share) => *switch = !*switch,
        Value::Number(number) if rng.random_bool(share) => {
            if let Some(count) = number.as_u64() {
                *value = Value::from(count.saturating_mul(rng.random_range(0..3)));
            } else {
                let decades = [0.3, 2.0, 8.0][rng.random_range(0..3)];
                *value = Value::from(number.as_f64().unwrap() * factor(rng, decades));
            }
        }
        _ => {}
    }
}

/// The controller with some of its numbers changed, and a time step of its own.
fn change_controller(
    rng: &mut ChaCha8Rng,
    mut scenario: ScenarioConfig,
    share: f64,
) -> Result<ScenarioConfig, BuildError> {
    scenario.controller.law.time_step = [0.001, 0.002, 0.005, 0.01][rng.random_range(0..4)];
    let mut value = serde_json::to_value(&scenario).unwrap();
    change_values(rng, &mut value["controller"], share);
    from_value(value, "random configuration")
}

/// An initial state, faults of jets and errors of the controller's model.
fn disturb(rng: &mut ChaCha8Rng, scenario: &mut ScenarioConfig, robot: &RobotModel) {
    let initial = &mut scenario.simulator.initial;
    if rng.random_bool(0.5) {
        for (position, joint) in initial.joint_position.iter_mut().zip(&robot.joints) {
            let (lower, upper) = joint.limits;
            *position = lower + (upper - lower) * rng.random_range(-0.1..1.1);
        }
        initial.base_rpy_deg = [30.0, 30.0, 180.0].map(|range| rng.random_range(-range..range));
        initial.base_velocity = [(); 6].map(|()| rng.random_range(-2.0..2.0));
        for (thrust, jet) in initial.thrust.iter_mut().zip(&robot.jets) {
            *thrust = rng.random_range(0.0..1.0) * jet.thrust_max;
        }
    }
    if rng.random_bool(0.3) && !robot.jets.is_empty() {
        let kind = if rng.random_bool(0.5) { FailureKind::Off } else { FailureKind::Stuck };
        scenario.disturbances.jets.failure = Some(JetFailure {
            jet: robot.jets[rng.random_range(0..robot.jets.len())].name.clone(),
            time: rng.random_range(0.0..5.0),
            kind,
            decay: if kind == FailureKind::Off { rng.random_range(0.0..1.0) } else { 0.0 },
        });
    }
    if rng.random_bool(0.3) {
        scenario.disturbances.model_error.mass_scale = factor(rng, 1.0);
        scenario.disturbances.model_error.com_offset = [(); 3].map(|()| rng.random_range(-0.1..0.1));
    }
}

/// Spells in which a channel fails.
fn random_outages(rng: &mut ChaCha8Rng) -> Vec<Outage> {
    use OutageChannel::{BasePosition, BaseRotation, BaseVelocity, Joints, Thrust, Wind};
    use OutageKind::{Frozen, Missing, Nan, Wrong};
    let count = [0, 0, 1, 4][rng.random_range(0..4)];
    let outage = |_| {
        let kind = [Missing, Nan, Frozen, Wrong][rng.random_range(0..4)];
        Outage {
            channel: [Wind, Thrust, Joints, BasePosition, BaseRotation, BaseVelocity][rng.random_range(0..6)],
            jet: None,
            start: rng.random_range(0.01..8.0),
            duration: rng.random_bool(0.8).then(|| factor(rng, 1.0)),
            kind,
            error: if kind == Wrong { rng.random_range(-3.0..3.0) } else { 1.0 },
        }
    };
    (0..count).map(outage).collect()
}

/// A flight under way.
pub struct Episode {
    rng: ChaCha8Rng,
    /// Its plant, and the same before the first tick; without them each tick measures another state.
    plant: Option<(Plant, Plant)>,
    robot: RobotModel,
    controller: Controller,
    state: ControllerState,
    outages: Outages,
    sample: Measurement,
    mean_wind: Vector3<f64>,
    begin: f64,
    time_step: f64,
    tick: u64,
    /// Probabilities of an absurd number, and of a set-point of one's own, in a tick.
    absurd: f64,
    towards: f64,
    may_allocate: bool,
    /// Whether its rates come from a plan instead of the momentum QP, or have a policy's residual.
    has_others: bool,
    /// Answer of the momentum QP, and torques of the tick before.
    answer: Vec<f64>,
    torque: Vec<f64>,
}

impl Episode {
    fn new(mut rng: ChaCha8Rng, scenario: &ScenarioConfig, robot: RobotModel) -> Result<Self, BuildError> {
        let plant =
            Plant::new(robot.clone(), &scenario.simulator, &scenario.disturbances, &scenario.controller.law)?;
        let mut controller = scenario.controller(robot.clone())?;
        let time_step = scenario.controller.law.time_step;
        let speed = [1.0, 12.0, 60.0][rng.random_range(0..3)];
        let sample = Measurement {
            wind: random_vector(&mut rng, speed),
            foot_wrenches: loaded(controller.model().feet.len()),
            ..at(0.0, plant.state(), plant.jets().thrust_feedback())
        };
        let begin = rng.random_range(0.0..40.0);
        let sample = Measurement { time: begin, ..sample };
        let state = controller
            .start(&sample)
            .map_err(|refusal| BuildError::bad_value("first measurement", refusal, "one of a flight"))?;
        let absurd = [0.0, 0.001, 0.1][rng.random_range(0..3)];
        Ok(Self {
            plant: rng.random_bool(0.7).then(|| (plant.clone(), plant)),
            outages: Outages::new(&random_outages(&mut rng), &robot.jets)?,
            mean_wind: sample.wind,
            absurd,
            towards: if rng.random_bool(0.3) { 0.3 } else { 0.0 },
            may_allocate: scenario.controller.law.qp.solver == Solver::Clarabel,
            has_others: scenario.controller.law.mpc.is_some() || scenario.controller.policy.is_some(),
            answer: vec![0.0; controller.terms().momentum_qp.unknowns.len()],
            torque: vec![0.0; robot.joints.len()],
            rng,
            tick: 0,
            robot,
            controller,
            state,
            sample,
            begin,
            time_step,
        })
    }

    /// Measures something and ticks.
    pub fn tick(&mut self) -> Ticked {
        self.sample.time = self.measure();
        let (mut sample, rng) = (self.sample.clone(), &mut self.rng);
        if self.absurd > 0.0 && rng.random_bool(0.1 * self.absurd) {
            match rng.random_range(0..4) {
                0 => sample.time = ABSURD[rng.random_range(0..ABSURD.len())],
                1 => sample.time += rng.random_range(-2.0..2.0),
                2 => sample.foot_wrenches = DVector::zeros(0),
                _ => sample.thrust.truncate(sample.thrust.len().saturating_sub(1)),
            }
        }
        let random_setpoint = |rng: &mut ChaCha8Rng| {
            let absurd = rng.random_bool(self.absurd);
            Setpoint {
                com_velocity: random_vector(rng, 3.0),
                com_jerk: random_vector(rng, if absurd { 1e200 } else { 3.0 }),
                angular_velocity_b: random_vector(rng, 1.0),
                ..Setpoint::at_rest(random_vector(rng, 3.0), random_state(rng, &self.robot).base.rotation)
            }
        };
        let is_given = rng.random_bool(self.towards);
        let given = is_given.then(|| random_setpoint(rng));
        let count = if is_given { rng.random_range(0..4) } else { 0 };
        let mut setpoints: Vec<_> =
            (0..count).map(|next| (0.2 * f64::from(next + 1), random_setpoint(rng))).collect();
        let mut winds: Vec<_> =
            (0..count).map(|next| (0.3 * f64::from(next), random_vector(rng, 30.0))).collect();
        if count > 0 && rng.random_bool(self.absurd) {
            let absurd = ABSURD[rng.random_range(0..ABSURD.len())];
            match rng.random_range(0..3) {
                0 => setpoints[0].0 = absurd,
                1 => winds[0].0 = absurd,
                _ => winds[0].1.x = absurd,
            }
        }
        let preview = Preview { setpoints: &setpoints, wind: &winds };
        self.torque.copy_from_slice(self.controller.command().joint_torque.as_slice());

        let (controller, state) = (&mut self.controller, &mut self.state);
        let mut duration = Duration::ZERO;
        let allocated = allocations(|| {
            let begin = Instant::now();
            let setpoint = given.as_ref();
            controller.tick_with(state, &sample, &Given { setpoint, preview, ..Given::default() });
            duration = begin.elapsed();
        });
        let command = self.controller.command();
        let (rate, velocity, torque) = (&command.thrust_rate, &command.joint_velocity, &command.joint_torque);
        let finding = if !rate.iter().chain(velocity).chain(torque).all(|number| number.is_finite()) {
            Some(Finding::NonFinite)
        } else if allocated > 0 && !self.may_allocate {
            Some(Finding::Allocation)
        } else {
            None
        };
        let modes = command.modes;
        let finding = finding.or((!self.is_accounted_for()).then_some(Finding::Uncertified));
        self.advance();
        self.tick += 1;
        Ticked { duration, modes, finding }
    }

    /// What the sensors say, faults included; returns the time \[s\].
    fn measure(&mut self) -> f64 {
        let (rng, sample) = (&mut self.rng, &mut self.sample);
        let elapsed = self.tick as f64 * self.time_step;
        sample.wind = self.mean_wind * (1.0 + 0.5 * (3.0 * elapsed).sin()) + random_vector(rng, 0.3);
        if let Some((plant, _)) = &mut self.plant {
            plant.observe(&sample.wind);
            sample.state.copy_from(plant.state());
            sample.thrust.copy_from_slice(plant.jets().thrust_feedback());
        } else {
            let size = factor(rng, 1.5);
            sample.state.copy_from(&random_state(rng, &self.robot));
            sample.state.velocity *= size;
            for (thrust, jet) in sample.thrust.iter_mut().zip(&self.robot.jets) {
                *thrust = rng.random_range(-0.2..1.5) * jet.thrust_max;
            }
        }
        for foot in sample.foot_wrenches.as_mut_slice().chunks_exact_mut(6) {
            foot.fill_with(|| rng.random_range(-20.0..20.0));
            foot[2] = if rng.random_bool(0.1) { 0.0 } else { rng.random_range(0.0..400.0) };
        }
        self.outages.spoil(elapsed, sample);
        if rng.random_bool(self.absurd) {
            let absurd = ABSURD[rng.random_range(0..ABSURD.len())];
            let one = |rng: &mut ChaCha8Rng, numbers: &mut [f64]| {
                if !numbers.is_empty() {
                    numbers[rng.random_range(0..numbers.len())] = absurd;
                }
            };
            match rng.random_range(0..7) {
                0 => one(rng, sample.wind.as_mut_slice()),
                1 => one(rng, &mut sample.thrust),
                2 => one(rng, sample.state.joint_position.as_mut_slice()),
                3 => one(rng, sample.state.velocity.as_mut_slice()),
                4 => one(rng, sample.state.base.position.as_mut_slice()),
                5 => one(rng, sample.state.base.rotation.as_mut_slice()),
                _ => sample.foot_wrenches.as_mut_slice().chunks_exact_mut(6).for_each(|foot| one(rng, foot)),
            }
        }
        self.begin + elapsed
    }

    /// Whether the command follows from certified answers, or is the one of a tick without them.
    fn is_accounted_for(&mut self) -> bool {
        let (command, terms) = (self.controller.command(), self.controller.terms());
        let qp = &terms.momentum_qp;
        let unknowns = &qp.unknowns;
        self.answer[unknowns.thrust_rate.clone()]
            .copy_from_slice(&command.thrust_rate.as_slice()[..unknowns.thrust_rate.len()]);
        self.answer[unknowns.joint_velocity.clone()].copy_from_slice(command.joint_velocity.as_slice());
        let nearest = |unknown: usize| {
            let (lower, upper) = (qp.problem.lower[unknown], qp.problem.upper[unknown]);
            self.answer[unknown] - 0.0_f64.max(lower).min(upper) == 0.0
        };
        // Rates of foot wrenches and multipliers of rows stay inside the controller: there the reported residual counts.
        let says_so = |answer: &flight_core::qp::QpAnswer| {
            answer.status == QpStatus::Solved && answer.kkt <= KKT_TOLERANCE
        };
        let is_minimiser = |problem: &QpProblem, x: &[f64]| kkt_residual(problem, x, &[]) <= KKT_TOLERANCE;
        let momentum = says_so(&command.rates_qp)
            && (self.has_others
                || !unknowns.force_rate.is_empty()
                || is_minimiser(&qp.problem, &self.answer));
        let torque = says_so(&command.torque_qp)
            && (terms.torque_qp.problem.rows() > 0
                || is_minimiser(&terms.torque_qp.problem, terms.unlimited_torque.as_slice()));
        let held = || command.joint_torque.as_slice() == self.torque;
        let still = || unknowns.thrust_rate.clone().chain(unknowns.joint_velocity.clone()).all(nearest);
        let says = |mode| command.modes.contains(mode);
        if says(Modes::MEASUREMENT_IGNORED) || says(Modes::STATE_IGNORED) {
            return held()
                && command.thrust_rate.iter().chain(&command.joint_velocity).all(|rate| *rate == 0.0);
        }
        let is_old = says(Modes::PLAN_KEPT);
        let rates = if says(Modes::MOMENTUM_HELD) { still() } else { momentum || is_old };
        rates && if says(Modes::TORQUE_HELD) { held() } else { torque }
    }

    /// The plant follows the command; one that physics excludes begins again.
    fn advance(&mut self) {
        let Some((plant, first)) = &mut self.plant else { return };
        let command = self.controller.command();
        let wind = self.mean_wind;
        plant.advance(command.joint_torque.as_slice(), command.thrust_rate.as_slice(), &wind, self.time_step);
        let state = plant.state();
        if !state.is_finite() || state.velocity.amax() > 1e3 || state.base.position.amax() > 1e4 {
            plant.clone_from(first);
        }
    }
}
