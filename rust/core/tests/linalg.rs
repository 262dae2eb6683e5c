//! The dense kernels against nalgebra and against their own definitions.

#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::assert_within;
use flight_core::linalg::*;
use nalgebra::{DMatrix, DVector};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Rows of garbage between the columns: a kernel that strays past row n reads or spoils it.
const PADDING: usize = 3;

fn random(rng: &mut ChaCha8Rng, rows: usize, columns: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0))
}

/// `A Aᵀ` with rows in different units.
fn definite(rng: &mut ChaCha8Rng, n: usize) -> DMatrix<f64> {
    let units = DMatrix::from_diagonal(&DVector::from_fn(n, |_, _| 10f64.powf(rng.random_range(-3.0..3.0))));
    let a = &units * random(rng, n, n + 2);
    &a * a.transpose()
}

fn pad(a: &DMatrix<f64>) -> (Vec<f64>, usize) {
    let ld = a.nrows() + PADDING;
    let mut buffer = vec![f64::NAN; ld * a.ncols()];
    for (to, from) in buffer.chunks_exact_mut(ld).zip(a.column_iter()) {
        to[..a.nrows()].copy_from_slice(from.as_slice());
    }
    (buffer, ld)
}

/// `L` with the reciprocals on its diagonal undone.
fn lower(buffer: &[f64], n: usize, ld: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| match i.cmp(&j) {
        std::cmp::Ordering::Less => 0.0,
        std::cmp::Ordering::Equal => 1.0 / buffer[i + j * ld],
        std::cmp::Ordering::Greater => buffer[i + j * ld],
    })
}

#[test]
fn vector_kernels_match_their_definitions_at_every_length() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for n in 0..40 {
        let (x, y) = (random(&mut rng, n, 1), random(&mut rng, n, 1));
        assert_within!((dot(x.as_slice(), y.as_slice()) - x.dot(&y)).abs(), 1e-14);
        assert_eq!(max_abs(x.as_slice()), x.iter().fold(0.0, |a: f64, b| a.max(b.abs())));
        let mut sum = y.clone();
        add_scaled(sum.as_mut_slice(), 0.7, x.as_slice());
        assert!((sum - (&y + 0.7 * &x)).amax_or_zero() < 1e-15);
    }
}

#[test]
fn matrix_vector_product_matches_nalgebra_for_every_shape() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for rows in 0..12 {
        for columns in 0..12 {
            let a = random(&mut rng, rows, columns);
            let (x, y) = (random(&mut rng, columns, 1), random(&mut rng, rows, 1));
            let (buffer, ld) = pad(&a);
            let mut got = y.clone();
            add_mat_vec(got.as_mut_slice(), &buffer, ld, x.as_slice());
            assert!((got - (y + &a * x)).amax_or_zero() < 1e-14, "{rows} x {columns}");
        }
    }
}

#[test]
fn factor_times_its_transpose_is_the_matrix() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for n in 0..34 {
        let a = definite(&mut rng, n);
        let (mut buffer, ld) = pad(&a);
        assert!(cholesky_in_place(&mut buffer, n, n, ld), "n = {n}");
        let l = lower(&buffer, n, ld);
        let error = &l * l.transpose() - &a;
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            // Componentwise: rows differ in unit by up to 1e6.
            assert_within!(
                error[(i, j)].abs(),
                1e-13 * (a[(i, i)] * a[(j, j)]).sqrt(),
                "n = {n}, ({i}, {j})"
            );
        }
        // The padding is not touched.
        assert!(buffer.chunks_exact(ld).all(|column| column[n..].iter().all(|v| v.is_nan())));
    }
}

/// A right-hand side below the matrix comes out as `L⁻¹ b`.
#[test]
fn a_row_below_the_square_is_substituted() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for n in 1..30 {
        let (a, b) = (definite(&mut rng, n), random(&mut rng, n, 1));
        let mut tall = a.clone().insert_row(n, 0.0);
        tall.row_mut(n).copy_from(&b.transpose());
        assert!(cholesky_in_place(tall.as_mut_slice(), n, n + 1, n + 1));
        let l = lower(tall.as_slice(), n, n + 1);
        let found = tall.row(n).transpose();
        // Backward stable, row by row.
        let bound = 1e-14 * (l.abs() * found.abs() + b.abs());
        assert!((&l * &found - &b).abs().zip_map(&bound, |r, b| r / b).max() <= 1.0, "n = {n}");
    }
}

#[test]
fn scaling_weighs_rows_and_columns() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for n in 0..30 {
        let (a, w) = (random(&mut rng, n, n), random(&mut rng, n, 1));
        let (buffer, ld) = pad(&a);
        let mut to = DMatrix::from_element(n, n, f64::NAN);
        scale_symmetric(&buffer, ld, w.as_slice(), to.as_mut_slice(), n);
        assert_eq!(to, DMatrix::from_fn(n, n, |i, j| a[(i, j)] * (w[i] * w[j])));
    }
}

#[test]
fn substitutions_undo_the_factor_for_many_right_hand_sides() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for n in 1..34 {
        let (mut buffer, ld) = pad(&definite(&mut rng, n));
        assert!(cholesky_in_place(&mut buffer, n, n, ld));
        let l = lower(&buffer, n, ld);
        let b = random(&mut rng, n, 5);
        // Backward stable: judged by the residual, row by row, not by the error of x.
        let mut x = b.clone();
        solve_lower_in_place(&buffer, n, ld, x.as_mut_slice());
        let bound = 1e-14 * (l.abs() * x.abs() + b.abs());
        assert!((&l * &x - &b).abs().zip_map(&bound, |r, b| r / b).max() <= 1.0, "forward, n = {n}");
        let mut x = b.clone();
        solve_lower_transposed_in_place(&buffer, n, ld, x.as_mut_slice());
        let bound = 1e-14 * (l.transpose().abs() * x.abs() + b.abs());
        assert!((l.transpose() * &x - &b).abs().zip_map(&bound, |r, b| r / b).max() <= 1.0, "back, n = {n}");
    }
    solve_lower_in_place(&[], 0, 0, &mut []);
    solve_lower_transposed_in_place(&[], 0, 0, &mut []);
}

#[test]
fn inverse_factor_and_products_match_nalgebra() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for n in 0..30 {
        let (mut buffer, ld) = pad(&definite(&mut rng, n));
        assert!(cholesky_in_place(&mut buffer, n, n, ld));
        let l = lower(&buffer, n, ld);
        let mut inverse = DMatrix::from_element(n, n, f64::NAN);
        invert_lower_transposed(&buffer, n, ld, inverse.as_mut_slice());
        inverse = inverse.transpose();
        let bound = (l.abs() * inverse.abs()).add_scalar(1e-300) * 1e-14;
        let error = (&l * &inverse - DMatrix::identity(n, n)).abs().zip_map(&bound, |e, b| e / b);
        // Above the diagonal both are exactly zero: 0/1e-314.
        assert!(error.iter().all(|e| *e <= 1.0), "n = {n}");
        assert_eq!(inverse, inverse.lower_triangle());

        let mut product = DMatrix::from_element(n, n, f64::NAN);
        for columns in [0, 1, n / 2, n, n + 3] {
            let a = random(&mut rng, n, columns);
            times_transpose(a.as_slice(), n, product.as_mut_slice());
            assert!((&product - &a * a.transpose()).amax_or_zero() < 1e-13, "n = {n}, columns {columns}");
            assert_eq!(product, product.transpose());
        }
        let mut work = DMatrix::from_element(n, n, f64::NAN);
        invert_symmetric(&buffer, n, ld, work.as_mut_slice(), product.as_mut_slice());
        let expected = inverse.transpose() * &inverse;
        // n ε of the sum of absolute products, as for any inner product.
        let bound = (inverse.transpose().abs() * inverse.abs()) * (n as f64 * f64::EPSILON);
        assert!(
            (&product - expected).abs().iter().zip(&bound).all(|(error, bound)| error <= bound),
            "n = {n}"
        );
        assert_eq!(product, product.transpose());
    }
}

#[test]
fn matrices_that_are_not_positive_definite_are_refused() {
    let refused = |entries: &[f64], n| !cholesky_in_place(&mut entries.to_vec(), n, n, n);
    assert!(refused(&[-1.0], 1));
    assert!(refused(&[0.0], 1));
    assert!(refused(&[f64::NAN], 1));
    assert!(refused(&[f64::INFINITY], 1));
    assert!(refused(&[1.0, 2.0, 2.0, 1.0], 2));
    assert!(refused(&[1.0, f64::NAN, f64::NAN, 1.0], 2));
    // Rank one, in any units: the second pivot is rounding.
    for unit in [1e-100, 1.0, 1e100] {
        let v = [0.1, 0.3 * unit];
        assert!(refused(&[v[0] * v[0], v[0] * v[1], v[1] * v[0], v[1] * v[1]], 2), "unit {unit}");
    }
    assert!(!refused(&[1e-200, 0.0, 0.0, 1e200], 2));
}

/// `amax` of an empty matrix panics. NaN where an entry is not finite, so that no comparison passes.
trait AmaxOrZero {
    fn amax_or_zero(&self) -> f64;
}

impl AmaxOrZero for DMatrix<f64> {
    fn amax_or_zero(&self) -> f64 {
        if self.iter().all(|v| v.is_finite()) { max_abs(self.as_slice()) } else { f64::NAN }
    }
}
