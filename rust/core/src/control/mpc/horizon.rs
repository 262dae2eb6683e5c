//! The QP in the inputs over the horizon.
//!
//! H and g collect the squares of the errors of what the prediction has at the end of every knot, of the states of jets and
//! joints and of the inputs, and of what is beyond its limits. Equations M123, M124 and M126 of `docs/model`.

use super::clearance::{self, Clearance};
use super::config::{DECAY, JOINT_EXCESS, MpcConfig, MpcWeights};
use super::model::Linearised;
use super::prediction::{OUTPUTS, Outputs, Prediction};
use crate::control::terms::Present;
use crate::error::BuildError;
use crate::jets::JetModel;
use crate::linalg;
use crate::qp::QpProblem;
use crate::robot::RobotModel;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};

/// Rows of the tail.
const TAIL: usize = 6;
/// Time that makes the input of an engine \[N/s²\] comparable with a thrust rate \[s\].
const INPUT_TIME: f64 = 0.03;
/// Steps of the bisection for the least cost on a way.
const BISECTIONS: u32 = 40;

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

fn flatten(outputs: &Outputs) -> impl Iterator<Item = f64> {
    outputs.iter().flat_map(|vector| [vector.x, vector.y, vector.z])
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

    fn tail_rows(&self) -> TailRows {
        std::array::from_fn(|row| {
            let (half, axis) = (row / 3, row % 3);
            let of_position = [self.position, self.attitude][half][axis];
            let whole = if of_position > 0.0 { [DECAY * DECAY, 2.0 * DECAY, 1.0] } else { [0.0, DECAY, 1.0] };
            whole.map(|factor| factor * self.tail[half].sqrt())
        })
    }
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
    /// The motion at the end of every knot.
    pub prediction: Prediction,
    weights: [MpcWeights; 2],
    /// Weights of the squares of each chain's first two states and of its input.
    squares: [Vec<[f64; 3]>; 2],
    /// Cost of inputs and joints with these weights, which does not depend on the state.
    constant: [DMatrix<f64>; 2],
    /// Weighted outputs by the unknowns: one column for each row of the cost.
    weighted: DMatrix<f64>,
    residual: DVector<f64>,
    /// Weight of a lesser one \[1/m²\], while all engines work and in the descent.
    distance_weight: [f64; 2],
    /// Thrusts and joint positions by knot, then distances by knot.
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
        let prediction = Prediction::new(config, gains, robot, models, joints.len());
        let (jets, knots, n) = (prediction.jets, prediction.knots(), prediction.unknowns());
        let rows = OUTPUTS * knots + TAIL;
        let descent = config.descent.as_ref().unwrap_or(&config.weights);
        let weights = [config.weights.clone(), descent.clone()];
        let posture = config.posture_weights(robot, joints);
        let squares: [Vec<_>; 2] = [0, 1].map(|choice: usize| {
            let (weights, posture): (&MpcWeights, &Vec<f64>) = (&weights[choice], &posture[choice]);
            let rate = weights.thrust_rate;
            let of_engine = [0.0, rate, rate * (INPUT_TIME * INPUT_TIME)];
            let of_jet = |jet| if prediction.has_engine(jet) { of_engine } else { [0.0, 0.0, rate] };
            let of_joint = |posture: &f64| [*posture, weights.joint_velocity, weights.joint_command];
            (0..jets).map(of_jet).chain(posture.iter().map(of_joint)).collect()
        });
        let constant = [0, 1].map(|choice: usize| constant_cost(&prediction, &squares[choice]));
        let of_jets = std::iter::repeat_n(config.thrust_excess, jets);
        let of_chains = of_jets.chain(std::iter::repeat_n(JOINT_EXCESS, joints.len()));
        let clearance = Clearance::new(config.clearance.as_ref(), robot, joints.len())?;
        let distance_weight =
            weights.each_ref().map(|weights| weights.clearance.unwrap_or(clearance::WEIGHT));
        let of_distances = std::iter::repeat_n(clearance::WEIGHT, clearance.len() * knots);
        let of_chains = (0..knots).flat_map(|_| of_chains.clone());
        let limited: Vec<Limited> = of_chains.chain(of_distances).map(Limited::new).collect();
        Ok(Self {
            problem: QpProblem::new(n, 0),
            weights,
            squares,
            constant,
            weighted: DMatrix::zeros(n, rows),
            residual: DVector::zeros(rows),
            ends: vec![0.0; limited.len()],
            limited,
            clearance,
            distance_weight,
            row: vec![0.0; n - jets * knots],
            way: DVector::zeros(n),
            work: DVector::zeros(n),
            base_h: DMatrix::zeros(n, n),
            base_g: DVector::zeros(n),
            prediction,
        })
    }

    /// Number of knots.
    #[must_use]
    pub fn knots(&self) -> usize {
        self.prediction.knots()
    }

    /// Durations of the knots \[s\].
    #[must_use]
    pub fn durations(&self) -> &[f64] {
        &self.prediction.durations
    }

    /// Unknown of the input of a thrust in a knot: its rate for ideal jets.
    #[must_use]
    pub fn thrust_input(&self, knot: usize, jet: usize) -> usize {
        self.prediction.unknown(jet, knot)
    }

    /// Unknown of the commanded velocity of a moved joint in a knot.
    #[must_use]
    pub fn joint_velocity(&self, knot: usize, joint: usize) -> usize {
        let chain = self.prediction.jets + joint;
        self.prediction.unknown(chain, self.prediction.answers(chain).block[knot])
    }

    /// Builds H and g at the present state, from the wanted positions of the joints and, for the end of each knot, a
    /// target and the change of the air's wrench with the wind \[N, N m\]; `is_descending` chooses the weights.
    pub fn update(
        &mut self,
        model: &Linearised,
        now: Present,
        posture: &DVector<f64>,
        ahead: (&[Target], &[Vector6<f64>]),
        is_descending: bool,
    ) {
        let weights = usize::from(is_descending);
        self.prediction.update(model, now);
        self.write_motion_cost(now, ahead, weights);
        self.add_cost_of_chains(model, now, posture, weights);
        self.clearance.update(&now.terms.kinematics, &model.joints);
        self.limited.iter_mut().for_each(|limited| limited.beyond = Beyond::No);
        let distances = self.clearance.len() * self.knots();
        for distance in self.limited.iter_mut().rev().take(distances) {
            distance.weight = self.distance_weight[weights];
        }
        self.problem.h.copy_from(&self.base_h);
        self.problem.g.copy_from(&self.base_g);
    }

    /// The cost of the outputs along the horizon: rows of `weighted` and `residual`, and from them H and g.
    fn write_motion_cost(
        &mut self,
        now: Present,
        (targets, wrenches): (&[Target], &[Vector6<f64>]),
        weights: usize,
    ) {
        self.weighted.fill(0.0);
        for (knot, (target, wrench)) in targets.iter().zip(wrenches).enumerate() {
            self.prediction.advance(knot, wrench);
            let mut errors = self.prediction.free_outputs(knot, &now.terms.kinematics.com);
            for (error, target) in errors.iter_mut().zip(target.outputs()) {
                *error -= target;
            }
            self.write_rows(knot, weights, &errors);
        }
        let n = self.problem.len();
        linalg::times_transpose(self.weighted.as_slice(), n, self.base_h.as_mut_slice());
        self.base_h += &self.constant[weights];
        self.base_g.fill(0.0);
        let (weighted, residual) = (self.weighted.as_slice(), self.residual.as_slice());
        linalg::add_mat_vec(self.base_g.as_mut_slice(), weighted, n, residual);
    }

    /// The rows of a knot, and of the tail after the last one.
    fn write_rows(&mut self, knot: usize, weights: usize, errors: &Outputs) {
        let Self { prediction, weighted, residual, .. } = self;
        let (n, first, of_tail) = (prediction.unknowns(), OUTPUTS * knot, OUTPUTS * prediction.knots());
        let roots = self.weights[weights].rows(prediction.durations[knot]);
        let tail = (knot + 1 == prediction.knots()).then(|| self.weights[weights].tail_rows());
        for (row, (error, root)) in flatten(errors).zip(roots.as_flattened()).enumerate() {
            residual[first + row] = root * error;
        }
        if let Some(tail) = &tail {
            residual.as_mut_slice()[of_tail..].copy_from_slice(&tail_of(tail, errors));
        }
        for (chain, block, unknown) in prediction.acting(knot) {
            let outputs = prediction.outputs_by(knot, (chain, block));
            let weighted = weighted.as_mut_slice();
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

    /// Adds the cost of the states of engines and joints, as far as `constant` lacks it.
    fn add_cost_of_chains(
        &mut self,
        model: &Linearised,
        now: Present,
        posture: &DVector<f64>,
        weights: usize,
    ) {
        let Self { prediction, base_h, base_g, .. } = self;
        for (chain, squares) in self.squares[weights].iter().enumerate() {
            let away = match chain.checked_sub(prediction.jets) {
                None if !prediction.has_engine(chain) => continue,
                None => {
                    add_squares(prediction, chain, *squares, base_h);
                    0.0
                }
                Some(place) => {
                    let joint = model.joints[place];
                    now.estimate.robot.state.joint_position[joint] - posture[joint]
                }
            };
            let [of_first, of_second, _] = squares;
            let answers = prediction.answers(chain);
            for (knot, (duration, reach)) in prediction.durations.iter().zip(&answers.reach).enumerate() {
                let now = &prediction.free[knot][chain];
                for (block, reach) in reach.iter().enumerate() {
                    base_g[prediction.unknown(chain, block)] +=
                        duration * (of_first * (away + now[0]) * reach[0] + of_second * now[1] * reach[1]);
                }
            }
        }
    }

    /// Sets which thrusts, joints and distances the inputs `u` bring beyond their limits, and H and g with them; returns whether
    /// that changes anything. The cost of a value `x` beyond its limit `b` is `½ ρ (x − b)²`.
    pub fn update_excess(
        &mut self,
        model: &Linearised,
        now: Present,
        joint_limits: &[(f64, f64)],
        u: &[f64],
    ) -> bool {
        self.read_limited(model, now, joint_limits, u);
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
    fn read_limited(&mut self, model: &Linearised, now: Present, joint_limits: &[(f64, f64)], u: &[f64]) {
        let Self { prediction, limited, clearance, .. } = self;
        let (jets, chains) = (prediction.jets, prediction.jets + prediction.joints);
        let (of_chains, distances) = limited.split_at_mut(chains * prediction.knots());
        let position = &now.estimate.robot.state.joint_position;
        for (index, limited) in of_chains.iter_mut().enumerate() {
            let (knot, chain) = (index / chains, index % chains);
            let (now, range) = match chain.checked_sub(jets).map(|place| model.joints[place]) {
                None => (now.estimate.robot.thrust[chain], now.terms.limits.thrust[chain]),
                Some(joint) => (position[joint], joint_limits[joint]),
            };
            let answers = prediction.answers(chain);
            let reach = answers.reach[knot][..=answers.block[knot]].iter().enumerate();
            let by_inputs: f64 =
                reach.map(|(block, reach)| reach[0] * u[prediction.unknown(chain, block)]).sum();
            let free = now + prediction.free[knot][chain][0];
            (limited.value, limited.free, limited.range) = (free + by_inputs, free, range);
        }
        for (index, limited) in distances.iter_mut().enumerate() {
            let (knot, pair) = (index / clearance.len(), index % clearance.len());
            let now = clearance.distance[pair];
            (limited.value, limited.free) = (now, now);
            let of_joints = &of_chains[knot * chains + jets..];
            for (place, (joint, of_joint)) in model.joints.iter().zip(of_joints).enumerate() {
                let by = clearance.by_joint[(place, pair)];
                limited.value += by * (of_joint.value - position[*joint]);
                limited.free += by * (of_joint.free - position[*joint]);
            }
            limited.range = (clearance::LEAST, f64::INFINITY);
        }
    }

    /// H and g without excesses, and the values that may exceed their limits as rows in the inputs. For benchmarks;
    /// allocates.
    #[doc(hidden)]
    pub fn soft_problem(
        &mut self,
        model: &Linearised,
        now: Present,
        joint_limits: &[(f64, f64)],
    ) -> (&DMatrix<f64>, &DVector<f64>, Vec<SoftRow>) {
        let n = self.problem.len();
        let mut input = vec![0.0; n];
        self.read_limited(model, now, joint_limits, &input);
        let row = |Limited { free, range, weight, .. }: &Limited| SoftRow {
            by_input: vec![0.0; n],
            range: (range.0 - free, range.1 - free),
            weight: *weight,
        };
        let mut rows: Vec<SoftRow> = self.limited.iter().map(row).collect();
        for unknown in 0..n {
            input[unknown] = 1.0;
            self.read_limited(model, now, joint_limits, &input);
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
        now: Present,
        joint_limits: &[(f64, f64)],
        (from, to): (&[f64], &[f64]),
    ) -> f64 {
        let n = self.problem.len();
        for (way, (from, to)) in self.way.iter_mut().zip(from.iter().zip(to)) {
            *way = to - from;
        }
        self.read_limited(model, now, joint_limits, to);
        for (end, limited) in self.ends.iter_mut().zip(&self.limited) {
            *end = limited.value;
        }
        self.read_limited(model, now, joint_limits, from);
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
        self.problem.h.copy_from(&self.base_h);
        self.problem.g.copy_from(&self.base_g);
        let QpProblem { h, g, .. } = &mut self.problem;
        let Self { prediction, limited, clearance, row, .. } = self;
        let (jets, chains) = (prediction.jets, prediction.jets + prediction.joints);
        let (of_chains, distances) = limited.split_at(chains * prediction.knots());
        for (index, limited) in of_chains.iter().enumerate() {
            let Some(over) = limited.over() else { continue };
            let (knot, chain) = (index / chains, index % chains);
            let answers = prediction.answers(chain);
            let reach = &answers.reach[knot][..=answers.block[knot]];
            for (one, by_one) in reach.iter().enumerate() {
                let (one, a) = (prediction.unknown(chain, one), limited.weight * by_one[0]);
                g[one] += a * over;
                for (other, by_other) in reach.iter().enumerate() {
                    h[(one, prediction.unknown(chain, other))] += a * by_other[0];
                }
            }
        }
        for (index, limited) in distances.iter().enumerate() {
            let Some(over) = limited.over() else { continue };
            let (knot, pair) = (index / clearance.len(), index % clearance.len());
            let (first, free) = (jets * prediction.knots(), prediction.joints);
            let answers = prediction.answers(jets);
            let row = &mut row[..free * (answers.block[knot] + 1)];
            for (index, value) in row.iter_mut().enumerate() {
                *value = answers.reach[knot][index / free][0] * clearance.by_joint[(index % free, pair)];
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

/// Second derivatives of the cost of the inputs and of the joints, which do not depend on the state.
fn constant_cost(prediction: &Prediction, squares: &[[f64; 3]]) -> DMatrix<f64> {
    let mut h = DMatrix::zeros(prediction.unknowns(), prediction.unknowns());
    for (chain, squares) in squares.iter().enumerate() {
        for (knot, duration) in prediction.durations.iter().enumerate() {
            let unknown = prediction.unknown(chain, prediction.answers(chain).block[knot]);
            h[(unknown, unknown)] += duration * squares[2];
        }
        if chain >= prediction.jets {
            add_squares(prediction, chain, *squares, &mut h);
        }
    }
    h
}

/// Adds to H the cost of the first two states of a chain at the end of the knots.
fn add_squares(prediction: &Prediction, chain: usize, squares: [f64; 3], h: &mut DMatrix<f64>) {
    let [of_first, of_second, _] = squares;
    for (duration, reach) in prediction.durations.iter().zip(&prediction.answers(chain).reach) {
        for (one, a) in reach.iter().enumerate() {
            for (other, b) in reach.iter().enumerate() {
                h[(prediction.unknown(chain, one), prediction.unknown(chain, other))] +=
                    duration * (of_first * a[0] * b[0] + of_second * a[1] * b[1]);
            }
        }
    }
}
