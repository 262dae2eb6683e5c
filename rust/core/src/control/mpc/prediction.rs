//! The motion over the horizon, as it is without inputs and by each of them.
//!
//! ```text
//! w                        change of the wrench of the air with the wind ahead
//! y = (δp, δv, θ, δk)      motion of the centre of mass, rotation, angular momentum; the present one is zero
//! d                        states of jets and joints, driven by the inputs alone (`chain`)
//! u = (u_T, ṡ*)            inputs of the thrusts; joint velocities of the moved joints
//! ẏ = A_c y + A_d d + B w + c    δë of the torque law: s̈ = K_D (ṡ* − ṡ) − K_P δe,  δė = ṡ − ṡ*
//! ```
//!
//! `u` and `w` are constant between knots, so every knot is exact: a Taylor series for a short time, and squares of it.
//! Equations M120, M122, M125 and M174 of `docs/model`.

use super::chain::{Answers, Chain, along};
use super::config::MpcConfig;
use super::model::Linearised;
use crate::control::terms::Present;
use crate::jets::JetModel;
use crate::linalg;
use crate::robot::RobotModel;
use crate::spatial::skew;
use nalgebra::{SMatrix, SVector, Vector3, Vector6};

/// Entries of `y`, and of the outputs that are not entries of it: ω, a and α.
const CORE: usize = 12;
const RATES: usize = 9;
/// Entries of `w`.
const WRENCH: usize = 6;
/// Outputs (p, v, θ, ω, a, α) at the end of a knot.
pub(super) const OUTPUTS: usize = 18;
/// Terms of the Taylor series, and the greatest product of a joint's fastest rate and its time: with `K_D h = 0.3` the
/// remainder is below 1e-10.
const TERMS: u32 = 8;
const STEP: f64 = 0.5;

type Core = SMatrix<f64, CORE, CORE>;
type Column = SVector<f64, CORE>;
type Rates = SVector<f64, RATES>;

/// Outputs of one instant: p, v, θ, ω, a, α.
pub(super) type Outputs = [Vector3<f64>; OUTPUTS / 3];

/// Derivative or transition of `y`: by `y`, by the states of each chain, by each entry of `u` and `w`, and its part that
/// depends on none.
#[derive(Debug, Clone)]
struct Step {
    by_y: Core,
    by_d: Vec<[Column; 3]>,
    by_u: Vec<Column>,
    by_w: [Column; WRENCH],
    drift: Column,
}

impl Step {
    /// No motion.
    fn none(chains: usize) -> Self {
        let zero = Column::zeros();
        let (by_d, by_u, by_w) = (vec![[zero; 3]; chains], vec![zero; chains], [zero; WRENCH]);
        Self { by_y: Core::identity(), by_d, by_u, by_w, drift: zero }
    }

    /// Columns after `by_y`.
    fn columns(&mut self) -> impl Iterator<Item = &mut Column> {
        let by_d = self.by_d.as_flattened_mut().iter_mut();
        by_d.chain(&mut self.by_u).chain(&mut self.by_w).chain([&mut self.drift])
    }

    fn set_none(&mut self) {
        self.by_y = Core::identity();
        self.columns().for_each(|column| column.fill(0.0));
    }
}

/// The prediction; preallocated. Chains are the jets, then the joints that the law moves.
#[derive(Debug, Clone)]
pub struct Prediction {
    pub(super) durations: Vec<f64>,
    /// Time of the series \[s\], and of each knot the duration in terms of it, as a power of two.
    series: f64,
    power: Vec<usize>,
    pub(super) jets: usize,
    pub(super) joints: usize,
    gains: (f64, f64),
    models: Vec<JetModel>,
    /// Of each jet, then of every joint.
    chains: Vec<Chain>,
    answers: Vec<Answers>,
    /// Present states of the chains without inputs, and at the end of each knot.
    now: Vec<Vector3<f64>>,
    pub(super) free: Vec<Vec<Vector3<f64>>>,
    /// `A_c`, `A_d`, B, c; the inputs act on `d` alone.
    dynamics: Step,
    /// ω, a and α by `y`, `d`, `u` and `w`, and their constant part.
    rates_by_y: SMatrix<f64, RATES, CORE>,
    rates_by_d: Vec<[Rates; 3]>,
    rates_by_u: Vec<Rates>,
    rates_by_w: [Rates; WRENCH],
    rates: Rates,
    /// Transitions over each power of the series' time.
    steps: Vec<Step>,
    term: Step,
    /// `y` without inputs, and by every unknown, at the present knot; the change of the wrench there.
    y: Column,
    wrench: Vector6<f64>,
    sensitivity: Vec<Column>,
}

impl Prediction {
    pub(super) fn new(
        config: &MpcConfig,
        gains: (f64, f64),
        robot: &RobotModel,
        models: Vec<JetModel>,
        joints: usize,
    ) -> Self {
        let (jets, durations) = (robot.jets.len(), config.knots.clone());
        let (knots, joint) = (durations.len(), Chain::of_joint(gains));
        let halvings = joint.halvings(durations[0], STEP);
        let series = durations[0] / f64::from(1_u32 << halvings);
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked by the configuration"
        )]
        let power: Vec<usize> =
            durations.iter().map(|duration| libm::log2(duration / series).round() as usize).collect();
        let powers = power.last().map_or(1, |last| last + 1);
        let counts = config.joint_knots.iter().enumerate();
        let block: Vec<usize> = counts.flat_map(|(block, count)| vec![block; *count]).collect();
        let mut chains = vec![Chain::ideal_jet(); jets];
        let of_jet = Answers::new(&Chain::ideal_jet(), series, &power, (0..knots).collect());
        let mut answers = vec![of_jet; jets];
        answers.push(Answers::new(&joint, series, &power, block));
        chains.push(joint);
        let step = Step::none(jets + joints);
        Self {
            sensitivity: vec![Column::zeros(); jets * knots + joints * config.joint_knots.len()],
            durations,
            series,
            power,
            jets,
            joints,
            gains,
            models,
            chains,
            answers,
            now: vec![Vector3::zeros(); jets + joints],
            free: vec![vec![Vector3::zeros(); jets + joints]; knots],
            rates_by_y: SMatrix::zeros(),
            rates_by_d: vec![[Rates::zeros(); 3]; jets + joints],
            rates_by_u: vec![Rates::zeros(); jets + joints],
            rates_by_w: [Rates::zeros(); WRENCH],
            rates: Rates::zeros(),
            steps: vec![step.clone(); powers],
            term: step.clone(),
            dynamics: step,
            y: Column::zeros(),
            wrench: Vector6::zeros(),
        }
    }

    pub(super) fn knots(&self) -> usize {
        self.durations.len()
    }

    /// Number of unknowns.
    pub(super) fn unknowns(&self) -> usize {
        self.sensitivity.len()
    }

    /// Unknown of the input of a chain in a block: first those of the jets.
    pub(super) fn unknown(&self, chain: usize, block: usize) -> usize {
        match chain.checked_sub(self.jets) {
            None => block * self.jets + chain,
            Some(joint) => self.jets * self.knots() + block * self.joints + joint,
        }
    }

    /// Answers of a chain.
    pub(super) fn answers(&self, chain: usize) -> &Answers {
        &self.answers[chain.min(self.jets)]
    }

    /// Whether a chain is a jet with an engine.
    pub(super) fn has_engine(&self, chain: usize) -> bool {
        self.models.get(chain).is_some_and(|jet| jet.engine.is_some())
    }

    /// Chains and blocks whose inputs have acted at the end of a knot, with their unknowns.
    pub(super) fn acting(&self, knot: usize) -> impl Iterator<Item = (usize, usize, usize)> {
        let of_chain = move |chain| (0..=self.answers(chain).block[knot]).map(move |block| (chain, block));
        let chains = (0..self.jets + self.joints).flat_map(of_chain);
        chains.map(move |(chain, block)| (chain, block, self.unknown(chain, block)))
    }

    /// Rebuilds it at the present state, before the first knot.
    pub(super) fn update(&mut self, model: &Linearised, now: Present) {
        self.write_chains(model, now);
        self.write_dynamics(model, now);
        self.write_rates(model, now);
        self.write_steps();
        self.y.fill(0.0);
        self.wrench.fill(0.0);
        self.sensitivity.fill(Column::zeros());
    }

    /// What each jet does by its inputs, and all chains without them. An engine that does not reach its thrusts keeps the
    /// present one; the rate of an ideal jet is its input.
    fn write_chains(&mut self, model: &Linearised, now: Present) {
        let estimate = now.estimate;
        self.now.fill(Vector3::zeros());
        for jet in 0..self.jets {
            let Some(engine) = &self.models[jet].engine else { continue };
            self.chains[jet] =
                Chain::of_engine(engine, estimate.robot.thrust[jet], estimate.thrust_rate[jet]);
            self.answers[jet].update(&self.chains[jet], self.series, &self.power);
            if now.terms.limits.works[jet] {
                self.now[jet][1] = estimate.thrust_rate[jet];
            }
        }
        for (state, joint) in self.now[self.jets..].iter_mut().zip(&model.joints) {
            state[1] = estimate.robot.state.joint_velocity()[*joint];
        }
        for knot in 0..self.knots() {
            for chain in 0..self.now.len() {
                let transition = self.answers(chain).by_power[self.power[knot]].transition;
                self.free[knot][chain] = transition * self.before(knot)[chain];
            }
        }
    }

    /// States of the chains at the beginning of a knot, without inputs.
    fn before(&self, knot: usize) -> &[Vector3<f64>] {
        knot.checked_sub(1).map_or(&self.now, |last| &self.free[last])
    }

    /// Least and greatest input of a jet's engine in a knot, from the limits of its throttle along the motion without
    /// inputs (M174); `None` for ideal jets. An engine that does not reach its thrusts has none.
    #[must_use]
    pub fn input_range(&self, knot: usize, jet: usize, now: Present) -> Option<(f64, f64)> {
        let engine = self.models[jet].engine?;
        if !now.terms.limits.works[jet] {
            return Some((0.0, 0.0));
        }
        let state = self.before(knot)[jet];
        let thrust = now.estimate.robot.thrust[jet] + state[0];
        let (least, greatest) = engine.lasting_range(thrust, state[1]);
        let free = (self.chains[jet].a.row(1) * state)[0];
        Some((least - free, greatest - free))
    }

    /// `β` of each engine \[1/s\]; zero for ideal jets.
    pub(super) fn damping(&self) -> impl Iterator<Item = f64> {
        self.chains[..self.jets].iter().map(|chain| chain.a[(1, 1)])
    }

    /// `A_c`, `A_d`, B and c.
    fn write_dynamics(&mut self, model: &Linearised, now: Present) {
        let jets = self.jets;
        let mass = now.terms.kinematics.mass();
        let state = &now.estimate.robot.state;
        let omega = state.base_angular_velocity();
        let Step { by_y, by_d, by_w, drift, .. } = &mut self.dynamics;
        by_y.fill(0.0);
        by_y.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        drift.fixed_rows_mut::<3>(0).copy_from(&(now.terms.dynamics.momentum.fixed_rows::<3>(0) / mass));
        for (row, first, scale) in [(3, 0, mass.recip()), (9, 3, 1.0)] {
            for (column, by) in [(3, &model.rate_v), (6, &model.rate_theta), (9, &model.rate_k)] {
                by_y.fixed_view_mut::<3, 3>(row, column).copy_from(&(by.fixed_rows::<3>(first) * scale));
            }
            for (chain, state, by) in
                [(0, 0, &model.rate_t), (jets, 0, &model.rate_s), (jets, 1, &model.rate_sigma)]
            {
                for (to, from) in by_d[chain..].iter_mut().zip(by.column_iter()) {
                    to[state].fixed_rows_mut::<3>(row).copy_from(&(from.fixed_rows::<3>(first) * scale));
                }
            }
            for axis in 0..3 {
                by_w[first + axis][row + axis] = scale;
            }
            let rate = now.terms.momentum.rate_estimate.fixed_rows::<3>(first) * scale;
            drift.fixed_rows_mut::<3>(row).copy_from(&rate);
        }
        // θ̇ = J_l⁻¹(θ) ω, with J_l⁻¹ = 1 − S(θ)/2 + …
        by_y.fixed_view_mut::<3, 3>(6, 6).copy_from(&(model.omega_theta + skew(&omega) * 0.5));
        by_y.fixed_view_mut::<3, 3>(6, 9).copy_from(&model.omega_k);
        for (state, by) in [&model.omega_s, &model.omega_sigma].into_iter().enumerate() {
            for (to, from) in by_d[jets..].iter_mut().zip(by.column_iter()) {
                to[state].fixed_rows_mut::<3>(6).copy_from(&from);
            }
        }
        drift.fixed_rows_mut::<3>(6).copy_from(&omega);
        // d holds velocities, of which the present ones are part of the present rates.
        for (of_joint, joint) in by_d[jets..].iter().zip(&model.joints) {
            *drift -= of_joint[1] * state.joint_velocity()[*joint];
        }
    }

    /// ω, a and α: `α = ω_θ θ̇ + ω_k k̇ + ω_s ṡ + ω_ṡ s̈`.
    fn write_rates(&mut self, model: &Linearised, now: Present) {
        let (kd, kp) = self.gains;
        let (theta, k) = (model.omega_theta, model.omega_k);
        let half = skew(&now.estimate.robot.state.base_angular_velocity()) * 0.5;
        let of = |column: &Column| {
            let mut rates = Rates::zeros();
            let turn: Vector3<f64> = column.fixed_rows::<3>(6).into();
            rates.fixed_rows_mut::<3>(0).copy_from(&turn);
            rates.fixed_rows_mut::<3>(3).copy_from(&column.fixed_rows::<3>(3));
            let alpha = theta * turn + k * column.fixed_rows::<3>(9);
            rates.fixed_rows_mut::<3>(6).copy_from(&alpha);
            rates
        };
        for (column, of_y) in self.dynamics.by_y.column_iter().enumerate() {
            self.rates_by_y.set_column(column, &of(&of_y.into()));
        }
        // ω itself has no half of S(ω), which belongs to θ̇.
        let mut by_theta = self.rates_by_y.fixed_view_mut::<3, 3>(0, 6);
        by_theta -= half;
        for (to, from) in self.rates_by_d.iter_mut().zip(&self.dynamics.by_d) {
            *to = from.each_ref().map(of);
        }
        self.rates_by_w = self.dynamics.by_w.each_ref().map(of);
        self.rates = of(&self.dynamics.drift);
        let joints = self.rates_by_d[self.jets..].iter_mut().zip(&mut self.rates_by_u[self.jets..]);
        let of_model = model.omega_s.column_iter().zip(model.omega_sigma.column_iter());
        for (([_, of_sigma, of_e], of_input), (by_s, by_sigma)) in
            joints.map(|(of_states, of_input)| (of_states.each_mut(), of_input)).zip(of_model)
        {
            let mut alpha = of_sigma.fixed_rows_mut::<3>(6);
            alpha += by_s - by_sigma * kd;
            let mut alpha = of_e.fixed_rows_mut::<3>(6);
            alpha -= by_sigma * kp;
            of_input.fixed_rows_mut::<3>(6).copy_from(&(by_sigma * kd));
        }
    }

    /// Transitions: the Taylor series of the shortest time, then squares.
    fn write_steps(&mut self) {
        let Self { steps, term, dynamics, jets, chains, answers, series, .. } = self;
        let chain_of = |place: usize| place.min(*jets);
        // Rows of y of the powers of the whole matrix: X ← X A h / order.
        let first = &mut steps[0];
        first.set_none();
        term.set_none();
        for order in 1..=TERMS {
            let scale = *series / f64::from(order);
            for (place, of_states) in term.by_d.iter_mut().enumerate() {
                let (chain, last) = (&chains[chain_of(place)], *of_states);
                term.by_u[place] = along(&last, &chain.b) * scale;
                for (state, of_state) in of_states.iter_mut().enumerate().take(chain.states) {
                    let through = along(&last, chain.a.column(state).iter());
                    *of_state = if state < chain.acting {
                        (times(&term.by_y, &dynamics.by_d[place][state]) + through) * scale
                    } else {
                        through * scale
                    };
                }
            }
            term.by_w = dynamics.by_w.each_ref().map(|column| times(&term.by_y, column) * scale);
            term.drift = times(&term.by_y, &dynamics.drift) * scale;
            term.by_y = times_core(&term.by_y, &dynamics.by_y) * scale;
            first.by_y += term.by_y;
            for (sum, term) in first.columns().zip(term.columns()) {
                *sum += *term;
            }
        }
        for doubling in 1..steps.len() {
            let (before, after) = steps.split_at_mut(doubling);
            let (half, whole) = (&before[doubling - 1], &mut after[0]);
            whole.by_y = times_core(&half.by_y, &half.by_y);
            whole.by_w = half.by_w.each_ref().map(|column| times(&half.by_y, column) + column);
            whole.drift = times(&half.by_y, &half.drift) + half.drift;
            for (place, of_states) in half.by_d.iter().enumerate() {
                let chain = chain_of(place);
                let answer = &answers[chain].by_power[doubling - 1];
                for state in 0..chains[chain].states {
                    let through = along(of_states, answer.transition.column(state).iter());
                    whole.by_d[place][state] = times(&half.by_y, &of_states[state]) + through;
                }
                let of_input = &half.by_u[place];
                whole.by_u[place] = times(&half.by_y, of_input) + along(of_states, &answer.input) + of_input;
            }
        }
    }

    /// Goes on to the end of a knot, where the change of the wrench is `wrench`.
    pub(super) fn advance(&mut self, knot: usize, wrench: &Vector6<f64>) {
        let step = &self.steps[self.power[knot]];
        // Within the knot the mean of both ends: it needs no wind but that of the ends, where ω, a and α do.
        let mean = (self.wrench + wrench) * 0.5;
        let mut next = times(&step.by_y, &self.y) + by_wrench(&step.by_w, &mean) + step.drift;
        for (of_states, state) in step.by_d.iter().zip(self.before(knot)) {
            next += along(of_states, state);
        }
        (self.y, self.wrench) = (next, *wrench);
        let (places, chains) = (self.jets, self.jets + self.joints);
        for chain in 0..chains {
            let answers = &self.answers[chain.min(places)];
            let last = answers.block[knot];
            for block in 0..=last {
                let unknown = self.unknown(chain, block);
                let before = &self.sensitivity[unknown];
                let mut next =
                    times(&step.by_y, before) + along(&step.by_d[chain], &answers.before(knot, block));
                if block == last {
                    next += step.by_u[chain];
                }
                self.sensitivity[unknown] = next;
            }
        }
    }

    /// Outputs at the end of the knot that was reached, without inputs, from the centre of mass and its velocity at present.
    pub(super) fn free_outputs(&self, knot: usize, position: &Vector3<f64>) -> Outputs {
        let mut rates = self.rates + self.rates_by_y * self.y + by_wrench(&self.rates_by_w, &self.wrench);
        for (of_states, state) in self.rates_by_d.iter().zip(&self.free[knot]) {
            rates += along(of_states, state);
        }
        let velocity = self.dynamics.drift.fixed_rows::<3>(0);
        let [p, v, theta, omega, a, alpha] = join(&self.y, &rates);
        [position + p, velocity + v, theta, omega, a, alpha]
    }

    /// The same by the input of a chain in a block.
    pub(super) fn outputs_by(&self, knot: usize, (chain, block): (usize, usize)) -> Outputs {
        let column = &self.sensitivity[self.unknown(chain, block)];
        let answers = self.answers(chain);
        let mut rates =
            self.rates_by_y * column + along(&self.rates_by_d[chain], &answers.reach[knot][block]);
        if block == answers.block[knot] {
            rates += self.rates_by_u[chain];
        }
        join(column, &rates)
    }
}

/// Outputs from `y` and from ω, a and α.
fn join(y: &Column, rates: &Rates) -> Outputs {
    let part = |first: usize| Vector3::new(y[first], y[first + 1], y[first + 2]);
    let rate = |first: usize| Vector3::new(rates[first], rates[first + 1], rates[first + 2]);
    [part(0), part(3), part(6), rate(0), rate(3), rate(6)]
}

/// Effect of a wrench.
fn by_wrench<const N: usize>(columns: &[SVector<f64, N>; WRENCH], wrench: &Vector6<f64>) -> SVector<f64, N> {
    columns.iter().zip(wrench).map(|(column, part)| column * *part).sum()
}

/// `A x`.
fn times(a: &Core, x: &Column) -> Column {
    let mut y = Column::zeros();
    linalg::add_mat_vec(y.as_mut_slice(), a.as_slice(), CORE, x.as_slice());
    y
}

fn times_core(a: &Core, b: &Core) -> Core {
    let mut product = Core::zeros();
    for (to, from) in product.as_mut_slice().chunks_exact_mut(CORE).zip(b.as_slice().chunks_exact(CORE)) {
        linalg::add_mat_vec(to, a.as_slice(), CORE, from);
    }
    product
}
