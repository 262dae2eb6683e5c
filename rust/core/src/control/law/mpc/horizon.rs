//! The prediction over the horizon, and the QP in its inputs.
//!
//! ```text
//! w                        change of the wrench of the air with the wind ahead
//! y = (δp, δv, θ, δk)      motion of the centre of mass, rotation, angular momentum; the present one is zero
//! d = (δT, δs, ṡ, δe, Ṫ)   thrusts, joints, their velocities and velocity errors, thrust rates: driven by the inputs alone
//! u = (u_T, ṡ*)            inputs of the thrusts; joint velocities of the moved joints
//! Ṫ = u_T                  ideal jets: the inputs are thrust rates
//! T̈ = α δT + β Ṫ + u_T     engines about the steady thrust T, at the throttle that holds it (M174)
//! ẏ = A_c y + A_d d + B w + c    δë of the torque law: s̈ = K_D (ṡ* − ṡ) − K_P δe,  δė = ṡ − ṡ*
//! ```
//!
//! `u` and `w` are constant between knots, so every knot is exact: a Taylor series for the shortest, and squares of it.
//! The states are eliminated; H and g collect the squares of the outputs' errors. Equations M120 to M126 and M174 of
//! `docs/model`.

use super::clearance::Clearance;
use super::config::{MpcConfig, MpcWeights};
use super::model::Linearised;
use crate::control::terms::Terms;
use crate::error::BuildError;
use crate::jets::JetModel;
use crate::linalg;
use crate::qp::QpProblem;
use crate::robot::RobotModel;
use crate::spatial::skew;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3, Vector6};

/// Entries of `y`, and of the outputs that are not entries of it: ω, a and α.
const CORE: usize = 12;
const RATES: usize = 9;
/// Entries of `w`.
const WRENCH: usize = 6;
/// Outputs (p, v, θ, ω, a, α) at the end of a knot, and rows of the tail.
const OUTPUTS: usize = 18;
const TAIL: usize = 6;
/// Terms of the Taylor series of the shortest knot: with `K_D h = 0.2` the remainder is below 1e-12.
const TERMS: u32 = 8;
/// Time that makes the input of an engine \[N/s²\] comparable with a thrust rate \[s\].
const INPUT_TIME: f64 = 0.03;
/// Steps of the bisection for the least cost on a way.
const BISECTIONS: u32 = 40;

type Core = SMatrix<f64, CORE, CORE>;
type Column = SVector<f64, CORE>;
type Rates = SVector<f64, RATES>;

/// Motion that the robot should have at the end of a knot, inertial axes.
#[derive(Debug, Clone, Copy, Default)]
pub struct Target {
    /// Centre of mass, velocity, acceleration \[m, m/s, m/s²\].
    pub com: [Vector3<f64>; 3],
    /// Rotation vector from the present attitude \[rad\].
    pub rotation: Vector3<f64>,
    /// Angular velocity and acceleration \[rad/s, rad/s²\].
    pub angular: [Vector3<f64>; 2],
}

impl Target {
    fn outputs(&self) -> Outputs {
        let ([p, v, a], [omega, alpha]) = (self.com, self.angular);
        [p, v, self.rotation, omega, a, alpha]
    }
}

/// Answer of the three states `(s, ṡ, e)` of a joint to its own values, and to a constant command, over some time.
#[derive(Debug, Clone, Copy)]
struct Chain {
    transition: Matrix3<f64>,
    input: Vector3<f64>,
}

impl Chain {
    /// Over `time` \[s\], by a Taylor series after halving, for the gains `K_D`, `K_P` of the torque law.
    fn new((kd, kp): (f64, f64), time: f64) -> Self {
        let a = Matrix3::new(0.0, 1.0, 0.0, 0.0, -kd, -kp, 0.0, 1.0, 0.0);
        let b = Vector3::new(0.0, kd, -1.0);
        let halvings = libm::log2(time * (kd + kp.sqrt() + 1.0) * 16.0).ceil().max(0.0);
        let step = time / libm::exp2(halvings);
        let (mut chain, mut power) =
            (Self { transition: Matrix3::identity(), input: Vector3::zeros() }, Matrix3::identity());
        let mut scale = step;
        for order in 1..=10 {
            chain.input += power * b * scale;
            power *= a;
            chain.transition += power * scale;
            scale *= step / f64::from(order + 1);
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few halvings")]
        for _ in 0..halvings as u32 {
            chain = chain.twice();
        }
        chain
    }

    fn twice(&self) -> Self {
        Self {
            transition: self.transition * self.transition,
            input: self.transition * self.input + self.input,
        }
    }
}

/// Answer of the states `(δT, Ṫ)` of a jet to its own values, and to a constant input, over some time.
#[derive(Debug, Clone, Copy)]
struct JetChain {
    transition: Matrix2<f64>,
    input: Vector2<f64>,
}

impl JetChain {
    /// Over `time` \[s\]: ideal, or with the slopes `α` \[1/s²\] and `β` \[1/s\] of an engine, by a Taylor series, which a
    /// knot's first duration makes exact to rounding.
    fn new(slopes: Option<(f64, f64)>, time: f64) -> Self {
        let mut chain = Self { transition: Matrix2::identity(), input: Vector2::new(time, 0.0) };
        let Some((by_thrust, by_rate)) = slopes else { return chain };
        let (a, b) = (Matrix2::new(0.0, 1.0, by_thrust, by_rate), Vector2::new(0.0, 1.0));
        chain.input = Vector2::zeros();
        let (mut power, mut scale) = (Matrix2::identity(), time);
        for order in 1..=TERMS {
            chain.input += power * b * scale;
            power *= a;
            chain.transition += power * scale;
            scale *= time / f64::from(order + 1);
        }
        chain
    }

    fn twice(&self) -> Self {
        Self {
            transition: self.transition * self.transition,
            input: self.transition * self.input + self.input,
        }
    }
}

/// Derivative or transition of `y`: by `y`, by each entry of `d`, `u` and `w`, and its part that depends on none.
#[derive(Debug, Clone)]
struct Step {
    by_y: Core,
    by_d: Vec<Column>,
    by_u: Vec<Column>,
    by_w: [Column; WRENCH],
    drift: Column,
}

impl Step {
    fn zero(states: usize, inputs: usize) -> Self {
        let zero = Column::zeros();
        let (by_d, by_u, by_w) = (vec![zero; states], vec![zero; inputs], [zero; WRENCH]);
        Self { by_y: Core::zeros(), by_d, by_u, by_w, drift: zero }
    }

    /// Columns after `by_y`.
    fn columns(&mut self) -> impl Iterator<Item = &mut Column> {
        self.by_d.iter_mut().chain(&mut self.by_u).chain(&mut self.by_w).chain([&mut self.drift])
    }

    fn copy_from(&mut self, other: &Self) {
        self.by_y = other.by_y;
        self.by_d.copy_from_slice(&other.by_d);
        self.by_u.copy_from_slice(&other.by_u);
        self.by_w = other.by_w;
        self.drift = other.drift;
    }
}

/// Outputs of one instant: p, v, θ, ω, a, α.
type Outputs = [Vector3<f64>; OUTPUTS / 3];

fn flatten(outputs: &Outputs) -> impl Iterator<Item = f64> {
    outputs.iter().flat_map(|vector| [vector.x, vector.y, vector.z])
}

/// Outputs from `y` and from ω, a and α.
fn join(y: &Column, rates: &Rates) -> Outputs {
    let part = |first: usize| Vector3::new(y[first], y[first + 1], y[first + 2]);
    let rate = |first: usize| Vector3::new(rates[first], rates[first + 1], rates[first + 2]);
    [part(0), part(3), part(6), rate(0), rate(3), rate(6)]
}

/// Effect of the state `(s, ṡ, e)` of a joint, from the columns of `d`.
fn by_joint<const N: usize>(
    columns: &[SVector<f64, N>],
    places: Places,
    joint: usize,
    state: &Vector3<f64>,
) -> SVector<f64, N> {
    let Places { s, sigma, e, .. } = places;
    columns[s + joint] * state[0] + columns[sigma + joint] * state[1] + columns[e + joint] * state[2]
}

/// Effect of a wrench.
fn by_wrench<const N: usize>(columns: &[SVector<f64, N>; WRENCH], wrench: &Vector6<f64>) -> SVector<f64, N> {
    columns.iter().zip(wrench).map(|(column, part)| column * *part).sum()
}

/// Factors of position, velocity and acceleration in each row of the tail: the motion's three, then the attitude's.
type TailRows = [[f64; 3]; TAIL];

fn tail_of(rows: &TailRows, [p, v, theta, omega, a, alpha]: &Outputs) -> [f64; TAIL] {
    std::array::from_fn(|row| {
        let ([by_p, by_v, by_a], axis) = (rows[row], row % 3);
        let [p, v, a] = if row < 3 { [p, v, a] } else { [theta, omega, alpha] };
        by_p * p[axis] + by_v * v[axis] + by_a * a[axis]
    })
}

impl MpcWeights {
    /// Square roots of the weights of the outputs over `duration` \[s\].
    fn rows(&self, duration: f64) -> [[f64; 3]; OUTPUTS / 3] {
        let all = |weight: f64| [weight; 3];
        [
            self.position,
            self.velocity,
            self.attitude,
            all(self.angular_velocity),
            all(self.acceleration),
            all(self.angular_acceleration),
        ]
        .map(|weights| weights.map(|weight| (duration * weight).sqrt()))
    }

    fn tail_rows(&self, decay: f64) -> TailRows {
        std::array::from_fn(|row| {
            let (half, axis) = (row / 3, row % 3);
            let of_position = [self.position, self.attitude][half][axis];
            let whole = if of_position > 0.0 { [decay * decay, 2.0 * decay, 1.0] } else { [0.0, decay, 1.0] };
            whole.map(|factor| factor * self.tail[half].sqrt())
        })
    }
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

/// Where the entries of `d` stand: thrusts, joint positions, velocities, velocity errors, thrust rates.
#[derive(Debug, Clone, Copy)]
struct Places {
    s: usize,
    sigma: usize,
    e: usize,
    rate: usize,
}

/// A limited value at the end of a knot: within its limits or beyond one of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Beyond {
    /// Within its limits.
    No,
    /// Below the least.
    Below,
    /// Above the greatest.
    Above,
}

/// A thrust, a joint position or a distance at the end of a knot.
#[derive(Debug, Clone, Copy)]
struct Limited {
    /// With the inputs, and without any.
    value: f64,
    free: f64,
    range: (f64, f64),
    /// Weight `ρ` of the square of what is beyond the range.
    weight: f64,
    beyond: Beyond,
}

impl Limited {
    fn new(weight: f64) -> Self {
        Self { value: 0.0, free: 0.0, range: (f64::NEG_INFINITY, f64::INFINITY), weight, beyond: Beyond::No }
    }

    fn side(&self, value: f64) -> Beyond {
        match value {
            _ if value < self.range.0 => Beyond::Below,
            _ if value > self.range.1 => Beyond::Above,
            _ => Beyond::No,
        }
    }

    /// How far `value` is beyond the range.
    fn excess(&self, value: f64) -> f64 {
        value - value.max(self.range.0).min(self.range.1)
    }

    /// How far the free value is beyond the limit that the cost contains.
    fn over(&self) -> Option<f64> {
        match self.beyond {
            Beyond::No => None,
            Beyond::Below => Some(self.free - self.range.0),
            Beyond::Above => Some(self.free - self.range.1),
        }
    }
}

/// A value with a soft range: `range.0 ≤ by_input · u ≤ range.1`; the cost of an excess `x` is `½ weight x²`.
#[doc(hidden)]
#[derive(Debug, Clone)]
pub struct SoftRow {
    /// Its derivative by the inputs.
    pub by_input: Vec<f64>,
    /// Its limits.
    pub range: (f64, f64),
    /// Weight of the square of the excess.
    pub weight: f64,
}

/// The prediction and its QP; preallocated. Unknowns: thrust rates by knot, then joint velocities by block.
#[derive(Debug, Clone)]
pub struct Horizon {
    /// The QP in the inputs.
    pub problem: QpProblem,
    /// Distances that the plan keeps.
    pub clearance: Clearance,
    durations: Vec<f64>,
    /// Of each knot: the duration in terms of the first, as a power of two, and its block of joint velocities.
    doublings: Vec<usize>,
    block: Vec<usize>,
    jets: usize,
    free: usize,
    /// `K_D` and `K_P` of the torque law.
    gains: (f64, f64),
    decay: f64,
    models: Vec<JetModel>,
    /// Range of every thrust while its engine works \[N\].
    usual: Vec<(f64, f64)>,
    /// Slopes `α` \[1/s²\] and `β` \[1/s\] of every engine; `None` for ideal jets.
    slopes: Vec<Option<(f64, f64)>>,
    /// Thrust states over each power of the first duration, by jet.
    jet_chains: Vec<Vec<JetChain>>,
    /// Thrust states at the end of a knot by a unit input in an earlier one, by jet.
    jet_reach: Vec<Vec<Vec<Vector2<f64>>>>,
    /// Thrust states at the end of each knot without inputs, by jet.
    free_thrust: Vec<Vec<Vector2<f64>>>,
    /// Joint states over each power of the first duration.
    chains: Vec<Chain>,
    /// Joint states at the end of a knot by a unit command of a block.
    reach: Vec<Vec<Vector3<f64>>>,
    weights: [MpcWeights; 2],
    /// Weights of the posture by joint.
    posture: [Vec<f64>; 2],
    /// Cost of joints and inputs with these weights.
    constant: [DMatrix<f64>; 2],
    /// `A_c`, `A_d`, B, c; the inputs act on `d` alone.
    dynamics: Step,
    /// ω, a and α by `y`, `d`, `u` and `w`, and their constant part.
    rates_by_y: SMatrix<f64, RATES, CORE>,
    rates_by_d: Vec<Rates>,
    rates_by_u: Vec<Rates>,
    rates_by_w: [Rates; WRENCH],
    rates: Rates,
    /// Transitions over each power of the first duration.
    steps: Vec<Step>,
    power: Step,
    /// `y` at the present knot by every unknown.
    sensitivity: Vec<Column>,
    /// Weighted outputs by the unknowns: one column for each row of the cost.
    weighted: DMatrix<f64>,
    residual: DVector<f64>,
    /// Joint states at the end of each knot, and thrusts at present, without inputs.
    free_joint: Vec<Vec<Vector3<f64>>>,
    /// Least distance \[m\].
    least_distance: f64,
    /// Thrusts by knot, then joints by knot, then distances by knot.
    limited: Vec<Limited>,
    /// Their values at the end of a way between two inputs, and the way.
    ends: Vec<f64>,
    way: DVector<f64>,
    /// A distance by the joints' inputs.
    row: Vec<f64>,
    work: DVector<f64>,
    base_h: DMatrix<f64>,
    base_g: DVector<f64>,
}

impl Horizon {
    /// A horizon for the thrusts of `robot` and the joints that the law moves, for the gains `K_D` \[1/s\] and `K_P`
    /// \[1/s²\] of the torque law.
    ///
    /// # Errors
    /// [`BuildError`] for a link that the robot does not have.
    pub fn new(
        config: &MpcConfig,
        gains: (f64, f64),
        robot: &RobotModel,
        models: Vec<JetModel>,
        joints: &[usize],
    ) -> Result<Self, BuildError> {
        let (jets, free) = (robot.jets.len(), joints.len());
        let durations = config.knots.clone();
        let (knots, blocks) = (durations.len(), config.joint_knots.len());
        let counts = config.joint_knots.iter().enumerate();
        let block: Vec<usize> = counts.flat_map(|(block, count)| vec![block; *count]).collect();
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked by the configuration"
        )]
        let doublings: Vec<usize> =
            durations.iter().map(|duration| libm::log2(duration / durations[0]).round() as usize).collect();
        let powers = doublings.last().map_or(1, |last| last + 1);
        let (n, states) = (jets * knots + free * blocks, 2 * jets + 3 * free);
        let mut chains = vec![Chain::new(gains, durations[0])];
        for power in 1..powers {
            chains.push(chains[power - 1].twice());
        }
        let mut reach: Vec<Vec<Vector3<f64>>> = Vec::with_capacity(knots);
        let mut now = vec![Vector3::zeros(); blocks];
        for knot in 0..knots {
            let chain = &chains[doublings[knot]];
            for (to, state) in now.iter_mut().enumerate() {
                let own = if block[knot] == to { chain.input } else { Vector3::zeros() };
                *state = chain.transition * *state + own;
            }
            reach.push(now.clone());
        }
        let rows = OUTPUTS * knots + TAIL;
        let descent = config.descent.as_ref().unwrap_or(&config.weights);
        let weights = [config.weights.clone(), descent.clone()];
        let step = Step::zero(states, jets + free);
        let of_thrusts = std::iter::repeat_n(Limited::new(config.thrust_excess), jets * knots);
        let of_joints = std::iter::repeat_n(Limited::new(config.joint_excess), free * knots);
        let clearance = Clearance::new(config.clearance.as_ref(), robot, free)?;
        let (least_distance, weight) =
            config.clearance.as_ref().map_or((0.0, 0.0), |clearance| (clearance.least, clearance.weight));
        let of_distances = std::iter::repeat_n(Limited::new(weight), clearance.len() * knots);
        let limited: Vec<Limited> = of_thrusts.chain(of_joints).chain(of_distances).collect();
        let mut horizon = Self {
            problem: QpProblem::new(n, 0),
            durations,
            doublings,
            block,
            jets,
            free,
            gains,
            decay: config.decay,
            usual: robot.jets.iter().map(|jet| (jet.thrust_min, jet.thrust_max)).collect(),
            slopes: vec![None; jets],
            jet_chains: vec![vec![JetChain::new(None, 0.0); jets]; powers],
            jet_reach: vec![vec![vec![Vector2::zeros(); jets]; knots]; knots],
            free_thrust: vec![vec![Vector2::zeros(); jets]; knots],
            models,
            chains,
            reach,
            weights,
            posture: config.posture_weights(robot, joints),
            constant: [DMatrix::zeros(n, n), DMatrix::zeros(n, n)],
            dynamics: step.clone(),
            rates_by_y: SMatrix::zeros(),
            rates_by_d: vec![Rates::zeros(); states],
            rates_by_u: vec![Rates::zeros(); jets + free],
            rates_by_w: [Rates::zeros(); WRENCH],
            rates: Rates::zeros(),
            steps: vec![step.clone(); powers],
            power: step,
            sensitivity: vec![Column::zeros(); n],
            weighted: DMatrix::zeros(n, rows),
            residual: DVector::zeros(rows),
            free_joint: vec![vec![Vector3::zeros(); free]; knots],
            ends: vec![0.0; limited.len()],
            limited,
            clearance,
            least_distance,
            row: vec![0.0; free * blocks],
            way: DVector::zeros(n),
            work: DVector::zeros(n),
            base_h: DMatrix::zeros(n, n),
            base_g: DVector::zeros(n),
        };
        horizon.constant = [0, 1].map(|weights| horizon.constant_cost(weights));
        Ok(horizon)
    }

    /// Number of knots.
    #[must_use]
    pub fn knots(&self) -> usize {
        self.durations.len()
    }

    /// Durations of the knots \[s\].
    #[must_use]
    pub fn durations(&self) -> &[f64] {
        &self.durations
    }

    /// Unknown of the input of a thrust in a knot: its rate for ideal jets.
    #[must_use]
    pub fn thrust_input(&self, knot: usize, jet: usize) -> usize {
        knot * self.jets + jet
    }

    /// Unknown of the commanded velocity of a moved joint in a knot.
    #[must_use]
    pub fn joint_velocity(&self, knot: usize, joint: usize) -> usize {
        self.of_block(self.block[knot], joint)
    }

    fn of_block(&self, block: usize, joint: usize) -> usize {
        self.jets * self.knots() + block * self.free + joint
    }

    fn places(&self) -> Places {
        let (jets, free) = (self.jets, self.free);
        Places { s: jets, sigma: jets + free, e: jets + 2 * free, rate: jets + 3 * free }
    }

    /// Second derivatives of the cost of joints and inputs, which do not depend on the state.
    fn constant_cost(&self, weights: usize) -> DMatrix<f64> {
        let (weights, posture) = (&self.weights[weights], &self.posture[weights]);
        let mut h = DMatrix::zeros(self.problem.len(), self.problem.len());
        for (knot, duration) in self.durations.iter().enumerate() {
            for jet in 0..self.jets {
                let unknown = self.thrust_input(knot, jet);
                let of_engine = self.models[jet].engine.map_or(1.0, |_| INPUT_TIME * INPUT_TIME);
                h[(unknown, unknown)] += duration * weights.thrust_rate * of_engine;
            }
            for joint in 0..self.free {
                let unknown = self.joint_velocity(knot, joint);
                h[(unknown, unknown)] += duration * weights.joint_command;
                for (one, a) in self.reach[knot].iter().enumerate() {
                    for (other, b) in self.reach[knot].iter().enumerate() {
                        h[(self.of_block(one, joint), self.of_block(other, joint))] +=
                            duration * (posture[joint] * a[0] * b[0] + weights.joint_velocity * a[1] * b[1]);
                    }
                }
            }
        }
        h
    }

    /// Builds H and g at the state of `terms`, from the wanted positions of the joints and, for the end of each knot, a
    /// target and the change of the air's wrench with the wind \[N, N m\]; `is_descending` chooses the weights.
    pub fn update(
        &mut self,
        model: &Linearised,
        terms: &Terms,
        posture: &DVector<f64>,
        ahead: (&[Target], &[Vector6<f64>]),
        is_descending: bool,
    ) {
        self.write_thrusts(terms);
        self.write_dynamics(model, terms);
        self.write_rates(model, terms);
        self.write_steps();
        let weights = usize::from(is_descending);
        self.write_motion_cost(terms, ahead, weights, model);
        self.write_joint_cost(model, terms, posture, weights);
        self.write_engine_cost(weights);
        self.clearance.update(&terms.kinematics, &model.joints);
        self.limited.iter_mut().for_each(|limited| limited.beyond = Beyond::No);
        self.problem.h.copy_from(&self.base_h);
        self.problem.g.copy_from(&self.base_g);
    }

    /// What each jet does by itself and by its inputs. An engine that does not reach its thrusts keeps the present one.
    fn write_thrusts(&mut self, terms: &Terms) {
        let (jets, knots, measured) = (self.jets, self.knots(), &terms.measurement);
        for jet in 0..jets {
            let engine = self.models[jet].engine.as_ref();
            self.slopes[jet] = engine.map(|engine| {
                let thrust = measured.thrust[jet];
                engine.acceleration_slopes(thrust, 0.0, engine.steady_throttle(thrust))
            });
            self.jet_chains[0][jet] = JetChain::new(self.slopes[jet], self.durations[0]);
            for power in 1..self.jet_chains.len() {
                self.jet_chains[power][jet] = self.jet_chains[power - 1][jet].twice();
            }
            let mut state = self.present(jet, terms);
            for knot in 0..knots {
                let chain = self.jet_chains[self.doublings[knot]][jet];
                state = chain.transition * state;
                self.free_thrust[knot][jet] = state;
                for earlier in 0..knot {
                    self.jet_reach[knot][earlier][jet] =
                        chain.transition * self.jet_reach[knot - 1][earlier][jet];
                }
                self.jet_reach[knot][knot][jet] = chain.input;
            }
        }
    }

    /// Present state of a jet. The rate of an ideal one is its input.
    fn present(&self, jet: usize, terms: &Terms) -> Vector2<f64> {
        let works = self.slopes[jet].is_some() && terms.limits.thrust[jet] == self.usual[jet];
        Vector2::new(0.0, if works { terms.measurement.thrust_rate[jet] } else { 0.0 })
    }

    /// State of a jet at the beginning of a knot without inputs.
    fn free_before(&self, knot: usize, jet: usize, terms: &Terms) -> Vector2<f64> {
        knot.checked_sub(1).map_or_else(|| self.present(jet, terms), |last| self.free_thrust[last][jet])
    }

    /// Least and greatest input of a jet's engine in a knot, from the limits of its throttle along the motion without inputs
    /// (M174); `None` for ideal jets. An engine that does not reach its thrusts has none.
    #[must_use]
    pub fn input_range(&self, knot: usize, jet: usize, terms: &Terms) -> Option<(f64, f64)> {
        let (engine, (by_thrust, by_rate)) = (self.models[jet].engine?, self.slopes[jet]?);
        if terms.limits.thrust[jet] != self.usual[jet] {
            return Some((0.0, 0.0));
        }
        let state = self.free_before(knot, jet, terms);
        let thrust = terms.measurement.thrust[jet] + state[0];
        let (least, greatest) = engine.acceleration_range(thrust, state[1]);
        let free = by_thrust * state[0] + by_rate * state[1];
        Some((least - free, greatest - free))
    }

    /// Thrust rate that an input asks for within `time` \[s; N/s\], from the present one.
    #[must_use]
    pub fn commanded_rate(&self, jet: usize, input: f64, rate: f64, time: f64) -> f64 {
        self.slopes[jet].map_or(input, |(_, by_rate)| rate + time * (input + by_rate * rate))
    }

    /// Adds the cost of the engines' thrust rates.
    fn write_engine_cost(&mut self, weights: usize) {
        let (jets, weight) = (self.jets, self.weights[weights].thrust_rate);
        for jet in (0..jets).filter(|jet| self.slopes[*jet].is_some()) {
            for (knot, duration) in self.durations.iter().enumerate() {
                let (of_rate, reach) = (weight * duration, &self.jet_reach[knot]);
                for (one, of_one) in reach[..=knot].iter().enumerate() {
                    let by_one = of_rate * of_one[jet][1];
                    self.base_g[one * jets + jet] += by_one * self.free_thrust[knot][jet][1];
                    for (other, of_other) in reach[..=knot].iter().enumerate() {
                        self.base_h[(one * jets + jet, other * jets + jet)] += by_one * of_other[jet][1];
                    }
                }
            }
        }
    }

    /// `A_c`, `A_d`, B and c.
    fn write_dynamics(&mut self, model: &Linearised, terms: &Terms) {
        let Places { s, sigma, .. } = self.places();
        let mass = terms.kinematics.mass();
        let state = &terms.measurement.state;
        let omega = state.base_angular_velocity();
        let Step { by_y, by_d, by_w, drift, .. } = &mut self.dynamics;
        by_y.fill(0.0);
        by_d.fill(Column::zeros());
        by_y.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        drift.fixed_rows_mut::<3>(0).copy_from(&(terms.dynamics.momentum.fixed_rows::<3>(0) / mass));
        for (row, first, scale) in [(3, 0, mass.recip()), (9, 3, 1.0)] {
            for (column, by) in [(3, &model.rate_v), (6, &model.rate_theta), (9, &model.rate_k)] {
                by_y.fixed_view_mut::<3, 3>(row, column).copy_from(&(by.fixed_rows::<3>(first) * scale));
            }
            for (column, by) in [(0, &model.rate_t), (s, &model.rate_s), (sigma, &model.rate_sigma)] {
                for (to, from) in by_d[column..].iter_mut().zip(by.column_iter()) {
                    to.fixed_rows_mut::<3>(row).copy_from(&(from.fixed_rows::<3>(first) * scale));
                }
            }
            for axis in 0..3 {
                by_w[first + axis][row + axis] = scale;
            }
            let rate = terms.momentum.rate_estimate.fixed_rows::<3>(first) * scale;
            drift.fixed_rows_mut::<3>(row).copy_from(&rate);
        }
        // θ̇ = J_l⁻¹(θ) ω, with J_l⁻¹ = 1 − S(θ)/2 + …
        by_y.fixed_view_mut::<3, 3>(6, 6).copy_from(&(model.omega_theta + skew(&omega) * 0.5));
        by_y.fixed_view_mut::<3, 3>(6, 9).copy_from(&model.omega_k);
        for (column, by) in [(s, &model.omega_s), (sigma, &model.omega_sigma)] {
            for (to, from) in by_d[column..].iter_mut().zip(by.column_iter()) {
                to.fixed_rows_mut::<3>(6).copy_from(&from);
            }
        }
        drift.fixed_rows_mut::<3>(6).copy_from(&omega);
        // d holds velocities, of which the present ones are part of the present rates.
        for (place, joint) in model.joints.iter().enumerate() {
            *drift -= by_d[sigma + place] * state.joint_velocity()[*joint];
        }
    }

    /// ω, a and α: `α = ω_θ θ̇ + ω_k k̇ + ω_s ṡ + ω_ṡ s̈`.
    fn write_rates(&mut self, model: &Linearised, terms: &Terms) {
        let Places { sigma, e, .. } = self.places();
        let (kd, kp) = self.gains;
        let (theta, k) = (model.omega_theta, model.omega_k);
        let half = skew(&terms.measurement.state.base_angular_velocity()) * 0.5;
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
            *to = of(from);
        }
        self.rates_by_w = self.dynamics.by_w.each_ref().map(of);
        self.rates = of(&self.dynamics.drift);
        let joints = model.omega_s.column_iter().zip(model.omega_sigma.column_iter()).enumerate();
        for (joint, (by_s, by_sigma)) in joints {
            let mut alpha = self.rates_by_d[sigma + joint].fixed_rows_mut::<3>(6);
            alpha += by_s - by_sigma * kd;
            let mut alpha = self.rates_by_d[e + joint].fixed_rows_mut::<3>(6);
            alpha -= by_sigma * kp;
            self.rates_by_u[self.jets + joint].fixed_rows_mut::<3>(6).copy_from(&(by_sigma * kd));
        }
    }

    /// Transitions: the Taylor series of the shortest duration, then squares.
    fn write_steps(&mut self) {
        let Places { s, sigma, e, rate } = self.places();
        let (kd, kp) = self.gains;
        let Self { steps, power, dynamics, jets, free, chains, jet_chains, slopes, durations, .. } = self;
        let (jets, free) = (*jets, *free);
        // Rows of y of the powers of the whole matrix: X ← X A h / order.
        let first = &mut steps[0];
        power.by_y = Core::identity();
        power.columns().for_each(|column| column.fill(0.0));
        first.copy_from(power);
        for order in 1..=TERMS {
            let scale = durations[0] / f64::from(order);
            // Inputs first, then d, from the columns of d and y of the power before.
            for (jet, slopes) in slopes.iter().enumerate() {
                let (by_thrust, by_rate) = (power.by_d[jet], power.by_d[rate + jet]);
                let through_y = times(&power.by_y, &dynamics.by_d[jet]);
                if let Some((alpha, beta)) = *slopes {
                    power.by_u[jet] = by_rate * scale;
                    power.by_d[jet] = (through_y + by_rate * alpha) * scale;
                    power.by_d[rate + jet] = (by_thrust + by_rate * beta) * scale;
                } else {
                    power.by_u[jet] = by_thrust * scale;
                    power.by_d[jet] = through_y * scale;
                }
            }
            for joint in 0..free {
                let (by_s, by_sigma, by_e) =
                    (power.by_d[s + joint], power.by_d[sigma + joint], power.by_d[e + joint]);
                power.by_u[jets + joint] = (by_sigma * kd - by_e) * scale;
                power.by_d[s + joint] = times(&power.by_y, &dynamics.by_d[s + joint]) * scale;
                let through_y = times(&power.by_y, &dynamics.by_d[sigma + joint]);
                power.by_d[sigma + joint] = (through_y + by_s - by_sigma * kd + by_e) * scale;
                power.by_d[e + joint] = by_sigma * (-kp * scale);
            }
            power.by_w = dynamics.by_w.each_ref().map(|column| times(&power.by_y, column) * scale);
            power.drift = times(&power.by_y, &dynamics.drift) * scale;
            power.by_y = times_core(&power.by_y, &dynamics.by_y) * scale;
            first.by_y += power.by_y;
            for (sum, term) in first.columns().zip(power.columns()) {
                *sum += *term;
            }
        }
        for doubling in 1..steps.len() {
            let (before, after) = steps.split_at_mut(doubling);
            let (half, whole) = (&before[doubling - 1], &mut after[0]);
            let chain = &chains[doubling - 1];
            whole.by_y = times_core(&half.by_y, &half.by_y);
            whole.by_w = half.by_w.each_ref().map(|column| times(&half.by_y, column) + column);
            whole.drift = times(&half.by_y, &half.drift) + half.drift;
            for (jet, JetChain { transition, input }) in jet_chains[doubling - 1].iter().enumerate() {
                let (by_thrust, by_rate) = (half.by_d[jet], half.by_d[rate + jet]);
                let along = |thrust: f64, rate: f64| by_thrust * thrust + by_rate * rate;
                whole.by_d[jet] =
                    times(&half.by_y, &by_thrust) + along(transition[(0, 0)], transition[(1, 0)]);
                whole.by_d[rate + jet] =
                    times(&half.by_y, &by_rate) + along(transition[(0, 1)], transition[(1, 1)]);
                whole.by_u[jet] =
                    times(&half.by_y, &half.by_u[jet]) + along(input[0], input[1]) + half.by_u[jet];
            }
            for joint in 0..free {
                let columns = [s, sigma, e].map(|first| half.by_d[first + joint]);
                let along = |factors: &Vector3<f64>| {
                    columns[0] * factors[0] + columns[1] * factors[1] + columns[2] * factors[2]
                };
                for (state, first) in [s, sigma, e].into_iter().enumerate() {
                    let through = along(&chain.transition.column(state).into());
                    whole.by_d[first + joint] = times(&half.by_y, &columns[state]) + through;
                }
                let input = jets + joint;
                whole.by_u[input] =
                    times(&half.by_y, &half.by_u[input]) + along(&chain.input) + half.by_u[input];
            }
        }
    }

    /// The cost of the outputs along the horizon: rows of `weighted` and `residual`, and from them H and g.
    fn write_motion_cost(
        &mut self,
        terms: &Terms,
        (targets, wrenches): (&[Target], &[Vector6<f64>]),
        weights: usize,
        model: &Linearised,
    ) {
        self.sensitivity.fill(Column::zeros());
        self.weighted.fill(0.0);
        let velocity: Vector3<f64> = self.dynamics.drift.fixed_rows::<3>(0).into();
        let present = [terms.kinematics.com, velocity];
        let (mut y, mut before) = (Column::zeros(), Vector6::zeros());
        for (knot, (target, wrench)) in targets.iter().zip(wrenches).enumerate() {
            // Within the knot the mean of both ends: it needs no wind but that of the ends, where ω, a and α do.
            y = self.move_freely(knot, (&y, &((before + wrench) * 0.5)), model, terms);
            before = *wrench;
            self.move_by_inputs(knot);
            let [p, v, theta, omega, a, alpha] = self.free_outputs(knot, (&y, wrench), present);
            let [p_d, v_d, theta_d, omega_d, a_d, alpha_d] = target.outputs();
            let errors = [p - p_d, v - v_d, theta - theta_d, omega - omega_d, a - a_d, alpha - alpha_d];
            self.write_rows(knot, weights, &errors);
        }
        let n = self.problem.len();
        linalg::times_transpose(self.weighted.as_slice(), n, self.base_h.as_mut_slice());
        self.base_h += &self.constant[weights];
        self.base_g.fill(0.0);
        let (weighted, residual) = (self.weighted.as_slice(), self.residual.as_slice());
        linalg::add_mat_vec(self.base_g.as_mut_slice(), weighted, n, residual);
    }

    /// Joints and `y` at the end of a knot without inputs, from `y` at its beginning and the change of the wrench. The
    /// thrusts stay.
    fn move_freely(
        &mut self,
        knot: usize,
        (y, wrench): (&Column, &Vector6<f64>),
        model: &Linearised,
        terms: &Terms,
    ) -> Column {
        let (places, power) = (self.places(), self.doublings[knot]);
        let step = &self.steps[power];
        let mut next = times(&step.by_y, y) + by_wrench(&step.by_w, wrench) + step.drift;
        for (place, joint) in model.joints.iter().enumerate() {
            let before = match knot {
                0 => Vector3::new(0.0, terms.measurement.state.joint_velocity()[*joint], 0.0),
                _ => self.free_joint[knot - 1][place],
            };
            next += by_joint(&step.by_d, places, place, &before);
            self.free_joint[knot][place] = self.chains[power].transition * before;
        }
        for jet in (0..self.jets).filter(|jet| self.slopes[*jet].is_some()) {
            let before = self.free_before(knot, jet, terms);
            next += step.by_d[jet] * before[0] + step.by_d[places.rate + jet] * before[1];
        }
        next
    }

    /// `y` at the end of a knot by each unknown that has acted so far.
    fn move_by_inputs(&mut self, knot: usize) {
        let (jets, free, places, block) = (self.jets, self.free, self.places(), self.block[knot]);
        let step = &self.steps[self.doublings[knot]];
        let (of_thrusts, of_joints) = self.sensitivity.split_at_mut(jets * self.durations.len());
        for (unknown, column) in of_thrusts.iter_mut().take(jets * (knot + 1)).enumerate() {
            let (earlier, jet) = (unknown / jets, unknown % jets);
            *column = if earlier == knot {
                step.by_u[jet]
            } else {
                let before = &self.jet_reach[knot - 1][earlier][jet];
                let by_state = step.by_d[jet] * before[0] + step.by_d[places.rate + jet] * before[1];
                times(&step.by_y, column) + by_state
            };
        }
        for (index, column) in of_joints.iter_mut().take(free * (block + 1)).enumerate() {
            let (earlier, joint) = (index / free, index % free);
            let before = if knot == 0 { Vector3::zeros() } else { self.reach[knot - 1][earlier] };
            *column = times(&step.by_y, column) + by_joint(&step.by_d, places, joint, &before);
            if earlier == block {
                *column += step.by_u[jets + joint];
            }
        }
    }

    /// Outputs at the end of a knot without inputs, from `y` and the change of the wrench there, and from the centre of
    /// mass and its velocity at present.
    fn free_outputs(
        &self,
        knot: usize,
        (y, wrench): (&Column, &Vector6<f64>),
        [position, velocity]: [Vector3<f64>; 2],
    ) -> Outputs {
        let mut rates = self.rates + self.rates_by_y * y + by_wrench(&self.rates_by_w, wrench);
        for (place, now) in self.free_joint[knot].iter().enumerate() {
            rates += by_joint(&self.rates_by_d, self.places(), place, now);
        }
        for (by_thrust, now) in self.rates_by_d.iter().zip(&self.free_thrust[knot]) {
            rates += by_thrust * now[0];
        }
        let [p, v, theta, omega, a, alpha] = join(y, &rates);
        [position + p, velocity + v, theta, omega, a, alpha]
    }

    /// Outputs at the end of a knot by an unknown.
    fn outputs_by(&self, knot: usize, unknown: usize) -> Outputs {
        let (jets, free) = (self.jets, self.free);
        let column = &self.sensitivity[unknown];
        let mut rates = self.rates_by_y * column;
        if let Some(index) = unknown.checked_sub(jets * self.knots()) {
            let (earlier, joint) = (index / free, index % free);
            rates += by_joint(&self.rates_by_d, self.places(), joint, &self.reach[knot][earlier]);
            if earlier == self.block[knot] {
                rates += self.rates_by_u[jets + joint];
            }
        } else {
            rates +=
                self.rates_by_d[unknown % jets] * self.jet_reach[knot][unknown / jets][unknown % jets][0];
        }
        join(column, &rates)
    }

    /// The rows of a knot, and of the tail after the last one.
    fn write_rows(&mut self, knot: usize, weights: usize, errors: &Outputs) {
        let (n, first, of_tail) = (self.problem.len(), OUTPUTS * knot, OUTPUTS * self.knots());
        let roots = self.weights[weights].rows(self.durations[knot]);
        let tail = (knot + 1 == self.knots()).then(|| self.weights[weights].tail_rows(self.decay));
        for (row, (error, root)) in flatten(errors).zip(roots.as_flattened()).enumerate() {
            self.residual[first + row] = root * error;
        }
        if let Some(tail) = &tail {
            self.residual.as_mut_slice()[of_tail..].copy_from_slice(&tail_of(tail, errors));
        }
        let of_thrusts = 0..self.jets * (knot + 1);
        let of_joints = self.of_block(0, 0)..self.of_block(self.block[knot] + 1, 0);
        for unknown in of_thrusts.chain(of_joints) {
            let outputs = self.outputs_by(knot, unknown);
            let weighted = self.weighted.as_mut_slice();
            for (row, (output, root)) in flatten(&outputs).zip(roots.as_flattened()).enumerate() {
                weighted[unknown + n * (first + row)] = root * output;
            }
            if let Some(tail) = &tail {
                for (row, value) in tail_of(tail, &outputs).into_iter().enumerate() {
                    weighted[unknown + n * (of_tail + row)] = value;
                }
            }
        }
    }

    /// Adds the gradient of the cost of the joints' positions and velocities.
    fn write_joint_cost(
        &mut self,
        model: &Linearised,
        terms: &Terms,
        posture: &DVector<f64>,
        weights: usize,
    ) {
        let (squares, of_posture) = (&self.weights[weights], &self.posture[weights]);
        let (jets, free, knots) = (self.jets, self.free, self.durations.len());
        for (place, joint) in model.joints.iter().enumerate() {
            let away = terms.measurement.state.joint_position[*joint] - posture[*joint];
            for knot in 0..knots {
                let now = &self.free_joint[knot][place];
                let duration = self.durations[knot];
                for (block, reach) in self.reach[knot].iter().enumerate() {
                    self.base_g[jets * knots + block * free + place] += duration
                        * (of_posture[place] * (away + now[0]) * reach[0]
                            + squares.joint_velocity * now[1] * reach[1]);
                }
            }
        }
    }

    /// Sets which thrusts, joints and distances the inputs `u` bring beyond their limits, and H and g with them; returns whether
    /// that changes anything. The cost of a value `x` beyond its limit `b` is `½ ρ (x − b)²`.
    pub fn update_excess(
        &mut self,
        model: &Linearised,
        terms: &Terms,
        joint_limits: &[(f64, f64)],
        u: &[f64],
    ) -> bool {
        self.read_limited(model, terms, joint_limits, u);
        let mut is_changed = false;
        for limited in &mut self.limited {
            let now = limited.side(limited.value);
            is_changed |= std::mem::replace(&mut limited.beyond, now) != now;
        }
        if is_changed {
            self.write_excess();
        }
        is_changed
    }

    /// Values and limits at the end of the knots, for the inputs `u`.
    fn read_limited(&mut self, model: &Linearised, terms: &Terms, joint_limits: &[(f64, f64)], u: &[f64]) {
        let (jets, free, knots) = (self.jets, self.free, self.knots());
        for jet in 0..jets {
            let mut by_inputs = Vector2::zeros();
            for knot in 0..knots {
                let JetChain { transition, input } = &self.jet_chains[self.doublings[knot]][jet];
                by_inputs = transition * by_inputs + input * u[knot * jets + jet];
                let free = terms.measurement.thrust[jet] + self.free_thrust[knot][jet][0];
                let limited = &mut self.limited[knot * jets + jet];
                (limited.value, limited.free) = (free + by_inputs[0], free);
                limited.range = terms.limits.thrust[jet];
            }
        }
        for (place, joint) in model.joints.iter().enumerate() {
            let now = terms.measurement.state.joint_position[*joint];
            for knot in 0..knots {
                let free_value = now + self.free_joint[knot][place][0];
                let by_inputs: f64 = (self.reach[knot].iter().enumerate())
                    .map(|(block, reach)| reach[0] * u[self.of_block(block, place)])
                    .sum();
                let limited = &mut self.limited[jets * knots + knot * free + place];
                (limited.value, limited.free) = (free_value + by_inputs, free_value);
                limited.range = joint_limits[*joint];
            }
        }
        let (others, distances) = self.limited.split_at_mut((jets + free) * knots);
        for (index, limited) in distances.iter_mut().enumerate() {
            let (knot, pair) = (index / self.clearance.len(), index % self.clearance.len());
            let now = self.clearance.distance[pair];
            (limited.value, limited.free) = (now, now);
            for (place, joint) in model.joints.iter().enumerate() {
                let by = self.clearance.by_joint[(place, pair)];
                let from = terms.measurement.state.joint_position[*joint];
                let joint = &others[jets * knots + knot * free + place];
                limited.value += by * (joint.value - from);
                limited.free += by * (joint.free - from);
            }
            limited.range = (self.least_distance, f64::INFINITY);
        }
    }

    /// H and g without excesses, and the values that may exceed their limits as rows in the inputs. For benchmarks;
    /// allocates.
    #[doc(hidden)]
    pub fn soft_problem(
        &mut self,
        model: &Linearised,
        terms: &Terms,
        joint_limits: &[(f64, f64)],
    ) -> (&DMatrix<f64>, &DVector<f64>, Vec<SoftRow>) {
        let n = self.problem.len();
        let mut input = vec![0.0; n];
        self.read_limited(model, terms, joint_limits, &input);
        let row = |Limited { free, range, weight, .. }: &Limited| SoftRow {
            by_input: vec![0.0; n],
            range: (range.0 - free, range.1 - free),
            weight: *weight,
        };
        let mut rows: Vec<SoftRow> = self.limited.iter().map(row).collect();
        for unknown in 0..n {
            input[unknown] = 1.0;
            self.read_limited(model, terms, joint_limits, &input);
            input[unknown] = 0.0;
            for (row, limited) in rows.iter_mut().zip(&self.limited) {
                row.by_input[unknown] = limited.value - limited.free;
            }
        }
        (&self.base_h, &self.base_g, rows)
    }

    /// Share `t` of the way from the inputs `from` to `to` at which the cost with all excesses is least. The cost is
    /// convex and piecewise quadratic: the zero of its derivative is found by bisection.
    pub fn least_on_way(
        &mut self,
        model: &Linearised,
        terms: &Terms,
        joint_limits: &[(f64, f64)],
        (from, to): (&[f64], &[f64]),
    ) -> f64 {
        let n = self.problem.len();
        for (way, (from, to)) in self.way.iter_mut().zip(from.iter().zip(to)) {
            *way = to - from;
        }
        self.read_limited(model, terms, joint_limits, to);
        for (end, limited) in self.ends.iter_mut().zip(&self.limited) {
            *end = limited.value;
        }
        self.read_limited(model, terms, joint_limits, from);
        let mut gradient = |x: &[f64]| {
            self.work.fill(0.0);
            linalg::add_mat_vec(self.work.as_mut_slice(), self.base_h.as_slice(), n, x);
            linalg::dot(self.work.as_slice(), self.way.as_slice())
        };
        let slope = gradient(from);
        let curvature = gradient(self.way.as_slice());
        let slope = slope + linalg::dot(self.base_g.as_slice(), self.way.as_slice());
        let derivative = |t: f64| {
            let of_excess = self.limited.iter().zip(&self.ends).map(|(limited, end)| {
                let step = end - limited.value;
                limited.weight * limited.excess(limited.value + t * step) * step
            });
            slope + t * curvature + of_excess.sum::<f64>()
        };
        if derivative(1.0) <= 0.0 {
            return 1.0;
        }
        let (mut least, mut greatest) = (0.0, 1.0);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (least + greatest);
            if derivative(middle) > 0.0 {
                greatest = middle;
            } else {
                least = middle;
            }
        }
        greatest
    }

    /// H and g with the values that are beyond their limits.
    fn write_excess(&mut self) {
        let (jets, free, knots) = (self.jets, self.free, self.knots());
        self.problem.h.copy_from(&self.base_h);
        self.problem.g.copy_from(&self.base_g);
        let QpProblem { h, g, .. } = &mut self.problem;
        let (thrusts, others) = self.limited.split_at(jets * knots);
        let (joints, distances) = others.split_at(free * knots);
        for (index, limited) in thrusts.iter().enumerate() {
            let Some(over) = limited.over() else { continue };
            let (knot, jet) = (index / jets, index % jets);
            for one in 0..=knot {
                let a = limited.weight * self.jet_reach[knot][one][jet][0];
                g[one * jets + jet] += a * over;
                for other in 0..=knot {
                    h[(one * jets + jet, other * jets + jet)] += a * self.jet_reach[knot][other][jet][0];
                }
            }
        }
        for (index, limited) in joints.iter().enumerate() {
            let Some(over) = limited.over() else { continue };
            let (knot, first) = (index / free, jets * knots + index % free);
            for (one, by_one) in self.reach[knot].iter().enumerate() {
                let a = limited.weight * by_one[0];
                g[first + one * free] += a * over;
                for (other, by_other) in self.reach[knot].iter().enumerate() {
                    h[(first + one * free, first + other * free)] += a * by_other[0];
                }
            }
        }
        for (index, limited) in distances.iter().enumerate() {
            let Some(over) = limited.over() else { continue };
            let (knot, pair) = (index / self.clearance.len(), index % self.clearance.len());
            let (first, reached) = (jets * knots, free * (self.block[knot] + 1));
            let row = &mut self.row[..reached];
            for (index, value) in row.iter_mut().enumerate() {
                *value = self.reach[knot][index / free][0] * self.clearance.by_joint[(index % free, pair)];
            }
            for (one, by_one) in row.iter().enumerate() {
                let a = limited.weight * by_one;
                g[first + one] += a * over;
                for (other, by_other) in row.iter().enumerate() {
                    h[(first + one, first + other)] += a * by_other;
                }
            }
        }
    }
}
