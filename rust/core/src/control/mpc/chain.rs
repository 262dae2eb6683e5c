//! The states that one input drives, of a jet or of a joint, and their answer over the knots.
//!
//! ```text
//! jet    x = (δT, Ṫ, 0)     Ṫ = u if it is ideal; T̈ = α δT + β Ṫ + u with an engine (M174)
//! joint  x = (δs, ṡ, δe)    s̈ = K_D (u − ṡ) − K_P δe,  δė = ṡ − u (M121)
//! ```

use crate::jets::EngineModel;
use nalgebra::{Matrix3, SVector, Vector3};

/// Greatest product of rate and time of a series of ten terms: the remainder is below rounding.
const STEP: f64 = 1.0 / 16.0;
/// Bounds the work in a tick.
const HALVINGS_MAX: f64 = 24.0;

/// `ẋ = A x + b u`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chain {
    pub(super) a: Matrix3<f64>,
    pub(super) b: Vector3<f64>,
    /// Number of states, and of the first ones that act on the motion of the whole robot.
    pub(super) states: usize,
    pub(super) acting: usize,
}

impl Chain {
    /// A jet whose input is its thrust rate.
    pub(super) fn ideal_jet() -> Self {
        Self { a: Matrix3::zeros(), b: Vector3::x(), states: 1, acting: 1 }
    }

    /// A jet at a thrust \[N\], at the throttle that holds it; a shaft lags differently where its thrust rate \[N/s\] is
    /// negative.
    pub(super) fn of_engine(engine: &EngineModel, thrust: f64, thrust_rate: f64) -> Self {
        let (alpha, beta) = engine.steady_slopes(thrust, thrust_rate);
        let a = Matrix3::new(0.0, 1.0, 0.0, alpha, beta, 0.0, 0.0, 0.0, 0.0);
        Self { a, b: Vector3::y(), states: 2, acting: 1 }
    }

    /// A joint under the torque law with the gains `K_D` \[1/s\] and `K_P` \[1/s²\].
    pub(super) fn of_joint((kd, kp): (f64, f64)) -> Self {
        let a = Matrix3::new(0.0, 1.0, 0.0, 0.0, -kd, -kp, 0.0, 1.0, 0.0);
        Self { a, b: Vector3::new(0.0, kd, -1.0), states: 3, acting: 2 }
    }

    /// Times that `time` \[s\] is halved until its product with the fastest rate is at most `most`.
    pub(super) fn halvings(&self, time: f64, most: f64) -> u32 {
        let row = self.a.row(1);
        let rate = row[1].abs() + (row[0] + row[2]).abs().sqrt() + 1.0;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few halvings")]
        let halvings = libm::log2(time * rate / most).ceil().clamp(0.0, HALVINGS_MAX) as u32;
        halvings
    }

    /// Answer after `time` \[s\]: a Taylor series after halving, and squares of it.
    fn over(&self, time: f64) -> Answer {
        let halvings = self.halvings(time, STEP);
        let step = time / f64::from(1_u32 << halvings);
        let mut answer = Answer { transition: Matrix3::identity(), input: Vector3::zeros() };
        let (mut power, mut scale) = (Matrix3::identity(), step);
        for order in 1..=10 {
            answer.input += power * self.b * scale;
            power *= self.a;
            answer.transition += power * scale;
            scale *= step / f64::from(order + 1);
        }
        (0..halvings).fold(answer, |answer, _| answer.twice())
    }
}

/// What becomes of the states over some time, by themselves and by a constant unit input.
#[derive(Debug, Clone, Copy)]
pub(super) struct Answer {
    pub(super) transition: Matrix3<f64>,
    pub(super) input: Vector3<f64>,
}

impl Answer {
    fn twice(&self) -> Self {
        Self {
            transition: self.transition * self.transition,
            input: self.transition * self.input + self.input,
        }
    }
}

/// Answer of a chain along the horizon.
#[derive(Debug, Clone)]
pub(super) struct Answers {
    /// Block of each knot: the knots of a block have one input.
    pub(super) block: Vec<usize>,
    /// Over each power of two of the shortest time.
    pub(super) by_power: Vec<Answer>,
    /// States at the end of a knot by a unit input of a block.
    pub(super) reach: Vec<Vec<Vector3<f64>>>,
}

impl Answers {
    /// Those of `chain` over knots of `2^power` times the shortest `time` \[s\], with a block for each.
    pub(super) fn new(chain: &Chain, time: f64, power: &[usize], block: Vec<usize>) -> Self {
        let blocks = block.last().map_or(0, |last| last + 1);
        let longest = power.iter().max().map_or(0, |longest| longest + 1);
        let reach = vec![vec![Vector3::zeros(); blocks]; block.len()];
        let mut answers = Self { block, by_power: vec![chain.over(time); longest], reach };
        answers.update(chain, time, power);
        answers
    }

    /// Recomputes them for another chain.
    pub(super) fn update(&mut self, chain: &Chain, time: f64, power: &[usize]) {
        let mut answer = chain.over(time);
        for to in &mut self.by_power {
            *to = answer;
            answer = answer.twice();
        }
        for (knot, power) in power.iter().enumerate() {
            let Answer { transition, input } = self.by_power[*power];
            for block in 0..=self.block[knot] {
                let own = if block == self.block[knot] { input } else { Vector3::zeros() };
                self.reach[knot][block] = transition * self.before(knot, block) + own;
            }
        }
    }

    /// States at the beginning of a knot by a unit input of a block.
    pub(super) fn before(&self, knot: usize, block: usize) -> Vector3<f64> {
        knot.checked_sub(1).map_or_else(Vector3::zeros, |last| self.reach[last][block])
    }
}

/// Sum of columns, one for each state, weighted with `factors`.
pub(super) fn along<'a, const N: usize>(
    columns: &[SVector<f64, N>; 3],
    factors: impl IntoIterator<Item = &'a f64>,
) -> SVector<f64, N> {
    let used = columns.iter().zip(factors).filter(|(_, factor)| **factor != 0.0);
    used.fold(SVector::zeros(), |sum, (column, factor)| sum + column * *factor)
}
