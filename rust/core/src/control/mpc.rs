//! The predictive law: thrust rates and joint velocities from a plan over the next second, which contains the air.
//!
//! ```text
//! model      dynamics linearised at the present state       [`model`]
//! clearance  distances of exhausts and links                [`clearance`]
//! chain      states that one input drives                  [`chain`]
//! prediction motion over unequal knots                     [`prediction`]
//! horizon    QP in the inputs                              [`horizon`]
//! plan       its answer, followed until the next one       [`plan`]
//! nonlinear  descent without an engine                     [`nonlinear`]
//! ```
//!
//! The momentum law prepares its own problem too: its bounds are those of the first knot, and it decides where there is
//! no plan. Equations M116 to M126 of `docs/model`.

mod chain;
pub mod clearance;
pub mod config;
pub mod horizon;
pub mod model;
pub mod nonlinear;
pub mod plan;
pub(crate) mod prediction;

use super::law::setpoint::{Ahead, SetpointGenerator};
use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::control::command::Command;
use crate::control::modes::Modes;
use crate::control::preview::Preview;
use crate::control::state::ControllerState;
use crate::control::terms::{Present, Terms};
use crate::error::BuildError;
use crate::jets::JetModel;
use crate::qp::{PrimalActiveSet, QpAnswer, QpSolver, QpStatus};
use crate::robot::RobotModel;
use crate::spatial::{log_so3, stack};
use config::{Air, MpcConfig, POSTURE_GAIN};
use horizon::{Horizon, Target};
use model::Linearised;
use nalgebra::Vector6;
use nonlinear::Nonlinear;
use nonlinear::knot::World;
use plan::Plan;

/// Limit of the factorisations of one plan, over all its QPs: each has the values beyond their limits that the last answer
/// brought there, and takes at least one. Where they do not suffice, the last plan is followed. Of 32 flights in four configurations
/// after the loss of each engine, in calm and turbulent wind, the dearest plan took 95; before the loss 11.
const FACTORISATIONS_MAX: u32 = 300;
/// A plan is followed for at most this part of the horizon; by then the momentum QP decides.
const PLAN_SHARE: f64 = 0.25;

/// The predictive law of one controller, with its workspace.
#[derive(Debug)]
pub struct PredictiveLaw {
    /// Time from a tick until its command acts \[s\].
    latency: f64,
    air: Air,
    conventions: LinkConventions,
    period: f64,
    /// Whether it flies the descent too, and holds the heading there.
    flies_descent: bool,
    holds_heading: bool,
    time_step: f64,
    /// Greatest thrust rates \[N/s\].
    thrust_rate_max: Vec<f64>,
    joint_limits: Vec<(f64, f64)>,
    /// Of every joint: its place among those that the law moves.
    place: Vec<Option<usize>>,
    model: Linearised,
    horizon: Horizon,
    targets: Vec<Target>,
    /// Changes of the air's wrench with the wind, from now to the end of every knot \[N, N m\].
    wrenches: Vec<Vector6<f64>>,
    /// Forces in another wind.
    links: LinkForces,
    /// Inputs of the plan that is being made.
    inputs: Vec<f64>,
    solver: PrimalActiveSet,
    nonlinear: Option<Nonlinear>,
}

/// What is known of the motion after this tick.
#[derive(Debug)]
pub(super) struct Upcoming<'a> {
    /// Its set-points from the mission.
    pub(super) generator: &'a SetpointGenerator,
    /// What they follow.
    pub(super) ahead: Ahead,
    /// What is given beside the measurement.
    pub(super) preview: &'a Preview<'a>,
}

impl PredictiveLaw {
    /// A law for `robot`, whose commands act after `latency` \[s\], with the gains `K_D` and `K_P` of the torque law; joints are checked by the
    /// configuration.
    ///
    /// # Errors
    /// [`BuildError`] for a link that the robot does not have.
    #[allow(clippy::too_many_arguments, reason = "parts of the controller's configuration")]
    pub fn new(
        config: &MpcConfig,
        conventions: LinkConventions,
        latency: f64,
        robot: &RobotModel,
        jets: Vec<JetModel>,
        joints: Vec<usize>,
        gains: (f64, f64),
        thrust_rate_max: Vec<f64>,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        let nonlinear = || Nonlinear::new(config, robot, jets.clone(), joints.clone(), time_step);
        let nonlinear = config.nonlinear_descent.then(nonlinear).transpose()?;
        let horizon = Horizon::new(config, gains, robot, jets, &joints)?;
        let place = |joint| joints.iter().position(|moved| *moved == joint);
        Ok(Self {
            latency,
            air: config.air,
            conventions,
            period: config.period,
            flies_descent: config.descent.is_some(),
            holds_heading: config.descent.as_ref().is_none_or(|weights| weights.attitude[2] > 0.0),
            time_step,
            thrust_rate_max,
            joint_limits: robot.joints.iter().map(|joint| joint.limits).collect(),
            place: (0..robot.joints.len()).map(place).collect(),
            targets: vec![Target::default(); horizon.knots()],
            wrenches: vec![Vector6::zeros(); horizon.knots()],
            links: LinkForces::new(robot),
            inputs: vec![0.0; horizon.problem.len()],
            solver: PrimalActiveSet::new(horizon.problem.len()).with_iteration_limit(FACTORISATIONS_MAX),
            model: Linearised::new(robot, joints),
            horizon,
            nonlinear,
        })
    }

    /// Linearised model and horizon of the last plan.
    #[must_use]
    pub fn prediction(&self) -> (&Linearised, &Horizon) {
        (&self.model, &self.horizon)
    }

    /// Number of unknowns of the plan.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.horizon.problem.len()
    }

    /// Whether it flies in this tick: not on loaded feet, and a descent only where it is configured to.
    pub(super) fn flies(&self, state: &ControllerState, terms: &Terms) -> bool {
        !state.contact.is_active && (terms.limits.holds_position || self.flies_descent)
    }

    /// Whether the heading is held without an engine: it is where the descent has a weight for it.
    pub(super) fn holds_heading(&self) -> bool {
        self.holds_heading
    }

    /// The plan before the first one.
    pub(super) fn no_plan(&self) -> Plan {
        let nonlinear = self.nonlinear.as_ref().map(|of| of.no_plan.clone());
        Plan { nonlinear, ..Plan::none(self.unknowns(), self.thrust_rate_max.len()) }
    }

    /// Unknowns of its plan, and inputs of the nonlinear one.
    pub(super) fn sizes(&self) -> [usize; 2] {
        [self.unknowns(), self.nonlinear.as_ref().map_or(0, |of| of.inputs.len())]
    }

    /// Knots that the nonlinear plan of the last tick expanded.
    pub(super) fn expanded(&self) -> usize {
        self.nonlinear.as_ref().map_or(0, |of| of.expanded)
    }

    /// Commands the inputs of the nonlinear plan of a descent, which is improved in every tick; `false` without one that
    /// ends as it should.
    fn descend(
        &mut self,
        robot: &RobotModel,
        aero: &mut AeroModel,
        state: &mut ControllerState,
        speed: f64,
        terms: &Terms,
        command: &mut Command,
    ) -> bool {
        let Self { nonlinear, air, conventions, time_step, .. } = self;
        let ControllerState { plan, estimate, posture, setpoint, .. } = state;
        let planner = nonlinear.as_mut().zip(plan.nonlinear.as_mut());
        let Some((planner, plan)) = planner.filter(|_| !terms.limits.holds_position) else { return false };
        let now = Present { estimate, terms };
        let world = World {
            robot,
            conventions: *conventions,
            air: *air,
            now,
            posture,
            ground: setpoint.ground,
            speed,
        };
        let Some((answer, is_new)) = planner.improve(aero, world, plan) else { return false };
        let unknowns = &terms.momentum_qp.unknowns;
        let (jets, joints) = planner.inputs.split_at(unknowns.thrust_rate.len());
        command.thrust_rate.fill(0.0); // also of unused jets, whose rates may have been replaced
        for (jet, input) in jets.iter().enumerate() {
            let (thrust, rate) = (estimate.robot.thrust[jet], estimate.thrust_rate[jet]);
            let wanted = rate + *time_step * planner.acceleration(jet, thrust, rate, *input);
            command.thrust_rate[jet] = within_bounds(terms, unknowns.thrust_rate.start + jet, wanted);
        }
        let velocity = |place: usize| joints[place];
        command_joints(&self.place, state, terms, velocity, command);
        command.rates_qp = answer;
        command.modes.insert_if(!is_new, Modes::PLAN_KEPT);
        true
    }

    /// Commands the plan's inputs of this tick, of a new plan where one is due; `false` without a plan.
    pub(super) fn command(
        &mut self,
        robot: &RobotModel,
        aero: &mut AeroModel,
        state: &mut ControllerState,
        motion: &Upcoming,
        terms: &Terms,
        command: &mut Command,
    ) -> bool {
        let speed = motion.generator.descent_speed();
        if self.descend(robot, aero, state, speed, terms, command) {
            return true;
        }
        let time = state.estimate.robot.time;
        let is_due = time < state.plan.tried || time - state.plan.tried > self.period - 0.5 * self.time_step;
        let is_planned = !is_due || self.plan(robot, aero, state, motion, terms);
        let longest = PLAN_SHARE * self.horizon.durations().iter().sum::<f64>();
        let Some(age) = state.plan.age(time).filter(|age| *age <= longest) else { return false };
        self.follow_plan(state, terms, age, command);
        let answer = state.plan.answer.unwrap_or(QpAnswer::from_status(QpStatus::NonFinite));
        command.rates_qp = answer;
        command.modes.insert_if(!is_planned || answer.status != QpStatus::Solved, Modes::PLAN_KEPT);
        true
    }

    /// Makes a plan from the state of `terms`; `false` without a certified one.
    fn plan(
        &mut self,
        robot: &RobotModel,
        aero: &mut AeroModel,
        state: &mut ControllerState,
        motion: &Upcoming,
        terms: &Terms,
    ) -> bool {
        state.plan.tried = state.estimate.robot.time;
        let now = Present { terms, estimate: &state.estimate };
        if !self.model.update(robot, aero, self.air, now) {
            state.plan.answer = None;
            return false;
        }
        self.set_targets(state, motion, terms);
        self.set_wrenches(robot, aero, motion.preview, now);
        let ahead = (self.targets.as_slice(), self.wrenches.as_slice());
        self.horizon.update(&self.model, now, &state.posture, ahead, !terms.limits.holds_position);
        self.set_bounds(now);
        for (to, damping) in state.plan.damping.iter_mut().zip(self.horizon.prediction.damping()) {
            *to = damping;
        }
        let Self { horizon, solver, model, joint_limits, inputs, .. } = self;
        Self::search(horizon, solver, model, now, joint_limits, inputs, &mut state.plan)
    }

    /// Searches the inputs of least cost, with what they bring beyond its limits, from the last plan, in as many factorisations
    /// as the solver's limit; `false` without a certified answer. Public for benchmarks.
    #[doc(hidden)]
    pub fn search(
        horizon: &mut Horizon,
        solver: &mut PrimalActiveSet,
        model: &Linearised,
        now: Present,
        joint_limits: &[(f64, f64)],
        inputs: &mut [f64],
        plan: &mut Plan,
    ) -> bool {
        let Plan { inputs: last, warm, answer, since, tried, .. } = plan;
        if since.is_some() {
            horizon.update_excess(model, now, joint_limits, last);
        }
        let (mut factorisations, mut is_first) = (0, true);
        loop {
            let left = solver.iteration_limit() - factorisations;
            let found = solver.solve_from_at_most(left, warm, &horizon.problem);
            factorisations += found.iterations;
            *answer =
                Some(QpAnswer { iterations: factorisations, ..found }).filter(|found| !found.kkt.is_nan());
            if found.status != QpStatus::Solved {
                return false;
            }
            let to = solver.x();
            if !horizon.update_excess(model, now, joint_limits, to) {
                last.copy_from_slice(to);
                *since = Some(*tried);
                return true;
            }
            if std::mem::take(&mut is_first) {
                inputs.copy_from_slice(to);
                continue; // H and g have what these inputs bring beyond its limits
            }
            // The cost falls along the way; its least point has other values beyond their limits.
            let share = horizon.least_on_way(model, now, joint_limits, (&*inputs, to));
            for (input, to) in inputs.iter_mut().zip(to) {
                *input += share * (to - *input);
            }
            horizon.update_excess(model, now, joint_limits, inputs);
        }
    }

    /// The motion to follow at the end of every knot, as rotation vectors from the present attitude.
    fn set_targets(&mut self, state: &ControllerState, motion: &Upcoming, terms: &Terms) {
        let (Upcoming { generator, preview, .. }, time_step) = (motion, self.time_step);
        let mut ahead = state.setpoint;
        let (mut ticks, mut time) = (0_u32, state.estimate.robot.time);
        let present = state.estimate.robot.state.base.rotation.transpose();
        let mut setpoint = terms.setpoint;
        // The first knot begins when the command acts.
        let mut lead = (self.latency / time_step + 1e-6).floor() * time_step;
        let rest = self.latency - lead;
        for (target, duration) in self.targets.iter_mut().zip(self.horizon.durations()) {
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a checked number of ticks"
            )]
            for _ in 0..((lead + duration) / time_step).round() as usize {
                (ticks, time) = (ticks + 1, time + time_step);
                let after = f64::from(ticks) * time_step;
                let known = match motion.ahead {
                    Ahead::Motion => preview.setpoint(&terms.setpoint, after, 0.5 * time_step),
                    _ => None,
                };
                setpoint = if let Some(known) = known {
                    generator.take_motion(&mut ahead, &known.motion());
                    known
                } else {
                    generator.ahead(motion.ahead, &mut ahead, time)
                };
            }
            lead = 0.0;
            let setpoint = if rest > 1e-6 * time_step { setpoint.after(rest) } else { setpoint };
            let rotation = &setpoint.rotation;
            *target = Target {
                com: [setpoint.com_position, setpoint.com_velocity, setpoint.com_acceleration],
                rotation: log_so3(&(rotation * present)),
                angular: [rotation * setpoint.angular_velocity_b, rotation * setpoint.angular_acceleration_b],
            };
        }
    }

    /// Changes of the air's wrench on the robot in its present motion, by the wind at the end of every knot (M125).
    fn set_wrenches(&mut self, robot: &RobotModel, aero: &mut AeroModel, preview: &Preview, now: Present) {
        self.wrenches.fill(Vector6::zeros());
        if preview.wind.is_empty() {
            return;
        }
        let (Terms { kinematics, link_forces, .. }, wind_now) = (now.terms, now.estimate.robot.wind);
        let stacked = |links: &LinkForces| {
            let (force, moment) = links.wrench_about(&kinematics.com);
            stack(&force, &moment)
        };
        let (now, mut time) = (stacked(link_forces), self.latency);
        for (wrench, duration) in self.wrenches.iter_mut().zip(self.horizon.durations()) {
            time += duration;
            let wind = wind_now + preview.wind_change(time);
            self.links.update(robot, kinematics, self.conventions, aero, &wind);
            *wrench = stacked(&self.links) - now;
        }
    }

    /// Bounds of the inputs: in the first knot and block those of this tick, then the greatest rates.
    fn set_bounds(&mut self, now: Present) {
        let terms = now.terms;
        let (horizon, of_tick) = (&mut self.horizon, &terms.momentum_qp);
        let unknowns = &of_tick.unknowns;
        for knot in 0..horizon.knots() {
            for (jet, rate_max) in self.thrust_rate_max.iter().enumerate() {
                let unknown = horizon.thrust_input(knot, jet);
                let of_tick = unknowns.thrust_rate.start + jet;
                let (lower, upper) = match horizon.prediction.input_range(knot, jet, now) {
                    Some(of_engine) => of_engine,
                    None if knot == 0 => bounds_of(terms, of_tick),
                    None => (-rate_max, *rate_max),
                };
                (horizon.problem.lower[unknown], horizon.problem.upper[unknown]) = (lower, upper);
            }
            for (place, joint) in self.model.joints.iter().enumerate() {
                let unknown = horizon.joint_velocity(knot, place);
                let most = terms.limits.joint_velocity[*joint];
                let is_first = unknown == horizon.joint_velocity(0, place);
                let of_tick = unknowns.joint_velocity.start + joint;
                let (lower, upper) = if is_first { bounds_of(terms, of_tick) } else { (-most, most) };
                (horizon.problem.lower[unknown], horizon.problem.upper[unknown]) = (lower, upper);
            }
        }
    }

    /// Writes the inputs of the plan `age` \[s\] after its start, within the bounds of this tick.
    fn follow_plan(&self, state: &ControllerState, terms: &Terms, age: f64, command: &mut Command) {
        let unknowns = &terms.momentum_qp.unknowns;
        let mut knot = 0;
        let mut end = self.horizon.durations()[0];
        while knot + 1 < self.horizon.knots() && age > end - 0.5 * self.time_step {
            knot += 1;
            end += self.horizon.durations()[knot];
        }
        let inputs = &state.plan.inputs;
        command.thrust_rate.fill(0.0); // also of unused jets, whose rates may have been replaced
        for jet in 0..unknowns.thrust_rate.len() {
            let input = inputs[self.horizon.thrust_input(knot, jet)];
            let present = state.estimate.thrust_rate[jet];
            let rate = if self.horizon.prediction.has_engine(jet) {
                present + self.time_step * (input + state.plan.damping[jet] * present)
            } else {
                input
            };
            command.thrust_rate[jet] = within_bounds(terms, unknowns.thrust_rate.start + jet, rate);
        }
        let velocity = |place: usize| inputs[self.horizon.joint_velocity(knot, place)];
        command_joints(&self.place, state, terms, velocity, command);
    }
}

/// Commands the planned velocities of the joints that a plan moves; the others return to the posture.
fn command_joints(
    places: &[Option<usize>],
    state: &ControllerState,
    terms: &Terms,
    planned: impl Fn(usize) -> f64,
    command: &mut Command,
) {
    let first = terms.momentum_qp.unknowns.joint_velocity.start;
    for (joint, place) in places.iter().enumerate() {
        let away = state.estimate.robot.state.joint_position[joint] - state.posture[joint];
        let velocity = place.map_or(-POSTURE_GAIN * away, &planned);
        command.joint_velocity[joint] = within_bounds(terms, first + joint, velocity);
    }
}

/// The value of an unknown of the momentum QP that is nearest to the wanted one within the bounds of this tick.
fn within_bounds(terms: &Terms, unknown: usize, wanted: f64) -> f64 {
    let (lower, upper) = bounds_of(terms, unknown);
    wanted.max(lower).min(upper)
}

/// Bounds of an unknown of the momentum QP in this tick.
fn bounds_of(terms: &Terms, unknown: usize) -> (f64, f64) {
    let problem = &terms.momentum_qp.problem;
    (problem.lower[unknown], problem.upper[unknown])
}
