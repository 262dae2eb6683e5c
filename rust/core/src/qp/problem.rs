//! The quadratic program with bounds and rows.

use super::QpStatus;
use nalgebra::{DMatrix, DVector};

/// Data of one problem, allocated once and overwritten in every tick.
#[derive(Debug, Clone, PartialEq)]
pub struct QpProblem {
    /// Hessian `H`. Solvers assume that it is exactly symmetric and do not check it.
    pub h: DMatrix<f64>,
    /// Linear term `g`.
    pub g: DVector<f64>,
    /// Lower bounds; `-inf` where there is none.
    pub lower: DVector<f64>,
    /// Upper bounds; `+inf` where there is none. May equal the lower one, which fixes the variable.
    pub upper: DVector<f64>,
    /// `C`: one *column* for each row of constraints, so that a row is contiguous in memory.
    pub normals: DMatrix<f64>,
    /// Right-hand sides of the rows; `+inf` where there is none.
    pub limit: DVector<f64>,
}

impl QpProblem {
    /// The problem `½ |x|²` in `n` variables without bounds, with `rows` rows of infinite limit.
    #[must_use]
    pub fn new(n: usize, rows: usize) -> Self {
        Self {
            h: DMatrix::identity(n, n),
            g: DVector::zeros(n),
            lower: DVector::from_element(n, f64::NEG_INFINITY),
            upper: DVector::from_element(n, f64::INFINITY),
            normals: DMatrix::zeros(n, rows),
            limit: DVector::from_element(rows, f64::INFINITY),
        }
    }

    /// A box-constrained problem without rows.
    #[must_use]
    pub fn without_rows(h: DMatrix<f64>, g: DVector<f64>, lower: DVector<f64>, upper: DVector<f64>) -> Self {
        let normals = DMatrix::zeros(g.len(), 0);
        Self { h, g, lower, upper, normals, limit: DVector::zeros(0) }
    }

    /// Number of variables.
    #[must_use]
    pub fn len(&self) -> usize {
        self.g.len()
    }

    /// Whether the problem has no variables; its answer is the empty vector.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of rows in addition to the bounds.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.limit.len()
    }

    /// Whether no row has a finite limit.
    #[must_use]
    pub fn is_box(&self) -> bool {
        self.limit.iter().all(|limit| *limit == f64::INFINITY)
    }

    /// Objective `½ xᵀ H x + gᵀ x`; NaN if `x` has another length. Allocates, so only for tests and reports.
    #[must_use]
    pub fn objective(&self, x: &[f64]) -> f64 {
        if x.len() != self.len() || !self.sizes_agree() {
            return f64::NAN;
        }
        let x = DVector::from_column_slice(x);
        0.5 * x.dot(&(&self.h * &x)) + self.g.dot(&x)
    }

    /// Clamps `x` to the bounds. A NaN remains NaN, because comparisons are used; `f64::max` would turn it into a
    /// bound.
    pub(crate) fn clamp(&self, x: &mut [f64]) {
        let bounds = self.lower.as_slice().iter().zip(self.upper.as_slice());
        for (x, (lower, upper)) in x.iter_mut().zip(bounds) {
            let raised = if *x < *lower { *lower } else { *x };
            *x = if raised > *upper { *upper } else { raised };
        }
    }

    /// Checks that all sizes match a solver of `n` variables and `rows` rows and that an answer may exist; the error
    /// is the corresponding status.
    pub(super) fn check(&self, n: usize, rows: usize) -> Result<(), QpStatus> {
        if self.len() != n || self.rows() != rows || !self.sizes_agree() {
            return Err(QpStatus::SizeMismatch);
        }
        let (mut infeasible, mut nan) = (false, false);
        for (&lower, &upper) in self.lower.as_slice().iter().zip(self.upper.as_slice()) {
            nan |= lower.is_nan() | upper.is_nan();
            #[allow(clippy::needless_bitwise_bool, reason = "`||` branches")]
            let is_empty = (lower > upper) | (lower == f64::INFINITY) | (upper == f64::NEG_INFINITY);
            infeasible |= is_empty;
        }
        for &limit in &self.limit {
            nan |= limit.is_nan();
            infeasible |= limit == f64::NEG_INFINITY;
        }
        // Without an early end, so that it vectorises.
        nan |= self.normals.as_slice().iter().fold(false, |nan, entry| nan | !entry.is_finite());
        if nan {
            Err(QpStatus::NonFinite)
        } else if infeasible {
            Err(QpStatus::InfeasibleBounds)
        } else {
            Ok(())
        }
    }

    /// Whether all sizes match the length of `g`.
    pub(super) fn sizes_agree(&self) -> bool {
        let n = self.len();
        self.h.shape() == (n, n)
            && self.lower.len() == n
            && self.upper.len() == n
            && self.normals.shape() == (n, self.rows())
    }
}
