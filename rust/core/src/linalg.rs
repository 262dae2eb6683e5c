//! Dense linear algebra on slices for the mass matrix and the QPs, 20 to 64 rows.
//!
//! Matrices are column-major: entry `(i, j)` is `a[i + j·ld]` with leading dimension `ld ≥ n`, so a leading block
//! of a larger buffer is a matrix too. Nothing allocates.
//!
//! The matrix kernels are written for vectors of at least `WIDE` numbers and use the vectors of eight or four
//! numbers that [`Arch`] detects at run time. They work by tiles, a vector of rows by up to `WIDE` columns, whose
//! sums stay in registers. If fewer rows than a vector remain, the last tile starts earlier and computes some
//! entries twice, with the same result. In a matrix with fewer than `WIDE` rows, each row is computed alone.
//!
//! Every processor computes the same bits: the terms of a sum have one order for all vector lengths, and
//! multiplication and addition are rounded separately, because not every processor has a fused multiply-add.
//!
//! The caller guarantees the sizes, as with slice indexing: a slice that is too short panics.

#![allow(clippy::needless_range_loop, reason = "indices are those of the equations, and of constant range")]

use pulp::{Arch, Scalar, Scalar256b, Simd, WithSimd};

/// Columns of a tile.
const WIDE: usize = 4;

/// Runs plain loops, compiled for the vector instructions of this processor. Functions that they call must be
/// inlined.
#[inline(always)]
pub(crate) fn dispatch_plain<R>(loops: impl FnOnce() -> R) -> R {
    Arch::new().dispatch(loops)
}

/// Runs a kernel with the vector instructions of this processor.
#[inline(always)]
pub(crate) fn dispatch<K: WithSimd>(kernel: K) -> K::Output {
    dispatch_to(Arch::new(), kernel)
}

/// [`dispatch`] with a given instruction set.
#[inline(always)]
fn dispatch_to<K: WithSimd>(arch: Arch, kernel: K) -> K::Output {
    match arch {
        #[cfg(target_arch = "x86_64")]
        Arch::V3(_) | Arch::V4(_) => arch.dispatch(kernel),
        // The compiler decides how to compute four numbers at once.
        _ => kernel.with_simd(Scalar256b),
    }
}

/// Runs a kernel on a matrix.
#[inline(always)]
fn run<K: Kernel>(kernel: K) -> K::Output {
    dispatch(Fitted(kernel))
}

/// A kernel that can use any vectors not longer than its columns: single numbers, or at least [`WIDE`].
trait Kernel {
    type Output;

    /// Number of rows of its matrix.
    fn rows(&self) -> usize;

    /// Runs with vectors of `S::F64_LANES` numbers.
    fn with_vectors<S: Simd>(self, simd: S) -> Self::Output;
}

/// A kernel with vectors of the length that its columns allow.
struct Fitted<K>(K);

impl<K: Kernel> WithSimd for Fitted<K> {
    type Output = K::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> K::Output {
        match self.0.rows() {
            rows if rows >= S::F64_LANES => self.0.with_vectors(simd),
            rows if rows >= WIDE => self.0.with_vectors(Scalar256b),
            _ => self.0.with_vectors(Scalar),
        }
    }
}

/// Reads the vector that starts at row `top` of a column.
#[inline(always)]
fn load<S: Simd>(_: S, column: &[f64], top: usize) -> S::f64s {
    S::as_simd_f64s(&column[top..top + S::F64_LANES]).0[0]
}

/// Writes the vector that starts at row `top` of a column.
#[inline(always)]
fn store<S: Simd>(_: S, column: &mut [f64], top: usize, vector: S::f64s) {
    S::as_mut_simd_f64s(&mut column[top..top + S::F64_LANES]).0[0] = vector;
}

/// Reads the tile of C columns that starts at row `top`.
#[inline(always)]
fn load_columns<S: Simd, const C: usize>(simd: S, columns: &[f64], ld: usize, top: usize) -> [S::f64s; C] {
    let mut tile = [simd.splat_f64s(0.0); C];
    for c in 0..C {
        tile[c] = load(simd, &columns[c * ld..], top);
    }
    tile
}

/// `a b + c` with two roundings.
#[inline(always)]
fn add_product<S: Simd>(simd: S, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
    simd.add_f64s(simd.mul_f64s(a, b), c)
}

/// `c − a b` with two roundings.
#[inline(always)]
fn subtract_product<S: Simd>(simd: S, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
    simd.sub_f64s(c, simd.mul_f64s(a, b))
}

/// `a − b`, column by column.
#[inline(always)]
fn differences<S: Simd, const C: usize>(simd: S, mut a: [S::f64s; C], b: [S::f64s; C]) -> [S::f64s; C] {
    for c in 0..C {
        a[c] = simd.sub_f64s(a[c], b[c]);
    }
    a
}

/// First rows of the tiles over the rows `first..n`.
#[inline(always)]
fn tops<S: Simd>(_: S, first: usize, n: usize) -> impl Iterator<Item = usize> {
    (first..n).step_by(S::F64_LANES).map(move |row| row.min(n - S::F64_LANES))
}

/// First row of the last tile.
#[inline(always)]
fn last_top<S: Simd>(_: S, n: usize) -> usize {
    n - S::F64_LANES
}

/// `Σ_k A_ik B_(j+c)k` over the columns `from..to` of both, for the rows i of the tile at `top`: `sums[c]`.
#[inline(always)]
fn outer_sums<S: Simd, const C: usize>(
    simd: S,
    (a, lda, top): (&[f64], usize, usize),
    (b, ldb, j): (&[f64], usize, usize),
    (from, to): (usize, usize),
) -> [S::f64s; C] {
    let mut sums = [simd.splat_f64s(0.0); C];
    if from >= to {
        return sums;
    }
    let (a, b) = (a[from * lda..to * lda].chunks_exact(lda), b[from * ldb..to * ldb].chunks_exact(ldb));
    for (a, b) in a.zip(b) {
        let (left, right) = (load(simd, a, top), &b[j..j + C]);
        for c in 0..C {
            sums[c] = add_product(simd, left, simd.splat_f64s(right[c]), sums[c]);
        }
    }
    sums
}

/// Runs `$panel` over `0..$n` in panels of at most [`WIDE`] columns, not more than a vector has rows; the last may
/// be smaller.
macro_rules! for_panels {
    ($self:ident.$panel:ident::<$S:ident>($simd:ident, $n:expr)) => {
        let width = WIDE.min($S::F64_LANES);
        for j in (0..$n).step_by(width) {
            let is_done = match width.min($n - j) {
                1 => $self.$panel::<$S, 1>($simd, j),
                2 => $self.$panel::<$S, 2>($simd, j),
                3 => $self.$panel::<$S, 3>($simd, j),
                _ => $self.$panel::<$S, WIDE>($simd, j),
            };
            if !is_done {
                return false;
            }
        }
        return true;
    };
}

/// Inner product `xᵀ y` of two vectors of equal length.
///
/// Summed in four interleaved parts: the compiler cannot vectorise a single sum, because floating-point addition is
/// not associative.
#[must_use]
pub fn dot(x: &[f64], y: &[f64]) -> f64 {
    let (x_blocks, x_rest) = x.as_chunks::<4>();
    let (y_blocks, y_rest) = y.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (a, b) in x_blocks.iter().zip(y_blocks) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    let rest: f64 = x_rest.iter().zip(y_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[2]) + (sums[1] + sums[3]) + rest
}

/// Largest absolute value; zero for no entries. NaNs are ignored.
#[must_use]
pub fn max_abs(x: &[f64]) -> f64 {
    let (blocks, rest) = x.as_chunks::<4>();
    // A bare comparison is one instruction; `f64::max` is four, because it handles NaN on both sides.
    let larger = |a: f64, b: f64| if b > a { b } else { a };
    let mut lanes = [0.0; 4];
    for block in blocks {
        for (lane, x) in lanes.iter_mut().zip(block) {
            *lane = larger(*lane, x.abs());
        }
    }
    let rest = rest.iter().fold(0.0, |a, x| larger(a, x.abs()));
    lanes.into_iter().fold(rest, larger)
}

/// `y ← y + factor · x` up to the shorter length.
pub fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// `y ← y + A x` for a `y.len() × x.len()` matrix.
///
/// # Panics
/// If `a` does not hold that matrix.
pub fn add_mat_vec(y: &mut [f64], a: &[f64], ld: usize, x: &[f64]) {
    run(AddMatVec { y, a, ld, x });
}

/// Kernel of [`add_mat_vec`].
struct AddMatVec<'a> {
    y: &'a mut [f64],
    a: &'a [f64],
    ld: usize,
    x: &'a [f64],
}

impl Kernel for AddMatVec<'_> {
    type Output = ();

    fn rows(&self) -> usize {
        self.y.len()
    }

    #[inline(always)]
    fn with_vectors<S: Simd>(self, simd: S) {
        add_columns::<S, 1>(simd, self.y, (self.a, self.ld), self.x);
    }
}

/// `Y ← Y + A X` for matrices of so many columns without gaps; the bits are those of [`add_mat_vec`] by columns.
///
/// # Panics
/// If a slice does not hold its matrix.
pub fn add_mat_mat(y: &mut [f64], a: &[f64], ld: usize, x: &[f64], columns: usize) {
    run(AddMatMat { y, a, ld, x, columns });
}

/// Kernel of [`add_mat_mat`].
struct AddMatMat<'a> {
    y: &'a mut [f64],
    a: &'a [f64],
    ld: usize,
    x: &'a [f64],
    columns: usize,
}

impl Kernel for AddMatMat<'_> {
    type Output = ();

    fn rows(&self) -> usize {
        self.y.len() / self.columns
    }

    #[inline(always)]
    fn with_vectors<S: Simd>(self, simd: S) {
        const PAIR: usize = 2;
        let Self { y, a, ld, x, columns } = self;
        let (rows, inner) = (y.len() / columns, x.len() / columns);
        for (y, x) in y.chunks_mut(PAIR * rows).zip(x.chunks(PAIR * inner)) {
            if y.len() == PAIR * rows {
                add_columns::<S, PAIR>(simd, y, (a, ld), x);
            } else {
                add_columns::<S, 1>(simd, y, (a, ld), x);
            }
        }
    }
}

/// `Y ← Y + A X` for C columns.
#[inline(always)]
fn add_columns<S: Simd, const C: usize>(simd: S, y: &mut [f64], (a, ld): (&[f64], usize), x: &[f64]) {
    let (n, inner) = (y.len() / C, x.len() / C);
    if n == 0 {
        return;
    }
    // Read before the tile above it changes some of its rows.
    let last_y = load_columns::<S, C>(simd, y, n, last_top(simd, n));
    let parts: [_; C] = std::array::from_fn(|c| x[c * inner..][..inner].as_chunks::<WIDE>());
    let blocks = inner / WIDE;
    for top in tops(simd, 0, n) {
        // Separate sums, so that additions do not wait for each other.
        let mut sums = [[simd.splat_f64s(0.0); WIDE]; C];
        for block in 0..blocks {
            for part in 0..WIDE {
                let column = load(simd, &a[(block * WIDE + part) * ld..], top);
                for c in 0..C {
                    let factor = simd.splat_f64s(parts[c].0[block][part]);
                    sums[c][part] = add_product(simd, column, factor, sums[c][part]);
                }
            }
        }
        for part in 0..inner - blocks * WIDE {
            let column = load(simd, &a[(blocks * WIDE + part) * ld..], top);
            for c in 0..C {
                sums[c][0] = add_product(simd, column, simd.splat_f64s(parts[c].1[part]), sums[c][0]);
            }
        }
        let old = if top == last_top(simd, n) { last_y } else { load_columns::<S, C>(simd, y, n, top) };
        for c in 0..C {
            let [s0, s1, s2, s3] = sums[c];
            let sum = simd.add_f64s(simd.add_f64s(s0, s1), simd.add_f64s(s2, s3));
            store(simd, &mut y[c * n..], top, simd.add_f64s(old[c], sum));
        }
    }
}

/// Writes `w_i A_ij w_j` into a matrix of leading dimension `ld_to`; its order is the number of weights.
///
/// # Panics
/// If a slice does not hold its matrix.
pub fn scale_symmetric(a: &[f64], ld: usize, weights: &[f64], to: &mut [f64], ld_to: usize) {
    run(ScaleSymmetric { a, ld, weights, to, ld_to });
}

/// Kernel of [`scale_symmetric`].
struct ScaleSymmetric<'a> {
    a: &'a [f64],
    ld: usize,
    weights: &'a [f64],
    to: &'a mut [f64],
    ld_to: usize,
}

impl Kernel for ScaleSymmetric<'_> {
    type Output = ();

    fn rows(&self) -> usize {
        self.weights.len()
    }

    #[inline(always)]
    fn with_vectors<S: Simd>(self, simd: S) {
        let Self { a, ld, weights, to, ld_to } = self;
        for top in tops(simd, 0, weights.len()) {
            let of_rows = load(simd, weights, top);
            for (j, of_column) in weights.iter().enumerate() {
                let weight = simd.mul_f64s(of_rows, simd.splat_f64s(*of_column));
                store(simd, &mut to[j * ld_to..], top, simd.mul_f64s(load(simd, &a[j * ld..], top), weight));
            }
        }
    }
}

/// Factorises a symmetric positive definite matrix, `A = L Lᵀ`, in its lower triangle; `false` if it is not
/// positive definite to working precision or contains a NaN.
///
/// The matrix has `n` columns and `rows ≥ n` rows. Rows below the square become `B L⁻ᵀ`, so a right-hand side
/// stored there as a row becomes `L⁻¹ b`.
///
/// The diagonal receives the **reciprocals** `1/L_jj`, because later substitutions multiply by them and a division
/// costs ten multiplications. The strict upper triangle is not read, and is undefined afterwards; after `false` the
/// whole matrix is.
///
/// A pivot must exceed `n ε a_jj`, below which it consists of rounding errors. The test is relative to each
/// diagonal entry, so rows may have different units.
///
/// Left-looking, by panels of `WIDE` columns. Within a panel each column depends on the one before only through a
/// division; the square roots are computed in parallel, `L_ij = u_ij / √d_j` with `d_j = u_jj`.
///
/// # Panics
/// If `a` does not hold that matrix.
#[must_use]
pub fn cholesky_in_place(a: &mut [f64], n: usize, rows: usize, ld: usize) -> bool {
    run(Cholesky { a, n, rows, ld })
}

/// Kernel of [`cholesky_in_place`].
struct Cholesky<'a> {
    a: &'a mut [f64],
    n: usize,
    rows: usize,
    ld: usize,
}

impl Kernel for Cholesky<'_> {
    type Output = bool;

    fn rows(&self) -> usize {
        self.rows
    }

    #[inline(always)]
    fn with_vectors<S: Simd>(mut self, simd: S) -> bool {
        for_panels!(self.panel::<S>(simd, self.n));
    }
}

impl Cholesky<'_> {
    /// Computes columns `j..j + C` of the factor from those before; C is at most the length of a vector.
    #[inline(always)]
    fn panel<S: Simd, const C: usize>(&mut self, simd: S, j: usize) -> bool {
        let (rows, ld) = (self.rows, self.ld);
        let relative = self.n as f64 * f64::EPSILON;
        let (left, panel) = self.a.split_at_mut(j * ld);
        // Read before the tile above it changes some of its rows.
        let last = last_top(simd, rows);
        let last_old = load_columns::<S, C>(simd, panel, ld, last);
        // The first tile contains the square on the diagonal: u_c, column c before its division by √d_c.
        let first = j.min(last);
        let sums = outer_sums::<S, C>(simd, (left, ld, first), (left, ld, j), (0, j));
        let first_u = differences(simd, load_columns::<S, C>(simd, panel, ld, first), sums);
        let mut square = [[0.0; C]; C];
        let mut least = [0.0; C];
        for c in 0..C {
            least[c] = relative * panel[c * ld + j + c];
            store(simd, &mut panel[c * ld..], first, first_u[c]);
            square[c].copy_from_slice(&panel[c * ld + j..][..C]);
        }
        let mut factors = [[0.0; C]; C];
        let mut roots = [0.0; C];
        for c in 0..C {
            let pivot = square[c][c];
            // A NaN fails, and so does an infinite entry, whose least pivot is infinite.
            if pivot.is_nan() || pivot <= least[c] {
                return false;
            }
            let reciprocal = 1.0 / pivot;
            for d in c + 1..C {
                factors[d][c] = square[c][d] * reciprocal;
                for i in d..C {
                    square[d][i] -= square[c][i] * factors[d][c];
                }
            }
            roots[c] = reciprocal.sqrt();
        }
        for top in tops(simd, j, rows) {
            let mut u = if top == first {
                first_u
            } else {
                let old = if top == last { last_old } else { load_columns(simd, panel, ld, top) };
                differences(simd, old, outer_sums::<S, C>(simd, (left, ld, top), (left, ld, j), (0, j)))
            };
            for c in 0..C {
                for d in 0..c {
                    u[c] = subtract_product(simd, u[d], simd.splat_f64s(factors[c][d]), u[c]);
                }
                store(simd, &mut panel[c * ld..], top, simd.mul_f64s(u[c], simd.splat_f64s(roots[c])));
            }
        }
        for c in 0..C {
            panel[c * ld + j + c] = roots[c];
        }
        true
    }
}

/// Solves `L X = B` in place, with `L` from [`cholesky_in_place`]; `b` holds the right-hand sides one after the
/// other, `n` entries each.
///
/// # Panics
/// If `l` does not hold an `n × n` matrix.
pub fn solve_lower_in_place(l: &[f64], n: usize, ld: usize, b: &mut [f64]) {
    for b in b.chunks_exact_mut(n.max(1)) {
        let mut j = 0;
        // Two columns per pass: this halves the passes through `b`, whose chain of dependent operations limits the
        // speed.
        while j + 2 <= n {
            let (c0, c1) = (&l[j * ld + j..][..n - j], &l[(j + 1) * ld + j..][..n - j]);
            let b = &mut b[j..];
            let x0 = b[0] * c0[0];
            let x1 = (b[1] - c0[1] * x0) * c1[1];
            b[0] = x0;
            b[1] = x1;
            for ((b, c0), c1) in b[2..].iter_mut().zip(&c0[2..]).zip(&c1[2..]) {
                *b -= c0 * x0 + c1 * x1;
            }
            j += 2;
        }
        if j < n {
            b[j] *= l[j * ld + j];
        }
    }
}

/// Solves `Lᵀ X = B` in place, with `L` from [`cholesky_in_place`]; `b` holds the right-hand sides one after the
/// other, `n` entries each.
///
/// # Panics
/// If `l` does not hold an `n × n` matrix.
pub fn solve_lower_transposed_in_place(l: &[f64], n: usize, ld: usize, b: &mut [f64]) {
    for b in b.chunks_exact_mut(n.max(1)) {
        let mut j = n;
        if n % 2 == 1 {
            j -= 1;
            b[j] *= l[j * ld + j];
        }
        // Two rows per pass, from the end, so that their inner products are computed in parallel.
        while j >= 2 {
            j -= 2;
            let (c0, c1) = (&l[j * ld + j..][..n - j], &l[(j + 1) * ld + j..][..n - j]);
            let (head, tail) = b[j..].split_at_mut(2);
            let (s0, s1) = (dot(&c0[2..], tail), dot(&c1[2..], tail));
            head[1] = (head[1] - s1) * c1[1];
            head[0] = (head[0] - s0 - c0[1] * head[1]) * c0[0];
        }
    }
}

/// Writes `L⁻ᵀ`, with `L` from [`cholesky_in_place`], into the `n × n` matrix `inverse`, with zeros below its upper
/// triangle.
///
/// ```text
/// U = L⁻ᵀ,   U_JJ = L_JJ⁻ᵀ,   U_TJ = −(U_TT L_JTᵀ) U_JJ        panels J first to last, T above J
/// ```
///
/// # Panics
/// If either slice does not hold its matrix.
pub fn invert_lower_transposed(l: &[f64], n: usize, ld: usize, inverse: &mut [f64]) {
    run(InvertLower { l, n, ld, inverse });
}

/// Kernel of [`invert_lower_transposed`].
struct InvertLower<'a> {
    l: &'a [f64],
    n: usize,
    ld: usize,
    inverse: &'a mut [f64],
}

impl Kernel for InvertLower<'_> {
    type Output = bool;

    fn rows(&self) -> usize {
        self.n
    }

    #[inline(always)]
    fn with_vectors<S: Simd>(mut self, simd: S) -> bool {
        self.inverse[..self.n * self.n].fill(0.0);
        for_panels!(self.panel::<S>(simd, self.n));
    }
}

impl InvertLower<'_> {
    /// Computes columns `j..j + C` of `L⁻ᵀ` from those before.
    #[inline(always)]
    fn panel<S: Simd, const C: usize>(&mut self, simd: S, j: usize) -> bool {
        let (l, n, ld) = (self.l, self.n, self.ld);
        // Row c of L_JJ⁻¹, which is column c of U_JJ.
        let mut own = [[0.0; C]; C];
        for c in 0..C {
            let reciprocal = l[(j + c) * ld + j + c];
            own[c][c] = reciprocal;
            for d in 0..c {
                let mut sum = 0.0;
                for m in d..c {
                    sum += l[(j + m) * ld + j + c] * own[m][d];
                }
                own[c][d] = -sum * reciprocal;
            }
        }
        let (left, panel) = self.inverse.split_at_mut(j * n);
        for first in (0..j).step_by(S::F64_LANES) {
            // Rows of the tile below j get zeros, because U ends at column j so far.
            let top = first.min(last_top(simd, n));
            let sums = outer_sums::<S, C>(simd, (left, n, top), (l, ld, j), (top, j));
            for c in 0..C {
                let mut entries = simd.splat_f64s(0.0);
                for d in 0..=c {
                    entries = subtract_product(simd, sums[d], simd.splat_f64s(own[c][d]), entries);
                }
                store(simd, &mut panel[c * n..], top, entries);
            }
        }
        for c in 0..C {
            panel[c * n + j..][..C].copy_from_slice(&own[c]);
        }
        true
    }
}

/// Writes the inverse `L⁻ᵀ L⁻¹` of a symmetric matrix from its factor `L` of [`cholesky_in_place`]. `work` is an
/// `n × n` workspace.
///
/// # Panics
/// If a slice does not hold its matrix.
pub fn invert_symmetric(l: &[f64], n: usize, ld: usize, work: &mut [f64], inverse: &mut [f64]) {
    invert_lower_transposed(l, n, ld, work);
    run(TimesTranspose { a: work, n, is_upper: true, product: inverse });
}

/// Writes `A Aᵀ`, exactly symmetric, for a matrix with n rows and as many columns as `a` holds.
///
/// # Panics
/// If `product` does not hold an `n × n` matrix.
pub fn times_transpose(a: &[f64], n: usize, product: &mut [f64]) {
    run(TimesTranspose { a, n, is_upper: false, product });
}

/// Kernel of [`times_transpose`].
///
/// Computes the lower triangle; the upper one is its copy.
struct TimesTranspose<'a> {
    a: &'a [f64],
    n: usize,
    /// Whether the entries of row i before column i are zero.
    is_upper: bool,
    product: &'a mut [f64],
}

impl Kernel for TimesTranspose<'_> {
    type Output = bool;

    fn rows(&self) -> usize {
        self.n
    }

    #[inline(always)]
    fn with_vectors<S: Simd>(mut self, simd: S) -> bool {
        for_panels!(self.panel::<S>(simd, self.n));
    }
}

impl TimesTranspose<'_> {
    /// Computes columns `j..j + C` of the product.
    #[inline(always)]
    fn panel<S: Simd, const C: usize>(&mut self, simd: S, j: usize) -> bool {
        let (a, n) = (self.a, self.n);
        for top in tops(simd, j, n) {
            let from = if self.is_upper { top.max(j) } else { 0 };
            let sums = outer_sums::<S, C>(simd, (a, n, top), (a, n, j), (from, a.len() / n));
            for c in 0..C {
                store(simd, &mut self.product[(j + c) * n..], top, sums[c]);
            }
        }
        // Copies to the upper triangle.
        let (left, right) = self.product.split_at_mut((j + C) * n);
        let columns: [&[f64]; C] = std::array::from_fn(|c| &left[(j + c) * n..][..n]);
        for (row, to) in (j + C..n).zip(right.chunks_exact_mut(n)) {
            to[j..j + C].copy_from_slice(&columns.map(|column| column[row]));
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// All instruction sets of this processor, with the least one.
    fn levels() -> Vec<Arch> {
        #[cfg(target_arch = "x86_64")]
        let more = [pulp::x86::V3::try_new().map(Arch::V3), pulp::x86::V4::try_new().map(Arch::V4)];
        #[cfg(not(target_arch = "x86_64"))]
        let more = [Some(Arch::new())];
        std::iter::once(Arch::Scalar).chain(more.into_iter().flatten()).collect()
    }

    /// All kernels with all instruction sets, on matrices shorter and longer than a vector: close to nalgebra, and
    /// equal to the bit with the least instruction set.
    #[test]
    fn every_level_agrees_with_nalgebra_and_to_the_bit_with_the_first() {
        for n in 1..=29 {
            let mut first: Option<Vec<u64>> = None;
            for (level, arch) in levels().into_iter().enumerate() {
                let b = DMatrix::from_fn(n, n + 2, |i, j| ((7 * i + 3 * j + i * j) as f64).sin());
                let a = &b * b.transpose() + DMatrix::identity(n, n);
                let x = DVector::from_fn(n, |i, _| (i as f64).cos());
                // Sums of n + 2 terms below 1, and a condition number below 1e3.
                let tolerance = 1e-11;

                let mut l = a.clone();
                let kernel = Cholesky { a: l.as_mut_slice(), n, rows: n, ld: n };
                assert!(dispatch_to(arch, Fitted(kernel)));
                let mut inverse = DMatrix::from_element(n, n, f64::NAN);
                let kernel = InvertLower { l: l.as_slice(), n, ld: n, inverse: inverse.as_mut_slice() };
                dispatch_to(arch, Fitted(kernel));
                let mut whole = DMatrix::from_element(n, n, f64::NAN);
                let (factors, product) = (inverse.as_slice(), whole.as_mut_slice());
                let kernel = TimesTranspose { a: factors, n, is_upper: true, product };
                dispatch_to(arch, Fitted(kernel));
                let error = (&whole * &a - DMatrix::identity(n, n)).amax();
                assert!(error < tolerance, "level {level}, n = {n}: {error:e}");
                let mut results =
                    [l.lower_triangle(), inverse, whole.clone()].map(|m| m.as_slice().to_vec()).concat();

                let mut y = x.clone();
                let kernel = AddMatVec { y: y.as_mut_slice(), a: a.as_slice(), ld: n, x: x.as_slice() };
                dispatch_to(arch, Fitted(kernel));
                assert!((&y - (&x + &a * &x)).amax() < tolerance, "level {level}, n = {n}");

                let kernel =
                    TimesTranspose { a: b.as_slice(), n, is_upper: false, product: whole.as_mut_slice() };
                dispatch_to(arch, Fitted(kernel));
                assert!((&whole - &b * b.transpose()).amax() < tolerance, "level {level}, n = {n}");

                results.extend(y.iter().chain(&whole));
                let bits: Vec<u64> = results.into_iter().map(f64::to_bits).collect();
                assert_eq!(first.get_or_insert_with(|| bits.clone()), &bits, "level {level}, n = {n}");
            }
        }
    }
}
