//! Multilayer perceptrons, evaluated for one sample or for a sample and its mirror image.
//!
//! A matrix is stored in panels of rows, column by column: the sums of one panel stay in registers while its
//! weights are read once, for both samples of a pair. `linalg::dispatch` selects the vector length of the
//! processor. Multiplication and addition are rounded separately, so that every processor computes the same
//! bits.

use super::card::{Activation, Architecture, Card, Weights};
use crate::exponential::exp_f32;
use crate::linalg::{dispatch, dispatch_plain};
use aligned_vec::{AVec, CACHELINE_ALIGN};
use pulp::{Simd, WithSimd};
use std::fmt::Debug;

/// Values of two samples that are evaluated together; the second is the mirrored one, unused without mirroring.
pub(crate) type Pair = [f64; 2];

/// Floating-point type that the weights are converted to.
pub(crate) trait Real: Copy + Debug + Default + 'static {
    /// Numbers in a vector of 64 bytes, the longest supported.
    const LANES: usize = 64 / size_of::<Self>();
    /// A vector of these numbers.
    type Vector<S: Simd>: Copy;
    /// The complete vectors of a slice.
    fn vectors<S: Simd>(x: &[Self]) -> &[Self::Vector<S>];
    fn vectors_mut<S: Simd>(x: &mut [Self]) -> &mut [Self::Vector<S>];
    fn splat<S: Simd>(simd: S, x: Self) -> Self::Vector<S>;
    /// `a + b c` with two roundings.
    fn add_product<S: Simd>(
        simd: S,
        a: Self::Vector<S>,
        b: Self::Vector<S>,
        c: Self::Vector<S>,
    ) -> Self::Vector<S>;
    fn from_f32(x: f32) -> Self;
    fn from_f64(x: f64) -> Self;
    fn to_f64(self) -> f64;
    fn relu(self) -> Self;
    fn tanh(self) -> Self;
    fn silu(self) -> Self;
}

impl Real for f32 {
    type Vector<S: Simd> = S::f32s;

    #[inline(always)]
    fn vectors<S: Simd>(x: &[Self]) -> &[S::f32s] {
        S::as_simd_f32s(x).0
    }

    #[inline(always)]
    fn vectors_mut<S: Simd>(x: &mut [Self]) -> &mut [S::f32s] {
        S::as_mut_simd_f32s(x).0
    }

    #[inline(always)]
    fn splat<S: Simd>(simd: S, x: Self) -> S::f32s {
        simd.splat_f32s(x)
    }

    #[inline(always)]
    fn add_product<S: Simd>(simd: S, a: S::f32s, b: S::f32s, c: S::f32s) -> S::f32s {
        simd.add_f32s(a, simd.mul_f32s(b, c))
    }

    fn from_f32(x: f32) -> Self {
        x
    }

    #[allow(clippy::cast_possible_truncation)] // single precision is configured
    fn from_f64(x: f64) -> Self {
        x as Self
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    // Written so that a NaN is returned unchanged; compiles to one instruction.
    #[inline(always)]
    fn relu(self) -> Self {
        if self < 0.0 { 0.0 } else { self }
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        1.0 - 2.0 / (1.0 + exp_f32(2.0 * self))
    }

    #[inline(always)]
    fn silu(self) -> Self {
        self / (1.0 + exp_f32(-self))
    }
}

impl Real for f64 {
    type Vector<S: Simd> = S::f64s;

    #[inline(always)]
    fn vectors<S: Simd>(x: &[Self]) -> &[S::f64s] {
        S::as_simd_f64s(x).0
    }

    #[inline(always)]
    fn vectors_mut<S: Simd>(x: &mut [Self]) -> &mut [S::f64s] {
        S::as_mut_simd_f64s(x).0
    }

    #[inline(always)]
    fn splat<S: Simd>(simd: S, x: Self) -> S::f64s {
        simd.splat_f64s(x)
    }

    #[inline(always)]
    fn add_product<S: Simd>(simd: S, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
        simd.add_f64s(a, simd.mul_f64s(b, c))
    }

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
        libm::tanh(self)
    }

    fn silu(self) -> Self {
        self / (1.0 + libm::exp(-self))
    }
}

/// One layer: `W x + b`.
#[derive(Debug, Clone)]
pub(crate) struct Layer<T> {
    /// By panel, then input, V vectors of 64 bytes each; padding rows are zero. Aligned to cache lines: a vector across
    /// two of them is read twice.
    weights: AVec<T>,
    /// Padded with zeros to complete panels.
    bias: Vec<T>,
    inputs: usize,
}

impl<T: Real> Layer<T> {
    /// A layer in panels of `V` vectors; weights by row.
    pub(crate) fn new<const V: usize>(weights: &[f32], bias: &[f32], inputs: usize) -> Self {
        let height = V * T::LANES;
        let panels = bias.len().div_ceil(height);
        let entry = |row: usize, input: usize| weights.get(row * inputs + input).copied().unwrap_or(0.0);
        let rows = |panel: usize, input: usize| (0..height).map(move |row| (panel * height + row, input));
        let order = (0..panels).flat_map(|panel| (0..inputs).flat_map(move |input| rows(panel, input)));
        let mut padded: Vec<T> = bias.iter().map(|b| T::from_f32(*b)).collect();
        padded.resize(panels * height, T::default());
        Self {
            weights: AVec::from_iter(
                CACHELINE_ALIGN,
                order.map(|(row, input)| T::from_f32(entry(row, input))),
            ),
            bias: padded,
            inputs,
        }
    }

    /// Writes `activate(W x + b)` to `out` for every sample, including the padding rows.
    pub(crate) fn apply<const V: usize, const B: usize>(
        &self,
        x: &[Vec<T>; B],
        out: &mut [Vec<T>; B],
        activate: impl Fn(T) -> T,
    ) {
        dispatch(Sums::<T, V, B> { layer: self, x, out });
        let rows = self.bias.len();
        dispatch_plain(
            #[inline(always)]
            || {
                for out in out {
                    for y in &mut out[..rows] {
                        *y = activate(*y);
                    }
                }
            },
        );
    }
}

/// Computation of `W x + b` of a layer for every sample.
struct Sums<'a, T, const V: usize, const B: usize> {
    layer: &'a Layer<T>,
    x: &'a [Vec<T>; B],
    out: &'a mut [Vec<T>; B],
}

impl<T: Real, const V: usize, const B: usize> WithSimd for Sums<'_, T, V, B> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { layer: Layer { weights, bias, inputs }, x, out } = self;
        let height = V * T::LANES;
        // A panel holds this many vectors of the processor; V of them are summed at a time.
        let vectors = T::vectors::<S>(&bias[..height.min(bias.len())]).len();
        for (panel, bias) in bias.chunks_exact(height).enumerate() {
            let weights = &weights[panel * height * inputs..][..height * inputs];
            let (weights, bias) = (T::vectors::<S>(weights), T::vectors::<S>(bias));
            for first in (0..vectors).step_by(V) {
                let mut sums = [[T::splat(simd, T::default()); V]; B];
                for sums in &mut sums {
                    sums.copy_from_slice(&bias[first..first + V]);
                }
                for (k, column) in weights.chunks_exact(vectors).enumerate() {
                    let column = &column[first..first + V];
                    for b in 0..B {
                        let x = T::splat(simd, x[b][k]);
                        for v in 0..V {
                            sums[b][v] = T::add_product(simd, sums[b][v], column[v], x);
                        }
                    }
                }
                for (out, sums) in out.iter_mut().zip(&sums) {
                    let out = T::vectors_mut::<S>(&mut out[panel * height..][..height]);
                    out[first..first + V].copy_from_slice(sums);
                }
            }
        }
    }
}

/// Networks of one shape and their workspace: panels of `V` vectors, `B` samples at once.
#[derive(Debug, Clone)]
struct Mlp<T, const V: usize, const B: usize> {
    members: Vec<Vec<Layer<T>>>,
    activation: Activation,
    input: [Vec<T>; B],
    front: [Vec<T>; B],
    back: [Vec<T>; B],
}

impl<T: Real, const V: usize, const B: usize> Mlp<T, V, B> {
    fn new(weights: &Weights, activation: Activation, widths: &[usize]) -> Self {
        let layers = |member: &Vec<(Vec<f32>, Vec<f32>)>| {
            let layers = member.iter().zip(widths);
            layers.map(|((weights, bias), inputs)| Layer::new::<V>(weights, bias, *inputs)).collect()
        };
        let widest = widths.iter().max().copied().unwrap_or(0).next_multiple_of(V * T::LANES);
        let space = |length| std::array::from_fn(|_| vec![T::default(); length]);
        Self {
            members: weights.members.iter().map(layers).collect(),
            activation,
            input: space(widths[0]),
            front: space(widest),
            back: space(widest),
        }
    }

    /// Writes the mean of the members' outputs.
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
                    Activation::Relu => layer.apply::<V, B>(x, &mut self.back, T::relu),
                    Activation::Tanh => layer.apply::<V, B>(x, &mut self.back, T::tanh),
                    Activation::Silu => layer.apply::<V, B>(x, &mut self.back, T::silu),
                }
                std::mem::swap(&mut self.front, &mut self.back);
                is_first = false;
            }
            let x = if is_first { &self.input } else { &self.front };
            last.apply::<V, B>(x, &mut self.back, |sum| sum);
            for (b, y) in self.back.iter().enumerate() {
                for (output, y) in outputs.iter_mut().zip(y) {
                    output[b] += share * y.to_f64();
                }
            }
        }
    }
}

/// The networks in the configured precision, for one or two samples. The eight sums of a pass hide the latency
/// of an addition and use half of sixteen vector registers.
#[derive(Debug, Clone)]
pub(crate) struct Evaluator(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Single(Mlp<f32, 8, 1>),
    SinglePair(Mlp<f32, 4, 2>),
    Double(Mlp<f64, 8, 1>),
    DoublePair(Mlp<f64, 4, 2>),
}

impl Evaluator {
    /// The networks of a card, in the precision of their sums.
    pub(crate) fn new(card: &Card, weights: &Weights, is_double: bool) -> Self {
        let (Architecture { activation, mirror, .. }, widths) = (&card.architecture, &card.widths());
        Self(match (is_double, mirror) {
            (false, false) => Kind::Single(Mlp::new(weights, *activation, widths)),
            (false, true) => Kind::SinglePair(Mlp::new(weights, *activation, widths)),
            (true, false) => Kind::Double(Mlp::new(weights, *activation, widths)),
            (true, true) => Kind::DoublePair(Mlp::new(weights, *activation, widths)),
        })
    }

    /// Writes the mean of the members' outputs for both samples; the second stays zero without mirroring.
    pub(crate) fn evaluate(&mut self, inputs: &[Pair], outputs: &mut [Pair]) {
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

    /// A layer without inputs returns its bias.
    #[test]
    fn a_layer_without_inputs_is_its_bias() {
        let bias: Vec<f32> = (0..40_u8).map(|row| 0.5 - f32::from(row)).collect();
        let layer = Layer::<f32>::new::<4>(&[], &bias, 0);
        let mut out = [(); 2].map(|()| vec![f32::NAN; layer.bias.len()]);
        layer.apply::<4, 2>(&[vec![], vec![]], &mut out, |sum| sum);
        assert!(out.iter().all(|out| out[..bias.len()] == bias[..]));
    }

    /// Each row of a layer has its own weights, in whichever panel it is; the padding is zero.
    #[test]
    #[allow(clippy::float_cmp, reason = "sums of small whole numbers are exact")]
    fn a_layer_of_many_panels_is_its_product() {
        let number = |k: usize| f32::from(u8::try_from(k * 7 % 11).unwrap_or(0)) - 5.0;
        let (rows, inputs, x) = (300, 3, [2.0_f32, -1.0, 3.0]);
        let weights: Vec<f32> = (0..rows * inputs).map(number).collect();
        let bias: Vec<f32> = (0..rows).map(number).collect();
        let layer = Layer::<f32>::new::<4>(&weights, &bias, inputs);
        let mut out = [vec![f32::NAN; layer.bias.len()]];
        layer.apply::<4, 1>(&[x.to_vec()], &mut out, |sum| sum);
        for (row, found) in out[0].iter().enumerate() {
            let weights = weights.get(row * inputs..(row + 1) * inputs).unwrap_or(&[0.0; 3]);
            let product: f32 = weights.iter().zip(x).map(|(weight, x)| weight * x).sum();
            assert!(*found == product + bias.get(row).unwrap_or(&0.0), "row {row}: {found}");
        }
    }

    /// Activations saturate, and a NaN remains NaN.
    #[test]
    fn activations_are_total() {
        assert_eq!((Real::tanh(1e30_f32), Real::tanh(-1e30_f32)), (1.0, -1.0));
        assert_eq!((1e30_f32.silu(), (-200.0_f32).silu().abs() < 1e-30), (1e30, true));
        assert_eq!((f32::relu(-3.0), f64::relu(2.0)), (0.0, 2.0));
        assert!(f32::NAN.relu().is_nan() && f32::NAN.silu().is_nan() && Real::tanh(f32::NAN).is_nan());
    }
}
