//! Multilayer perceptrons, one sample or a mirrored pair at a time.
//!
//! A matrix is stored in panels of `P` rows, entry by entry of the input: the sums of one panel stay
//! in registers while its weights stream past once, for both samples of a pair. The loops are plain
//! and of constant length, and run with the vector instructions that `linalg::dispatch` finds. They multiply
//! and add in two steps everywhere, so that every processor computes the same bits.

use super::card::{Activation, Architecture};
use super::tensors::Tensors;
use crate::error::BuildError;
use crate::linalg::dispatch;
use std::fmt::Debug;
use std::ops::{AddAssign, Mul};

/// Samples that are asked at once, the second being the mirrored one. Unused where nothing is mirrored.
pub type Pair = [f64; 2];

/// A floating-point type that weights are widened to.
trait Real: Copy + Debug + Default + Mul<Output = Self> + AddAssign {
    fn from_f32(x: f32) -> Self;
    fn from_f64(x: f64) -> Self;
    fn to_f64(self) -> f64;
    fn relu(self) -> Self;
    fn tanh(self) -> Self;
    fn silu(self) -> Self;
}

impl Real for f32 {
    fn from_f32(x: f32) -> Self {
        x
    }

    #[allow(clippy::cast_possible_truncation)] // single precision is what was asked for
    fn from_f64(x: f64) -> Self {
        x as Self
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    // Comparisons this way round let a NaN through, and are one instruction.
    #[inline(always)]
    fn relu(self) -> Self {
        if self < 0.0 { 0.0 } else { self }
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        1.0 - 2.0 / (1.0 + exp(2.0 * self))
    }

    #[inline(always)]
    fn silu(self) -> Self {
        self / (1.0 + exp(-self))
    }
}

impl Real for f64 {
    fn from_f32(x: f32) -> Self {
        Self::from(x)
    }

    fn from_f64(x: f64) -> Self {
        x
    }

    fn to_f64(self) -> f64 {
        self
    }

    fn relu(self) -> Self {
        if self < 0.0 { 0.0 } else { self }
    }

    fn tanh(self) -> Self {
        Self::tanh(self)
    }

    fn silu(self) -> Self {
        self / (1.0 + Self::exp(-self))
    }
}

/// `eˣ` to single precision, without branches or calls so that it vectorises.
///
/// ```text
/// x = n ln 2 + r,   |r| ≤ ln 2 / 2,   eˣ = 2ⁿ (1 + r + … + r⁷/7!)
/// ```
///
/// Arguments beyond ±87 give the value there. ln 2 is split so that `n ln 2` loses nothing.
#[inline(always)]
fn exp(x: f32) -> f32 {
    /// 1.5 · 2²³: adding it rounds to an integer that stands in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let x = if x > 87.0 { 87.0 } else { x };
    let x = if x < -87.0 { -87.0 } else { x };
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let mut sum = 1.0 / 5040.0;
    for coefficient in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        sum = sum * r + coefficient;
    }
    let exponent = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127);
    sum * f32::from_bits(exponent << 23)
}

/// One layer: `W x + b`.
#[derive(Debug, Clone)]
struct Layer<T> {
    /// Panel by panel, input by input, `P` rows each; rows past the last are zero.
    weights: Vec<T>,
    /// Filled up to whole panels with zeros.
    bias: Vec<T>,
    inputs: usize,
}

impl<T: Real> Layer<T> {
    fn new<const P: usize>(weights: &[f32], bias: &[f32], inputs: usize) -> Self {
        let panels = bias.len().div_ceil(P);
        let entry = |row: usize, input: usize| weights.get(row * inputs + input).copied().unwrap_or(0.0);
        let rows = |panel: usize, input: usize| (0..P).map(move |row| (panel * P + row, input));
        let order = (0..panels).flat_map(|panel| (0..inputs).flat_map(move |input| rows(panel, input)));
        let mut padded: Vec<T> = bias.iter().map(|b| T::from_f32(*b)).collect();
        padded.resize(panels * P, T::default());
        Self {
            weights: order.map(|(row, input)| T::from_f32(entry(row, input))).collect(),
            bias: padded,
            inputs,
        }
    }

    /// Writes `activate(W x + b)` to `out`, sample by sample, panels filled up.
    fn apply<const P: usize, const B: usize>(
        &self,
        x: &[Vec<T>; B],
        out: &mut [Vec<T>; B],
        activate: impl Fn(T) -> T,
    ) {
        let (biases, _) = self.bias.as_chunks::<P>();
        let (columns, _) = self.weights.as_chunks::<P>();
        for (index, bias) in biases.iter().enumerate() {
            // A layer without inputs has panels without columns.
            let panel = &columns[index * self.inputs..(index + 1) * self.inputs];
            let sums = weighted_sums(panel, bias, x);
            dispatch(
                #[inline(always)]
                |_| {
                    for (sums, out) in sums.iter().zip(&mut *out) {
                        for (sum, out) in sums.iter().zip(&mut out[index * P..]) {
                            *out = activate(*sum);
                        }
                    }
                },
            );
        }
    }
}

/// `P` rows of `W x + b`, for every sample.
///
/// A function of its own, and nothing but sums in it: that is what keeps them in registers.
#[inline(never)]
fn weighted_sums<T: Real, const P: usize, const B: usize>(
    panel: &[[T; P]],
    bias: &[T; P],
    x: &[Vec<T>; B],
) -> [[T; P]; B] {
    let x: [&[T]; B] = std::array::from_fn(|b| &x[b][..panel.len()]);
    dispatch(
        #[inline(always)]
        |_| {
            let mut sums = [*bias; B];
            for (k, weights) in panel.iter().enumerate() {
                for b in 0..B {
                    let x = x[b][k];
                    for row in 0..P {
                        sums[b][row] += weights[row] * x;
                    }
                }
            }
            sums
        },
    )
}

/// Networks of one shape and the space to evaluate them in: panels of `P` rows, `B` samples at once.
#[derive(Debug, Clone)]
struct Mlp<T, const P: usize, const B: usize> {
    members: Vec<Vec<Layer<T>>>,
    activation: Activation,
    input: [Vec<T>; B],
    front: [Vec<T>; B],
    back: [Vec<T>; B],
}

impl<T: Real, const P: usize, const B: usize> Mlp<T, P, B> {
    fn load(
        tensors: &mut Tensors,
        architecture: &Architecture,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self, BuildError> {
        let widths: Vec<usize> =
            [inputs].iter().chain(&architecture.hidden).chain([&outputs]).copied().collect();
        let mut members = Vec::new();
        for member in 0..architecture.members {
            let mut layers = Vec::new();
            for (index, width) in widths.windows(2).enumerate() {
                let name = format!("member.{member}.layer.{index}");
                let weights = tensors.take(&format!("{name}.weight"), &[width[1], width[0]])?;
                let bias = tensors.take(&format!("{name}.bias"), &[width[1]])?;
                layers.push(Layer::new::<P>(&weights, &bias, width[0]));
            }
            members.push(layers);
        }
        let widest = widths.iter().max().copied().unwrap_or(0).next_multiple_of(P);
        let space = |length| std::array::from_fn(|_| vec![T::default(); length]);
        Ok(Self {
            members,
            activation: architecture.activation,
            input: space(inputs),
            front: space(widest),
            back: space(widest),
        })
    }

    /// Mean of the members' answers.
    fn evaluate(&mut self, inputs: &[Pair], outputs: &mut [Pair]) {
        for (b, x) in self.input.iter_mut().enumerate() {
            for (x, input) in x.iter_mut().zip(inputs) {
                *x = T::from_f64(input[b]);
            }
        }
        outputs.fill([0.0; 2]);
        let share = 1.0 / self.members.len() as f64;
        for layers in &self.members {
            let Some((last, hidden)) = layers.split_last() else { continue };
            let mut is_first = true;
            for layer in hidden {
                let x = if is_first { &self.input } else { &self.front };
                match self.activation {
                    Activation::Relu => layer.apply::<P, B>(x, &mut self.back, T::relu),
                    Activation::Tanh => layer.apply::<P, B>(x, &mut self.back, T::tanh),
                    Activation::Silu => layer.apply::<P, B>(x, &mut self.back, T::silu),
                }
                std::mem::swap(&mut self.front, &mut self.back);
                is_first = false;
            }
            let x = if is_first { &self.input } else { &self.front };
            last.apply::<P, B>(x, &mut self.back, |sum| sum);
            for (b, y) in self.back.iter().enumerate() {
                for (output, y) in outputs.iter_mut().zip(y) {
                    output[b] += share * y.to_f64();
                }
            }
        }
    }
}

/// The networks, in the asked precision and for the asked number of samples. Panels are such that the
/// sums fill half of the sixteen vector registers that every x86-64 has.
#[derive(Debug, Clone)]
pub struct Evaluator(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Single(Mlp<f32, 32, 1>),
    SinglePair(Mlp<f32, 16, 2>),
    Double(Mlp<f64, 16, 1>),
    DoublePair(Mlp<f64, 8, 2>),
}

impl Evaluator {
    /// Takes the weights of all members.
    ///
    /// # Errors
    /// [`BuildError`] naming the tensor that is absent, misshapen or not finite.
    pub fn load(
        tensors: &mut Tensors,
        architecture: &Architecture,
        (inputs, outputs): (usize, usize),
        is_double: bool,
    ) -> Result<Self, BuildError> {
        Ok(Self(match (is_double, architecture.mirror) {
            (false, false) => Kind::Single(Mlp::load(tensors, architecture, inputs, outputs)?),
            (false, true) => Kind::SinglePair(Mlp::load(tensors, architecture, inputs, outputs)?),
            (true, false) => Kind::Double(Mlp::load(tensors, architecture, inputs, outputs)?),
            (true, true) => Kind::DoublePair(Mlp::load(tensors, architecture, inputs, outputs)?),
        }))
    }

    /// Writes the mean of the members' answers to both samples; the second stays zero where nothing is
    /// mirrored.
    pub fn evaluate(&mut self, inputs: &[Pair], outputs: &mut [Pair]) {
        match &mut self.0 {
            Kind::Single(mlp) => mlp.evaluate(inputs, outputs),
            Kind::SinglePair(mlp) => mlp.evaluate(inputs, outputs),
            Kind::Double(mlp) => mlp.evaluate(inputs, outputs),
            Kind::DoublePair(mlp) => mlp.evaluate(inputs, outputs),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two units in the last place, over all arguments that do not overflow.
    #[test]
    fn the_exponential_is_that_of_the_library() {
        for step in -8700..=8700 {
            let x = step as f32 * 0.01;
            let (found, expected) = (f64::from(exp(x)), f64::from(x).exp());
            assert!((found / expected - 1.0).abs() < 2.5e-7, "exp({x}) = {found}, expected {expected}");
        }
    }

    /// Saturation, and a NaN that stays one.
    #[test]
    fn activations_are_total() {
        assert_eq!((Real::tanh(1e30_f32), Real::tanh(-1e30_f32)), (1.0, -1.0));
        assert_eq!((1e30_f32.silu(), (-200.0_f32).silu().abs() < 1e-30), (1e30, true));
        assert_eq!((f32::relu(-3.0), f64::relu(2.0)), (0.0, 2.0));
        assert!(f32::NAN.relu().is_nan() && f32::NAN.silu().is_nan() && Real::tanh(f32::NAN).is_nan());
    }
}
