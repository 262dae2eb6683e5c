//! Small dense linear algebra on slices: the mass matrix and the QPs, 20 to 64 rows.
//!
//! Matrices are column-major: entry `(i, j)` is `a[i + j·ld]` with leading dimension `ld ≥ n`, so a
//! leading block of a larger buffer is a matrix too. Nothing allocates.
//!
//! Inverses and squares work on tiles of [`TALL`] rows and [`WIDE`] columns whose sums stay in
//! registers, with the vector instructions that [`dispatch`] finds at run time. Processors without fused
//! multiplication and addition round once more; results then differ in their last bits.
//!
//! Sizes are the caller's promise, as they are for slice indexing: a slice that is too short panics.

use pulp::Arch;

/// Inner product `xᵀ y` over the shorter length.
///
/// Summed in four interleaved parts: a single running sum cannot be vectorised, because floating
/// addition does not associate.
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

/// Largest absolute value; zero for no entries. A NaN counts for nothing.
#[must_use]
pub fn max_abs(x: &[f64]) -> f64 {
    let (blocks, rest) = x.as_chunks::<4>();
    // A bare comparison is one instruction; `f64::max` is four, to get NaN right on both sides.
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

/// `y ← y + factor · x` over the shorter length.
pub fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// `y ← y + Σ_k factor_k · column_k` over K neighbouring columns.
///
/// One pass for all K: `y` is loaded and stored once, and the loop stays free of bounds checks because
/// every column is cut to the length of `y` first.
#[inline]
fn add_columns<const K: usize>(y: &mut [f64], columns: &[f64], ld: usize, factors: [f64; K]) {
    let columns: [&[f64]; K] = std::array::from_fn(|k| &columns[k * ld..][..y.len()]);
    for (i, y) in y.iter_mut().enumerate() {
        let mut sum = 0.0;
        for k in 0..K {
            sum += factors[k] * columns[k][i];
        }
        *y += sum;
    }
}

/// `y ← y + A x` for a `y.len() × x.len()` matrix.
///
/// # Panics
/// If `a` does not hold that matrix.
pub fn add_mat_vec(y: &mut [f64], a: &[f64], ld: usize, x: &[f64]) {
    let (blocks, rest) = x.as_chunks::<4>();
    for (block, &factors) in blocks.iter().enumerate() {
        add_columns(y, &a[block * 4 * ld..], ld, factors);
    }
    if !y.is_empty() {
        let left = (x.len() - rest.len()) * ld;
        match *rest {
            [x0, x1, x2] => add_columns(y, &a[left..], ld, [x0, x1, x2]),
            [x0, x1] => add_columns(y, &a[left..], ld, [x0, x1]),
            [x0] => add_columns(y, &a[left..], ld, [x0]),
            _ => {}
        }
    }
}

/// Factors a symmetric positive definite matrix, `A = L Lᵀ`, over its own lower triangle; `false` if
/// it is not positive definite to working precision (or holds a NaN). See [`cholesky_resume_in_place`].
///
/// # Panics
/// If `a` does not hold an `n × n` matrix.
#[must_use]
pub fn cholesky_in_place(a: &mut [f64], n: usize, ld: usize) -> bool {
    cholesky_resume_in_place(a, 0, n, ld)
}

/// [`cholesky_in_place`] for a matrix whose first `done` columns hold their part of `L` already, all `n`
/// rows of it, and whose other columns hold `A`.
///
/// The diagonal receives the **reciprocals** `1/L_jj`: every later substitution multiplies by them,
/// and a division costs ten multiplications. The strict upper triangle is neither read nor written.
/// After `false` the lower triangle is spoilt.
///
/// A pivot must exceed `n ε a_jj`: below that it consists of rounding. The test is relative to each
/// diagonal entry, so rows may have different units.
///
/// Left-looking: column j is finished before column j+1 is touched, so the square root of one column
/// overlaps with the update of the next.
///
/// # Panics
/// If `a` does not hold an `n × n` matrix.
#[must_use]
pub fn cholesky_resume_in_place(a: &mut [f64], done: usize, n: usize, ld: usize) -> bool {
    let relative_floor = n as f64 * f64::EPSILON;
    for j in done..n {
        let (left, todo) = a.split_at_mut(j * ld);
        let column = &mut todo[j..n];
        let floor = relative_floor * column[0];
        let mut k = 0;
        while k + 4 <= j {
            subtract_finished::<4>(column, &left[k * ld + j..], ld);
            k += 4;
        }
        match j - k {
            3 => subtract_finished::<3>(column, &left[k * ld + j..], ld),
            2 => subtract_finished::<2>(column, &left[k * ld + j..], ld),
            1 => subtract_finished::<1>(column, &left[k * ld + j..], ld),
            _ => {}
        }
        let pivot = column[0];
        // NaN must fail too, and so must an infinite entry, whose floor is infinite.
        if pivot.is_nan() || pivot <= floor {
            return false;
        }
        let reciprocal = 1.0 / pivot.sqrt();
        column[0] = reciprocal;
        for c in &mut column[1..] {
            *c *= reciprocal;
        }
    }
    true
}

/// Takes K finished columns out of `column`: `a_i −= Σ_k L_0k L_ik`, rows counted from the diagonal.
#[inline]
fn subtract_finished<const K: usize>(column: &mut [f64], finished: &[f64], ld: usize) {
    add_columns::<K>(column, finished, ld, std::array::from_fn(|k| -finished[k * ld]));
}

/// Rows of a tile: two vectors of four.
const TALL: usize = 8;

/// Columns of a tile.
const WIDE: usize = 4;

/// Runs `kernel` compiled for the vector instructions of this processor; it gets to know whether they
/// multiply and add in one. What it calls must be inlined.
#[inline(always)]
pub(crate) fn dispatch<R>(kernel: impl FnOnce(bool) -> R) -> R {
    match Arch::new() {
        Arch::Scalar => kernel(false),
        arch => arch.dispatch(
            #[inline(always)]
            || kernel(cfg!(any(target_arch = "x86_64", target_arch = "aarch64"))),
        ),
    }
}

/// `a b + c`. Unless `fused`, `mul_add` would be a call.
#[inline(always)]
fn multiply_add(fused: bool, a: f64, b: f64, c: f64) -> f64 {
    if fused { a.mul_add(b, c) } else { a * b + c }
}

/// The first N entries.
#[inline(always)]
fn chunk<const N: usize>(x: &[f64]) -> [f64; N] {
    std::array::from_fn(|i| x[..N][i])
}

/// Tiles over the rows `first..n`, `n ≥ TALL`: where each begins, and its first row that is new. The last one
/// overlaps the one before it.
#[inline(always)]
fn tiles(first: usize, n: usize) -> impl Iterator<Item = (usize, usize)> {
    (first..n).step_by(TALL).map(move |row| (row.min(n - TALL), row))
}

/// `Σ_k A_(r+i)k A_(j+c)k` over the first `count` columns: `sums[c][i]`.
#[inline(always)]
fn outer_sums<const R: usize, const C: usize>(
    fused: bool,
    a: &[f64],
    ld: usize,
    count: usize,
    r: usize,
    j: usize,
) -> [[f64; R]; C] {
    let mut sums = [[0.0; R]; C];
    for k in 0..count {
        let (left, right) = (chunk::<R>(&a[k * ld + r..]), chunk::<C>(&a[k * ld + j..]));
        for (sums, right) in sums.iter_mut().zip(right) {
            for (sum, left) in sums.iter_mut().zip(left) {
                *sum = multiply_add(fused, left, right, *sum);
            }
        }
    }
    sums
}

/// Solves `L X = B` in place, `L` as [`cholesky_in_place`] leaves it; `b` holds the right-hand sides
/// one after the other, `n` entries each.
///
/// # Panics
/// If `l` does not hold an `n × n` matrix.
pub fn solve_lower_in_place(l: &[f64], n: usize, ld: usize, b: &mut [f64]) {
    for b in b.chunks_exact_mut(n.max(1)) {
        let mut j = 0;
        // Two columns a pass: half as many trips through `b`, and its chain of dependent operations
        // is what limits a right-hand side.
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

/// Solves `Lᵀ X = B` in place, `L` as [`cholesky_in_place`] leaves it; `b` holds the right-hand sides
/// one after the other, `n` entries each.
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
        // Two rows a pass, from the end: their inner products run side by side.
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

/// Writes the inverse of `L` (as [`cholesky_in_place`] leaves it) into the `n × n` matrix `inverse`:
/// a plain lower triangle, zeros above it.
///
/// ```text
/// W e_i = (e_i − Σ_m>i L_mi W e_m) / L_ii,   last column first
/// ```
///
/// # Panics
/// If either slice does not hold its matrix.
pub fn invert_lower(l: &[f64], n: usize, ld: usize, inverse: &mut [f64]) {
    dispatch(
        #[inline(always)]
        |fused| {
            for i in (0..n).rev() {
                let (column, finished) = inverse[i * n..].split_at_mut(n);
                let factors = &l[i * ld..][..n];
                column.fill(0.0);
                if n < TALL {
                    for m in i + 1..n {
                        add_scaled(column, -factors[i] * factors[m], &finished[(m - i - 1) * n..][..n]);
                    }
                } else {
                    for (top, first) in tiles(i + 1, n) {
                        let mut sums = [0.0; TALL];
                        // Columns beyond the tile have zeros in its rows.
                        for m in i + 1..top + TALL {
                            let entries = chunk::<TALL>(&finished[(m - i - 1) * n + top..]);
                            for (sum, entry) in sums.iter_mut().zip(entries) {
                                *sum = multiply_add(fused, factors[m], entry, *sum);
                            }
                        }
                        for (entry, sum) in column[first..top + TALL].iter_mut().zip(&sums[first - top..]) {
                            *entry = -factors[i] * sum;
                        }
                    }
                }
                column[i] = factors[i];
            }
        },
    );
}

/// Writes the inverse `L⁻ᵀ L⁻¹` of the symmetric matrix whose factor `L` is (as [`cholesky_in_place`]
/// leaves it). `work` is space for an `n × n` matrix.
///
/// # Panics
/// If a slice does not hold its matrix.
pub fn invert_symmetric(l: &[f64], n: usize, ld: usize, work: &mut [f64], inverse: &mut [f64]) {
    invert_lower(l, n, ld, work);
    // Columns of L⁻ᵀ are what tiles are made of.
    for j in 0..n {
        for i in j + 1..n {
            work.swap(i + j * n, j + i * n);
        }
    }
    dispatch(
        #[inline(always)]
        // Row i of L⁻ᵀ begins at column i.
        |fused| outer_product(fused, work, n, |row| row, inverse),
    );
}

/// Writes `A Aᵀ` of a matrix of `n` rows.
///
/// # Panics
/// If `product` does not hold an `n × n` matrix.
pub fn times_transpose(a: &[f64], n: usize, product: &mut [f64]) {
    dispatch(
        #[inline(always)]
        |fused| outer_product(fused, a, n, |_| 0, product),
    );
}

/// `A Aᵀ` of a matrix of n rows, of which row i is zero before column `start(i)`, which does not fall with i.
#[inline(always)]
fn outer_product(fused: bool, a: &[f64], n: usize, start: impl Fn(usize) -> usize, product: &mut [f64]) {
    let tiled = if n < TALL { 0 } else { n / WIDE * WIDE };
    let columns = a.len() / n.max(1);
    for j in (0..tiled).step_by(WIDE) {
        for (top, first) in tiles(j, n) {
            let from = start(top);
            let sums = outer_sums::<TALL, WIDE>(fused, &a[from * n..], n, columns - from, top, j);
            for (c, sums) in sums.iter().enumerate() {
                product[(j + c) * n + first..][..top + TALL - first].copy_from_slice(&sums[first - top..]);
            }
        }
    }
    for column in tiled..n {
        for row in column..n {
            let entries = (start(row)..columns).map(|k| a[row + k * n] * a[column + k * n]);
            product[row + column * n] = entries.sum();
        }
    }
    for column in 0..n {
        for row in 0..column {
            product[row + column * n] = product[column + row * n];
        }
    }
}

/// Writes the symmetric product `Aᵀ A` of a matrix with `rows` rows and as many columns as `a` holds.
///
/// # Panics
/// If `product` does not hold a square matrix of that many columns.
pub fn gram(a: &[f64], rows: usize, product: &mut [f64]) {
    let columns = a.len() / rows.max(1);
    for j in 0..columns {
        for i in 0..=j {
            let entry = dot(&a[i * rows..][..rows], &a[j * rows..][..rows]);
            product[i + j * columns] = entry;
            product[j + i * columns] = entry;
        }
    }
}
