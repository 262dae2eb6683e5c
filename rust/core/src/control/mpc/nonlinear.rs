//! A descent by nonlinear model predictive control: iterated LQR on the centroidal dynamics over some seconds.
//!
//! ```text
//! x = (z, v, θ, k, T, Ṫ, s)      height, velocity, rotation, angular momentum, thrusts and their rates, moved joints
//! u = (λ, ṡ)                     place of each T̈ between its least and greatest one; joint velocities
//! x⁺ = x + h ẋ + h²/2 F ẋ        over a knot of length h, with F = ∂ẋ/∂x at its beginning
//! ```
//!
//! A trial flies the last plan's feedback from the present state. Dynamics and cost are expanded along it, and a backward pass
//! gives the feedback that minimises the expansion, with inputs within bounds (Li and Todorov 2004; Tassa et al. 2014). A
//! motion that costs more than expected ends there: the last plan is followed, and the next trial has a shorter step. The
//! motion of a first plan diverges within a second: it begins with few knots, and has more once it ends well. It ends at the
//! ground. The trials of a tick expand together no more knots than one of a whole plan.
//!
//! ```text
//! knot       dynamics and cost at a knot, expanded      [`knot`]
//! riccati    backward pass                              [`riccati`]
//! ```

pub mod knot;
#[doc(hidden)]
pub mod riccati;

use super::clearance::Clearance;
use super::config::MpcConfig;
use crate::aero::AeroModel;
use crate::error::{BuildError, check};
use crate::jets::JetModel;
use crate::linalg;
use crate::qp::{QpAnswer, QpStatus};
use crate::robot::RobotModel;
use crate::spatial::{exp_so3, log_so3};
use knot::{Expansion, Knot, State, World};
use nalgebra::DVector;
use riccati::Riccati;

/// Shares of the last plan's step that one trial after another flies until its motion costs no more than expected; the last is
/// taken anyhow.
const SHARES: [f64; 3] = [1.0, 0.3, 0.0];
/// Factor and sum by which a plan may cost more than the last one, because it begins elsewhere.
const GROWTH: f64 = 1.3;
const GROWTH_LEAST: f64 = 50.0;
/// Durations of the knots \[s\], 1.88 s together: manoeuvres of seconds.
const KNOTS: [f64; 27] = [
    0.02, 0.02, 0.04, 0.04, 0.04, 0.04, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08,
    0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08,
];
/// For how long the errors at the end of the last knot count \[s\].
const TAIL: f64 = 1.0;
/// Knots that the trials of a tick expand at most, with their ends: as many as one of a whole plan.
pub const WORK: usize = KNOTS.len() + 1;
/// Knots of a first plan.
const KNOTS_FIRST: usize = 13;
/// A plan whose robot is no higher above its touch-down than this does not end there \[m\].
const ABOVE_GROUND: f64 = 0.05;
/// Weight of a change of the inputs: at the first plan, its limits, and its factor after a plan whose whole step was flown;
/// its inverse after another one.
const DAMPING: f64 = 1.0;
const DAMPING_RANGE: [f64; 2] = [1e-3, 1e3];
const DAMPING_FACTOR: f64 = 0.25;
/// Greatest age of a plan that is improved \[s\]; in place of an older one a new plan begins.
const AGE_MAX: f64 = 0.2;
/// A plan ends well, and is followed, if it ends falling no faster \[m/s\], and with at least this cosine of the lean.
const END_DOWNWARDS: f64 = 3.0;
const END_UPRIGHT: f64 = 0.7;

/// The plan of a descent, a part of the controller's state.
#[derive(Debug, Clone, PartialEq)]
pub struct NonlinearPlan {
    /// The motion about which the feedback was found.
    motion: Motion,
    /// By knot: change of the inputs, and its derivative by the state (inputs × state).
    steps: Vec<f64>,
    gains: Vec<f64>,
    cost: f64,
    /// Time at which it begins \[s\]; `None` without a plan.
    since: Option<f64>,
    /// Weight of a change of the inputs.
    damping: f64,
    /// Greatest number of its knots.
    knots_max: usize,
    /// How many trials have not improved it.
    refused: usize,
    /// Certificate of its feedback.
    answer: Option<QpAnswer>,
}

/// States at the ends of the knots, and inputs by knot.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    /// Number of knots until it ends or reaches the ground.
    knots: usize,
    states: Vec<State>,
    inputs: Vec<f64>,
}

/// The planner, with its workspace.
#[derive(Debug)]
pub(super) struct Nonlinear {
    /// The plan of a state at the start of a flight.
    pub(super) no_plan: NonlinearPlan,
    knot: Knot,
    /// Knots that the trials of the last tick expanded, with their ends.
    pub(super) expanded: usize,
    flown: Motion,
    /// Dynamics and cost along it.
    expansions: Vec<Expansion>,
    riccati: Riccati,
    difference: DVector<f64>,
    /// Inputs after the last knot: none.
    none: Vec<f64>,
    /// Another state.
    state: State,
    /// Inputs of a first plan, and those at present.
    pub(super) inputs: Vec<f64>,
}

impl Nonlinear {
    /// # Errors
    /// [`BuildError`] for a link that the robot does not have, for longer ticks than knots, and without engines to plan with;
    /// `time_step` is that of the ticks \[s\].
    pub(super) fn new(
        mpc: &MpcConfig,
        robot: &RobotModel,
        jets: Vec<JetModel>,
        joints: Vec<usize>,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        let expected = format!("at most {} s, the first knot of `mpc.nonlinear_descent`", KNOTS[0]);
        check("controller.time_step", time_step, |x| x <= KNOTS[0] * (1.0 + 1e-6), &expected)?;
        if jets.iter().any(|jet| jet.engine.is_none()) {
            let expected = "throttled: `mpc.nonlinear_descent` plans with engines";
            return Err(BuildError::bad_value("controller.jet_dynamics", "ideal", expected));
        }
        let state = State::new(jets.len(), joints.len());
        let (n, m, knots) = (state.size(), jets.len() + joints.len(), KNOTS.len());
        let clearance = Clearance::new(mpc.clearance.as_ref(), robot, joints.len())?;
        let flown = Motion { knots, states: vec![state.clone(); knots + 1], inputs: vec![0.0; knots * m] };
        let no_plan = NonlinearPlan {
            motion: flown.clone(),
            steps: vec![0.0; knots * m],
            gains: vec![0.0; knots * m * n],
            cost: 0.0,
            since: None,
            damping: DAMPING,
            knots_max: knots,
            refused: 0,
            answer: None,
        };
        Ok(Self {
            no_plan,
            knot: Knot::new(mpc, robot, jets, joints, clearance),
            expanded: 0,
            flown,
            expansions: vec![Expansion::new(n, m); knots + 1],
            riccati: Riccati::new(n, m),
            difference: DVector::zeros(n),
            none: vec![0.0; m],
            inputs: vec![0.0; m],
            state,
        })
    }

    /// Improves the plan from the present state, and sets `inputs` to those at present. Returns the certificate of its feedback,
    /// and whether it is of this tick; `None` without a plan that ends well.
    pub(super) fn improve(
        &mut self,
        aero: &mut AeroModel,
        world: World,
        plan: &mut NonlinearPlan,
    ) -> Option<(QpAnswer, bool)> {
        let time = world.now.estimate.robot.time;
        self.knot.begin(&world);
        self.expanded = 0;
        let mut begun = plan.since.take().filter(|since| (0.0..=AGE_MAX).contains(&(time - since)));
        if begun.is_none() {
            self.knot.hold(&world, &mut self.inputs);
            (plan.damping, plan.knots_max) = (DAMPING, KNOTS_FIRST);
            let cost = self.fly(aero, &world, f64::INFINITY, KNOTS_FIRST, None);
            self.take(cost?, plan)?;
            begun = Some(time);
        }
        loop {
            let left = WORK - self.expanded;
            let more = (plan.knots_max + plan.knots_max / 2).min(KNOTS.len());
            let grows =
                plan.knots_max < KNOTS.len() && more < left && plan.damping <= DAMPING && plan.ends_well();
            if grows {
                plan.knots_max = more;
            }
            if plan.knots_max >= left {
                break;
            }
            let (share, age) = (SHARES[plan.refused], time - begun?);
            let is_last = plan.refused + 1 == SHARES.len();
            let most = if grows || is_last { f64::INFINITY } else { GROWTH * plan.cost + GROWTH_LEAST };
            match self.fly(aero, &world, most, plan.knots_max, Some((plan, share, age))) {
                None if is_last => return None,
                None => plan.refused += 1,
                Some(cost) => {
                    let factor = if plan.refused == 0 { DAMPING_FACTOR } else { 1.0 / DAMPING_FACTOR };
                    plan.damping = (plan.damping * factor).clamp(DAMPING_RANGE[0], DAMPING_RANGE[1]);
                    self.take(cost, plan)?;
                    begun = Some(time);
                }
            }
        }
        plan.since = begun;
        let (share, age) = (SHARES[plan.refused], time - begun?);
        self.feed_back(0, (plan, share, age), (0.0, KNOTS[0]));
        let m = self.inputs.len();
        self.inputs.copy_from_slice(&self.flown.inputs[..m]);
        plan.answer.filter(|_| plan.ends_well()).map(|answer| (answer, begun == Some(time)))
    }

    /// Makes the flown motion the plan's, with the feedback that improves it; `None` without one.
    fn take(&mut self, cost: f64, plan: &mut NonlinearPlan) -> Option<()> {
        let Self { riccati, expansions, flown, knot, inputs, .. } = self;
        let NonlinearPlan { motion, steps, gains, .. } = plan;
        motion.copy_from(flown, inputs.len());
        let inputs = &flown.inputs[..flown.knots * inputs.len()];
        let answer =
            riccati.solve(&expansions[..=flown.knots], inputs, &knot.bounds, plan.damping, (steps, gains));
        (plan.cost, plan.refused) = (cost, 0);
        plan.answer = Some(answer).filter(|answer| answer.status == QpStatus::Solved);
        plan.answer.map(|_| ())
    }

    /// Thrust acceleration of an input \[N/s²\].
    pub(super) fn acceleration(&self, jet: usize, thrust: f64, rate: f64, input: f64) -> f64 {
        self.knot.acceleration(jet, thrust, rate, input)
    }

    /// Flies the feedback of the last plan with a share of its step, which began so long ago \[s\], or `inputs` without one,
    /// over a number of knots or to the ground; returns the cost, `None` where it exceeds `most`, the inertia cannot be
    /// inverted or a number is not finite.
    fn fly(
        &mut self,
        aero: &mut AeroModel,
        world: &World,
        most: f64,
        knots: usize,
        last: Option<(&NonlinearPlan, f64, f64)>,
    ) -> Option<f64> {
        let m = self.inputs.len();
        let (mut cost, mut begin) = (0.0, 0.0);
        self.flown.states[0].set_from(&world.now, &self.knot.joints);
        let is_high = self.flown.states[0].height > world.ground + ABOVE_GROUND;
        self.flown.knots = knots;
        for (knot, &duration) in KNOTS.iter().enumerate().take(knots) {
            if is_high && self.flown.states[knot].height < world.ground {
                self.flown.knots = knot;
                break;
            }
            if let Some(last) = last {
                self.feed_back(knot, last, (begin, begin + duration));
            } else {
                self.flown.inputs[knot * m..(knot + 1) * m].copy_from_slice(&self.inputs);
            }
            self.expanded += 1;
            let Motion { states, inputs, .. } = &mut self.flown;
            let (before, after) = states.split_at_mut(knot + 1);
            let now = (&before[knot], &inputs[knot * m..(knot + 1) * m]);
            let expansion = &mut self.expansions[knot];
            self.knot.advance(aero, world, now, (duration, duration), &mut after[0], expansion)?;
            cost += expansion.cost;
            if cost > most {
                return None; // no knot costs less than nothing
            }
            begin += duration;
        }
        self.expanded += 1;
        let knots = self.flown.knots;
        let (end, last) = ((&self.flown.states[knots], &*self.none), &mut self.expansions[knots]);
        self.knot.advance(aero, world, end, (0.0, TAIL), &mut self.state, last)?;
        cost += last.cost;
        (cost.is_finite() && cost <= most).then_some(cost)
    }

    /// Sets the flown inputs of a knot, between times from now on \[s\], to those of a plan with a share of its step, which began
    /// so long ago \[s\], and its feedback from the state there.
    fn feed_back(
        &mut self,
        knot: usize,
        (plan, share, age): (&NonlinearPlan, f64, f64),
        (begin, end): (f64, f64),
    ) {
        let (n, m) = (self.difference.len(), self.inputs.len());
        let inputs = &mut self.flown.inputs[knot * m..(knot + 1) * m];
        let place = plan.read((age + begin, age + end), share, inputs, &mut self.state);
        self.flown.states[knot].minus(&self.state, &mut self.difference);
        let gain = &plan.gains[place * m * n..(place + 1) * m * n];
        linalg::add_mat_vec(inputs, gain, m, self.difference.as_slice());
        for (input, (least, greatest)) in inputs.iter_mut().zip(&self.knot.bounds) {
            *input = input.max(*least).min(*greatest);
        }
    }
}

impl Motion {
    /// Copies the knots of another motion, of so many inputs each; those after its end stay.
    fn copy_from(&mut self, other: &Self, inputs: usize) {
        self.knots = other.knots;
        for (to, from) in self.states.iter_mut().zip(&other.states).take(1 + other.knots) {
            to.copy_from(from);
        }
        let inputs = other.knots * inputs;
        self.inputs[..inputs].copy_from_slice(&other.inputs[..inputs]);
    }
}

impl NonlinearPlan {
    /// It is not followed any further.
    pub(super) fn discard(&mut self) {
        self.since = None;
    }

    /// Cost of the motion about which its feedback was found, and the motion's inputs by knot; `None` without a plan.
    #[must_use]
    pub fn motion(&self) -> Option<(f64, &[f64])> {
        let Motion { knots, states, inputs } = &self.motion;
        let of_knot = inputs.len() / (states.len() - 1);
        self.since.map(|_| (self.cost, &inputs[..knots * of_knot]))
    }

    fn ends_well(&self) -> bool {
        let end = &self.motion.states[self.motion.knots];
        end.velocity.z > -END_DOWNWARDS && end.rotation[(2, 2)] > END_UPRIGHT
    }

    /// Writes the mean of the inputs between two times \[s\] with a share of their step, and the state at the first time;
    /// returns its knot.
    fn read(&self, (begin, end): (f64, f64), of_step: f64, inputs: &mut [f64], state: &mut State) -> usize {
        let m = inputs.len();
        inputs.fill(0.0);
        let (mut start, mut found) = (0.0, None);
        for (place, length) in KNOTS.iter().enumerate().take(self.motion.knots) {
            let is_last = place + 1 == self.motion.knots;
            let stop = if is_last { f64::INFINITY } else { start + length };
            let share = (end.min(stop) - begin.max(start)).max(0.0) / (end - begin);
            if share > 0.0 {
                let range = place * m..(place + 1) * m;
                linalg::add_scaled(inputs, share, &self.motion.inputs[range.clone()]);
                linalg::add_scaled(inputs, share * of_step, &self.steps[range]);
                if found.is_none() {
                    let way = ((begin - start) / length).min(1.0);
                    state.set_between(&self.motion.states[place], &self.motion.states[place + 1], way);
                    found = Some(place);
                }
            }
            start = stop;
        }
        found.unwrap_or(0)
    }
}

impl State {
    fn copy_from(&mut self, other: &Self) {
        let Self { height, velocity, rotation, momentum, thrust, rate, joints } = other;
        (self.height, self.velocity) = (*height, *velocity);
        (self.rotation, self.momentum) = (*rotation, *momentum);
        self.thrust.copy_from_slice(thrust);
        self.rate.copy_from_slice(rate);
        self.joints.copy_from_slice(joints);
    }

    /// The state at a share of the way from one to another.
    fn set_between(&mut self, from: &Self, to: &Self, way: f64) {
        let blend = |from: f64, to: f64| from + way * (to - from);
        self.height = blend(from.height, to.height);
        self.velocity = from.velocity.lerp(&to.velocity, way);
        let turn = log_so3(&(to.rotation * from.rotation.transpose()));
        self.rotation = exp_so3(&(turn * way)) * from.rotation;
        self.momentum = from.momentum.lerp(&to.momentum, way);
        for (own, from, to) in [
            (&mut self.thrust, &from.thrust, &to.thrust),
            (&mut self.rate, &from.rate, &to.rate),
            (&mut self.joints, &from.joints, &to.joints),
        ] {
            for (own, (from, to)) in own.iter_mut().zip(from.iter().zip(to)) {
                *own = blend(*from, *to);
            }
        }
    }
}
