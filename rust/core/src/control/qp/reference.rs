//! Clarabel behind our door: the reference for tests and the fallback of the flight.

use super::{BoxQp, QpAnswer, QpStatus, kkt_residual};
use crate::linalg;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolution, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};

/// Duality gap (absolute and relative) and feasibility asked of Clarabel.
const TOLERANCE: f64 = 1e-12;

/// Added to the diagonal of Clarabel's equations. With its own 1e-8 two of three flight problems end in
/// lack of progress at 1e-5 of the objective: iterative refinement cannot take back a regularisation
/// that is large beside the small diagonals of `H`. `H` is definite, so hardly any is needed.
const REGULARISATION: f64 = 1e-14;

/// Interior-point iterations allowed. Flight problems take 10 to 20.
const ITERATION_LIMIT: u32 = 100;

/// Corrections of the set of active bounds by the polish; one is usual.
const POLISH_ROUNDS: usize = 4;

/// The interior-point method of Clarabel: slow (hundreds of µs) and **allocating**, but with nothing in
/// common with [`super::ActiveSetSolver`] except, in the polish, the Cholesky factorisation.
///
/// An interior point approaches the bounds without reaching them. On our condition numbers (2e8) that is
/// exact in the objective, to the gap, but not in the single coordinate. So its answer is **polished**:
/// the bounds it presses on are held and the equations of the other variables are solved directly. The
/// polished point replaces Clarabel's only if its [`kkt_residual`] is lower, and the one that remains is
/// judged like every other answer.
#[derive(Debug, Clone)]
pub struct ClarabelSolver {
    x: Vec<f64>,
    polish: bool,
}

/// Rows `A x + slack = b` that carry the bounds.
pub(super) struct Bound {
    variable: usize,
    /// `+1` for `x ≤ b`, `−1` for `−x ≤ b`; fixed variables have `x = b`.
    sign: f64,
    b: f64,
}

impl ClarabelSolver {
    /// A solver for problems in `n` variables.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { x: vec![0.0; n], polish: true }
    }

    /// Leaves the answer as Clarabel gives it, for comparisons; expect [`QpStatus::Inaccurate`] often.
    #[must_use]
    pub fn without_polish(mut self) -> Self {
        self.polish = false;
        self
    }

    /// The last answer, inside the bounds it was asked for. Zero before the first solve.
    #[must_use]
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// Solves `qp` from scratch; the minimiser is then in [`ClarabelSolver::x`].
    ///
    /// Total, like the active-set solver. `H` must be positive definite as a whole. `x` is unchanged for
    /// `NonFinite`, `InfeasibleBounds`, `NotPositiveDefinite` and `SizeMismatch`.
    pub fn solve(&mut self, qp: &BoxQp) -> QpAnswer {
        if qp.len() != self.x.len() || !qp.sizes_agree() {
            return QpAnswer::refused(QpStatus::SizeMismatch);
        }
        if let Some(status) = qp.bounds_fault() {
            return QpAnswer::refused(status);
        }
        if !qp.h.iter().chain(qp.g.iter()).all(|v| v.is_finite()) {
            return QpAnswer::refused(QpStatus::NonFinite);
        }
        if qp.is_empty() {
            return QpAnswer::judged(qp, &self.x, 0, QpStatus::Inaccurate);
        }
        let n = qp.len();
        // An indefinite problem has stationary points, and an interior point can settle on one.
        if !linalg::cholesky_in_place(&mut qp.h.as_slice().to_vec(), n, n) {
            return QpAnswer::refused(QpStatus::NotPositiveDefinite);
        }
        let (fixed, bounds) = bound_rows(qp);
        let Some(solution) = run_clarabel(qp, &fixed, &bounds, &GeneralRows::default()) else {
            return QpAnswer::refused(QpStatus::Breakdown);
        };
        let otherwise = unless_certified(solution.status);
        let mut x = clamped(qp, &solution.x);
        if self.polish {
            x = polished(qp, x);
        }
        let answer = QpAnswer::judged(qp, &x, solution.iterations, otherwise);
        if answer.status != QpStatus::NonFinite {
            self.x = x;
        }
        answer
    }
}

/// Fixed variables (equations) and finite bounds (inequalities), in this order the rows of Clarabel.
pub(super) fn bound_rows(qp: &BoxQp) -> (Vec<Bound>, Vec<Bound>) {
    let (mut fixed, mut bounds) = (Vec::new(), Vec::new());
    for (variable, (&lower, &upper)) in qp.lower.iter().zip(qp.upper.iter()).enumerate() {
        if lower >= upper {
            fixed.push(Bound { variable, sign: 1.0, b: lower });
            continue;
        }
        if upper.is_finite() {
            bounds.push(Bound { variable, sign: 1.0, b: upper });
        }
        if lower.is_finite() {
            bounds.push(Bound { variable, sign: -1.0, b: -lower });
        }
    }
    (fixed, bounds)
}

/// What a point is called that misses the certificate.
pub(super) fn unless_certified(status: SolverStatus) -> QpStatus {
    match status {
        SolverStatus::Solved | SolverStatus::AlmostSolved => QpStatus::Inaccurate,
        SolverStatus::MaxIterations => QpStatus::IterationLimit,
        // The first two happen at the edge of double precision; the point is often good and the
        // certificate decides. The rest cannot happen with finite data, checked bounds, a definite
        // H, no time limit and no callback: a wrong claim is a breakdown too.
        SolverStatus::InsufficientProgress
        | SolverStatus::NumericalError
        | SolverStatus::Unsolved
        | SolverStatus::PrimalInfeasible
        | SolverStatus::DualInfeasible
        | SolverStatus::AlmostPrimalInfeasible
        | SolverStatus::AlmostDualInfeasible
        | SolverStatus::MaxTime
        | SolverStatus::CallbackTerminated => QpStatus::Breakdown,
    }
}

/// Inequalities `Cᵀ x ≤ limit` that stand below the bounds.
#[derive(Default)]
pub(super) struct GeneralRows {
    /// Row, variable and value of the entries that are not zero.
    pub entries: Vec<(usize, usize, f64)>,
    /// Right-hand sides.
    pub limits: Vec<f64>,
}

/// `None` if Clarabel refuses the data.
pub(super) fn run_clarabel(
    qp: &BoxQp,
    fixed: &[Bound],
    bounds: &[Bound],
    general: &GeneralRows,
) -> Option<DefaultSolution<f64>> {
    let n = qp.len();
    let rows = || fixed.iter().chain(bounds);
    let GeneralRows { entries, limits } = general;
    let (mut p_rows, mut p_columns, mut p_values) = (Vec::new(), Vec::new(), Vec::new());
    for j in 0..n {
        for i in 0..=j {
            p_rows.push(i);
            p_columns.push(j);
            p_values.push(qp.h[(i, j)]);
        }
    }
    let p = CscMatrix::new_from_triplets(n, n, p_rows, p_columns, p_values);
    let above = fixed.len() + bounds.len();
    let a = CscMatrix::new_from_triplets(
        above + limits.len(),
        n,
        (0..above).chain(entries.iter().map(|(row, _, _)| above + row)).collect(),
        rows().map(|row| row.variable).chain(entries.iter().map(|(_, variable, _)| *variable)).collect(),
        rows().map(|row| row.sign).chain(entries.iter().map(|(_, _, value)| *value)).collect(),
    );
    let b: Vec<f64> = rows().map(|row| row.b).chain(limits.iter().copied()).collect();
    let cones = [ZeroConeT(fixed.len()), NonnegativeConeT(bounds.len() + limits.len())];
    let settings = DefaultSettings {
        verbose: false,
        max_iter: ITERATION_LIMIT,
        tol_gap_abs: TOLERANCE,
        tol_gap_rel: TOLERANCE,
        tol_feas: TOLERANCE,
        // Unsafe without refinement, however small the regularisation.
        static_regularization_constant: REGULARISATION,
        iterative_refinement_enable: true,
        presolve_enable: false,
        ..DefaultSettings::default()
    };
    let mut solver = DefaultSolver::new(&p, qp.g.as_slice(), &a, &b, &cones, settings).ok()?;
    solver.solve();
    Some(solver.solution)
}

/// `x` moved to the minimiser of the face of the box it points at, if that lowers its residual.
///
/// A Newton step of one coordinate alone, `x_i − gradient_i/H_ii`, tells which bound to hold: it ends
/// beyond it. (At an interior point this compares multiplier and slack in the same unit.) A weakly active
/// bound may be misjudged; the next round sees the point corrected so far.
fn polished(qp: &BoxQp, x: Vec<f64>) -> Vec<f64> {
    let mut best_kkt = kkt_residual(qp, &x);
    let mut best = x.clone();
    let mut x = x;
    for _ in 0..POLISH_ROUNDS {
        let gradient = gradient(qp, &x);
        let held: Vec<Option<f64>> = (0..x.len())
            .map(|i| {
                let wanted = x[i] - gradient[i] / qp.h[(i, i)];
                if wanted <= qp.lower[i] {
                    Some(qp.lower[i])
                } else {
                    (wanted >= qp.upper[i]).then_some(qp.upper[i])
                }
            })
            .collect();
        let Some(minimiser) = solve_face(qp, &held) else { break };
        x = minimiser;
        let candidate = clamped(qp, &x);
        let kkt = kkt_residual(qp, &candidate);
        if best_kkt.is_nan() || kkt < best_kkt {
            (best_kkt, best) = (kkt, candidate);
        }
    }
    best
}

/// Solves `H_FF x_F = −(g_F + H_FA x_A)`, once more for the residual, and returns all of `x`.
fn solve_face(qp: &BoxQp, held: &[Option<f64>]) -> Option<Vec<f64>> {
    let free: Vec<usize> = (0..held.len()).filter(|&i| held[i].is_none()).collect();
    let m = free.len();
    let mut factor: Vec<f64> = free.iter().flat_map(|j| free.iter().map(|i| qp.h[(*i, *j)])).collect();
    if !linalg::cholesky_in_place(&mut factor, m, m) {
        return None;
    }
    let mut x: Vec<f64> = held.iter().map(|bound| bound.unwrap_or(0.0)).collect();
    for _ in 0..2 {
        let gradient = gradient(qp, &x);
        let mut step: Vec<f64> = free.iter().map(|&i| -gradient[i]).collect();
        linalg::solve_lower_in_place(&factor, m, m, &mut step);
        linalg::solve_lower_transposed_in_place(&factor, m, m, &mut step);
        for (&i, step) in free.iter().zip(step) {
            x[i] += step;
        }
    }
    Some(x)
}

/// `H x + g`.
fn gradient(qp: &BoxQp, x: &[f64]) -> Vec<f64> {
    let mut gradient = qp.g.as_slice().to_vec();
    linalg::add_mat_vec(&mut gradient, qp.h.as_slice(), x.len(), x);
    gradient
}

/// Inside the bounds; a NaN stays one.
pub(super) fn clamped(qp: &BoxQp, x: &[f64]) -> Vec<f64> {
    let bounds = qp.lower.iter().zip(qp.upper.iter());
    x.iter().zip(bounds).map(|(x, (&lower, &upper))| x.clamp(lower, upper)).collect()
}
