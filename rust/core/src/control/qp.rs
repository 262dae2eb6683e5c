//! The box-constrained quadratic program of both controllers, its certificate and its two solvers.
//!
//! ```text
//! minimise  ½ xᵀ H x + gᵀ x   subject to   lower ≤ x ≤ upper,     H symmetric positive definite
//! ```
//!
//! [`ActiveSetSolver`] flies: exact, warm started, without allocation. [`ClarabelSolver`] is the
//! reference and the fallback: an interior-point method that shares nothing with it but the data.
//! Neither is believed: every [`QpAnswer`] carries [`kkt_residual`], computed from the problem alone.
//!
//! On the ground the torque QP has general rows as well: [`RowQp`], [`DualActiveSetSolver`] and
//! [`ClarabelRowSolver`] are the same three for it.
//!
//! Equation M66 of `docs/model.md`.

mod active_set;
mod dual_active_set;
#[cfg(feature = "clarabel")]
mod reference;
#[cfg(feature = "clarabel")]
mod reference_rows;
mod rows;
mod scaled;

pub use active_set::{ActiveSetSolver, PASSES_PER_VARIABLE};
pub use dual_active_set::DualActiveSetSolver;
#[cfg(feature = "clarabel")]
pub use reference::ClarabelSolver;
#[cfg(feature = "clarabel")]
pub use reference_rows::ClarabelRowSolver;
pub use rows::{RowQp, row_kkt_residual};

use crate::linalg;
use nalgebra::{DMatrix, DVector};

/// Largest [`kkt_residual`] of an answer that may call itself [`QpStatus::Solved`].
///
/// Rounding leaves about 1e-14 on our flight problems; an interior point stopped at its customary
/// 1e-8 does not pass.
pub const KKT_TOLERANCE: f64 = 1e-9;

/// Data of one box QP, allocated once and overwritten every tick.
#[derive(Debug, Clone, PartialEq)]
pub struct BoxQp {
    /// Hessian `H`. Solvers take it to be exactly symmetric and do not look whether it is.
    pub h: DMatrix<f64>,
    /// Linear term `g`.
    pub g: DVector<f64>,
    /// Lower bounds; `-inf` where there is none.
    pub lower: DVector<f64>,
    /// Upper bounds; `+inf` where there is none. May equal the lower one, which fixes the variable.
    pub upper: DVector<f64>,
}

impl BoxQp {
    /// The problem `½ |x|²` in `n` variables without bounds.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self {
            h: DMatrix::identity(n, n),
            g: DVector::zeros(n),
            lower: DVector::from_element(n, f64::NEG_INFINITY),
            upper: DVector::from_element(n, f64::INFINITY),
        }
    }

    /// Number of variables.
    #[must_use]
    pub fn len(&self) -> usize {
        self.g.len()
    }

    /// True for the problem without variables, whose answer is the empty vector.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Objective `½ xᵀ H x + gᵀ x`; allocates, for tests and reports. NaN if `x` has another length.
    #[must_use]
    pub fn objective(&self, x: &[f64]) -> f64 {
        if x.len() != self.len() || !self.sizes_agree() {
            return f64::NAN;
        }
        let x = DVector::from_column_slice(x);
        0.5 * x.dot(&(&self.h * &x)) + self.g.dot(&x)
    }

    /// Every part is of the order `g` has.
    fn sizes_agree(&self) -> bool {
        let n = self.len();
        self.h.shape() == (n, n) && self.lower.len() == n && self.upper.len() == n
    }

    /// What is wrong with the bounds: `None`, [`QpStatus::NonFinite`] for a NaN or
    /// [`QpStatus::InfeasibleBounds`] where no finite `x_i` lies between them.
    fn bounds_fault(&self) -> Option<QpStatus> {
        let mut infeasible = false;
        let mut nan = false;
        for (&lower, &upper) in self.lower.iter().zip(self.upper.iter()) {
            nan |= lower.is_nan() || upper.is_nan();
            infeasible |= lower > upper || lower == f64::INFINITY || upper == f64::NEG_INFINITY;
        }
        if nan { Some(QpStatus::NonFinite) } else { infeasible.then_some(QpStatus::InfeasibleBounds) }
    }
}

/// How a solve ended. The codes of [`QpStatus::code`] are for logs and never change meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum QpStatus {
    /// `x` is the minimiser: its [`kkt_residual`] is at most [`KKT_TOLERANCE`].
    Solved = 0,
    /// Iterations ran out; `x` is feasible and no worse than the point the solver started from, or, after the
    /// dual method, unchanged.
    IterationLimit = 1,
    /// `H` is not positive definite, to working precision, on a set of variables that were free.
    NotPositiveDefinite = 2,
    /// Some `lower > upper`, or bounds and rows leave no finite value; `x` is unchanged.
    InfeasibleBounds = 3,
    /// NaN or infinity in the data (bounds may be infinite outwards), or overflow; do not use `x`.
    NonFinite = 4,
    /// The solver finished, but its `x` misses [`KKT_TOLERANCE`].
    Inaccurate = 5,
    /// Problem and solver have different numbers of variables; `x` is unchanged.
    SizeMismatch = 6,
    /// The interior-point method gave up for a reason of its own (numerical error, no progress).
    Breakdown = 7,
}

impl QpStatus {
    /// Stable number for logs: 0 is solved.
    #[must_use]
    pub fn code(self) -> u8 {
        self as u8
    }

    /// True for [`QpStatus::Solved`] alone.
    #[must_use]
    pub fn is_solved(self) -> bool {
        self == Self::Solved
    }
}

/// What a solver says about its `x`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QpAnswer {
    /// How the solve ended.
    pub status: QpStatus,
    /// Factorisations (active set), changes of the active set (dual) or interior-point iterations (Clarabel).
    pub iterations: u32,
    /// [`kkt_residual`] or [`row_kkt_residual`] of `x`; NaN where there is no answer to judge.
    pub kkt: f64,
    /// Variables that sit on a bound, fixed ones included, and rows with a multiplier.
    pub active: u32,
}

impl QpAnswer {
    /// An answer without an `x`.
    fn refused(status: QpStatus) -> Self {
        Self { status, iterations: 0, kkt: f64::NAN, active: 0 }
    }

    /// Judges `x` by the certificate alone. `otherwise` is the status where it does not pass.
    fn judged(qp: &BoxQp, x: &[f64], iterations: u32, otherwise: QpStatus) -> Self {
        Self::certified(kkt_residual(qp, x), on_bounds(qp, x), iterations, otherwise)
    }

    /// The status that a certificate allows.
    fn certified(kkt: f64, active: u32, iterations: u32, otherwise: QpStatus) -> Self {
        let status = if kkt <= KKT_TOLERANCE {
            QpStatus::Solved
        } else if kkt.is_finite() {
            otherwise
        } else {
            QpStatus::NonFinite
        };
        Self { status, iterations, kkt, active }
    }
}

/// Number of variables on a bound.
fn on_bounds(qp: &BoxQp, x: &[f64]) -> u32 {
    let bounds = qp.lower.iter().zip(qp.upper.iter());
    x.iter().zip(bounds).map(|(x, (lower, upper))| u32::from(x <= lower || x >= upper)).sum()
}

/// How far `x` is from satisfying the optimality conditions, without units.
///
/// ```text
/// y_i = √H_ii x_i,   q_i = (H x + g)_i / √H_ii
/// kkt = max_i | y_i − clamp(y_i − q_i, √H_ii lower_i, √H_ii upper_i) |  /  max(1, |g/√H_ii|_∞, |y|_∞)
/// ```
///
/// Zero exactly at the minimiser: there a free variable has `q_i = 0`, one at its lower bound has
/// `q_i ≥ 0`, one at its upper bound `q_i ≤ 0`. An infeasible `x` shows as its scaled violation.
/// NaN for data that are not finite, for a diagonal that is not positive, for parts that do not fit
/// together. Reads the problem only, so it judges any solver.
#[must_use]
pub fn kkt_residual(qp: &BoxQp, x: &[f64]) -> f64 {
    /// Rows treated at a time, on the stack.
    const BLOCK: usize = 32;
    let n = qp.len();
    if x.len() != n || !qp.sizes_agree() {
        return f64::NAN;
    }
    let (h, g) = (qp.h.as_slice(), qp.g.as_slice());
    let mut residual = 0.0_f64;
    let mut scale = 1.0_f64;
    let mut finite = true;
    for first in (0..n).step_by(BLOCK) {
        let rows = BLOCK.min(n - first);
        let mut gradient = [0.0; BLOCK];
        gradient[..rows].copy_from_slice(&g[first..first + rows]);
        linalg::add_mat_vec(&mut gradient[..rows], &h[first..], n, x);
        for (i, gradient) in (first..first + rows).zip(gradient) {
            let (lower, upper) = (qp.lower[i], qp.upper[i]);
            let root = h[i + i * n].sqrt();
            let (y, q) = (root * x[i], gradient / root);
            let projected = (y - q).max(root * lower).min(root * upper);
            residual = residual.max((y - projected).abs());
            scale = scale.max((g[i] / root).abs()).max(y.abs());
            // `max` and `min` drop NaN, so it is looked for separately.
            finite &= q.is_finite() && y.is_finite() && !lower.is_nan() && !upper.is_nan();
        }
    }
    if finite { residual / scale } else { f64::NAN }
}
