//! Clarabel with our problem and our certificate: a reference for tests, and an optional solver in flight.

use super::{QpAnswer, QpProblem, QpSolver, QpStatus, kkt_residual};
use crate::linalg;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolution, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};
use nalgebra::{DMatrix, DVector};

/// Duality gap (absolute and relative) and feasibility required of Clarabel.
const TOLERANCE: f64 = 1e-12;

/// Added to the diagonal of Clarabel's equations. With its default of 1e-8, two of three flight problems end
/// in lack of progress at 1e-5 of the objective, because iterative refinement cannot correct a regularisation
/// that is large relative to the small diagonal entries of `H`. `H` is positive definite, so hardly any is
/// needed.
const REGULARISATION: f64 = 1e-14;

/// Limit of interior-point iterations. Flight problems take 10 to 20.
const ITERATION_LIMIT: u32 = 100;

/// Limit of corrections of the active set in the polish; one is usual.
const POLISH_ROUNDS: usize = 4;

/// Solutions of the equations of one active set, each from the residual of the last.
const CORRECTIONS: usize = 3;

/// Clarabel's interior-point method: slow (hundreds of µs) and **allocating**, but independent of the
/// active-set methods.
///
/// An interior point approaches the bounds without reaching them. At our condition numbers (2e8) the
/// objective is exact up to the duality gap, but single coordinates are not. The answer is therefore
/// **polished**: its active constraints are held, and the equations of the other variables are solved
/// directly. The polished point replaces Clarabel's only if its [`kkt_residual`] is lower, and the result is
/// judged like every other answer.
#[derive(Debug, Clone)]
pub struct ClarabelSolver {
    x: Vec<f64>,
    multipliers: Vec<f64>,
    polish: bool,
}

impl ClarabelSolver {
    /// A solver for problems in `n` variables with `rows` rows in addition to the bounds.
    #[must_use]
    pub fn new(n: usize, rows: usize) -> Self {
        Self { x: vec![0.0; n], multipliers: vec![0.0; rows], polish: true }
    }

    /// Disables the polish, for comparisons; the status is then often [`QpStatus::Inaccurate`].
    #[must_use]
    pub fn without_polish(mut self) -> Self {
        self.polish = false;
        self
    }
}

impl QpSolver for ClarabelSolver {
    /// Solves from scratch. The whole of `H` must be positive definite. `x` is unchanged for `NonFinite`,
    /// `InfeasibleBounds`, `NotPositiveDefinite` and `SizeMismatch`.
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer {
        let n = self.x.len();
        if let Err(status) = qp.check(n, self.multipliers.len()) {
            return QpAnswer::from_status(status);
        }
        if !qp.h.iter().chain(&qp.g).all(|v| v.is_finite()) {
            return QpAnswer::from_status(QpStatus::NonFinite);
        }
        if qp.is_empty() {
            return QpAnswer::judge(qp, &self.x, &self.multipliers, 0, QpStatus::Inaccurate);
        }
        // An indefinite problem has stationary points, to which an interior-point method can converge.
        if !linalg::cholesky_in_place(&mut qp.h.as_slice().to_vec(), n, n, n) {
            return QpAnswer::from_status(QpStatus::NotPositiveDefinite);
        }
        let constraints = Constraints::from_problem(qp);
        let Some(solution) = run_clarabel(qp, &constraints) else {
            return QpAnswer::from_status(QpStatus::Breakdown);
        };
        let mut x = solution.x;
        qp.clamp(&mut x);
        let mut multipliers = vec![0.0; qp.rows()];
        for (&k, z) in constraints.rows.iter().zip(&solution.z[constraints.bounds()..]) {
            multipliers[k] = z.max(0.0);
        }
        if self.polish {
            (x, multipliers) = polish(qp, x, multipliers);
        }
        let otherwise = uncertified_status(solution.status);
        let answer = QpAnswer::judge(qp, &x, &multipliers, solution.iterations, otherwise);
        if answer.status != QpStatus::NonFinite {
            (self.x, self.multipliers) = (x, multipliers);
        }
        answer
    }

    fn x(&self) -> &[f64] {
        &self.x
    }

    fn multipliers(&self) -> &[f64] {
        &self.multipliers
    }
}

/// Constraints in the form and the row order of Clarabel.
struct Constraints {
    /// Fixed variables: equations.
    fixed: Vec<usize>,
    upper: Vec<usize>,
    lower: Vec<usize>,
    /// Rows with a finite limit.
    rows: Vec<usize>,
}

impl Constraints {
    fn from_problem(qp: &QpProblem) -> Self {
        let is_fixed = |i: usize| qp.lower[i] >= qp.upper[i];
        let variables = |keep: &dyn Fn(usize) -> bool| (0..qp.len()).filter(|&i| keep(i)).collect();
        Self {
            fixed: variables(&is_fixed),
            upper: variables(&|i| !is_fixed(i) && qp.upper[i].is_finite()),
            lower: variables(&|i| !is_fixed(i) && qp.lower[i].is_finite()),
            rows: (0..qp.rows()).filter(|&k| qp.limit[k].is_finite()).collect(),
        }
    }

    fn bounds(&self) -> usize {
        self.fixed.len() + self.upper.len() + self.lower.len()
    }
}

/// `None` if Clarabel rejects the data.
fn run_clarabel(qp: &QpProblem, constraints: &Constraints) -> Option<DefaultSolution<f64>> {
    let n = qp.len();
    let (mut p_rows, mut p_columns, mut p_values) = (Vec::new(), Vec::new(), Vec::new());
    for j in 0..n {
        for i in 0..=j {
            p_rows.push(i);
            p_columns.push(j);
            p_values.push(qp.h[(i, j)]);
        }
    }
    let p = CscMatrix::new_from_triplets(n, n, p_rows, p_columns, p_values);
    // Rows `a · x + slack = b`.
    let Constraints { fixed, upper, lower, rows } = constraints;
    let (mut a_rows, mut a_columns, mut a_values, mut b) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let upper_sides = fixed.iter().chain(upper).map(|&i| (i, 1.0, qp.upper[i]));
    for (i, sign, bound) in upper_sides.chain(lower.iter().map(|&i| (i, -1.0, -qp.lower[i]))) {
        a_rows.push(b.len());
        a_columns.push(i);
        a_values.push(sign);
        b.push(bound);
    }
    for &k in rows {
        for (i, entry) in qp.normals.column(k).iter().enumerate().filter(|(_, entry)| **entry != 0.0) {
            a_rows.push(b.len());
            a_columns.push(i);
            a_values.push(*entry);
        }
        b.push(qp.limit[k]);
    }
    let a = CscMatrix::new_from_triplets(b.len(), n, a_rows, a_columns, a_values);
    let cones = [ZeroConeT(fixed.len()), NonnegativeConeT(b.len() - fixed.len())];
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

/// Status of a point that does not meet the certificate.
fn uncertified_status(status: SolverStatus) -> QpStatus {
    match status {
        SolverStatus::Solved | SolverStatus::AlmostSolved => QpStatus::Inaccurate,
        SolverStatus::MaxIterations => QpStatus::IterationLimit,
        // The first two occur at the limit of double precision; the point is often good, and the certificate
        // decides. The others cannot occur with finite data, checked bounds, a definite H, no time limit and
        // no callback, so a false report also counts as a breakdown.
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

/// Moves a point to the minimiser for its active constraints, if that lowers the residual. A weakly active
/// constraint may be misjudged; the next round starts from the point corrected so far.
fn polish(qp: &QpProblem, mut x: Vec<f64>, mut multipliers: Vec<f64>) -> (Vec<f64>, Vec<f64>) {
    let mut best_kkt = kkt_residual(qp, &x, &multipliers);
    let mut best = (x.clone(), multipliers.clone());
    for _ in 0..POLISH_ROUNDS {
        let Some(minimiser) = solve_active(qp, &x, &multipliers) else { break };
        (x, multipliers) = minimiser;
        let mut candidate = x.clone();
        qp.clamp(&mut candidate);
        let pressing: Vec<f64> = multipliers.iter().map(|u| u.max(0.0)).collect();
        let kkt = kkt_residual(qp, &candidate, &pressing);
        if best_kkt.is_nan() || kkt < best_kkt {
            (best_kkt, best) = (kkt, (candidate, pressing));
        }
    }
    best
}

/// Estimates the active bounds and rows, and solves the equations of the free variables `F` and the active
/// rows in scaled units; `None` if they have no unique solution.
///
/// ```text
/// H_FF x_F + C_F u = −(g_F + H_FA x_A),   C_Fᵀ x_F = limit − C_Aᵀ x_A
/// ```
///
/// A bound is active if a step of its coordinate alone, `x_i − gradient_i/H_ii`, ends beyond it; a row is
/// active if its multiplier exceeds its slack, both in scaled units.
fn solve_active(qp: &QpProblem, x: &[f64], multipliers: &[f64]) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut gradient = vec![0.0; qp.len()];
    write_gradient(qp, x, multipliers, &mut gradient);
    let mut next: Vec<f64> = x.to_vec();
    let mut free = Vec::new();
    for i in 0..qp.len() {
        let wanted = x[i] - gradient[i] / qp.h[(i, i)];
        if wanted <= qp.lower[i] {
            next[i] = qp.lower[i];
        } else if wanted >= qp.upper[i] {
            next[i] = qp.upper[i];
        } else {
            free.push(i);
        }
    }
    let roots: Vec<f64> = (0..qp.len()).map(|i| qp.h[(i, i)].sqrt()).collect();
    let point = DVector::from_column_slice(x);
    // Active rows, each with its length in scaled variables.
    let mut held = Vec::new();
    for (k, multiplier) in multipliers.iter().enumerate() {
        let normal = qp.normals.column(k);
        let length = normal.iter().zip(&roots).map(|(c, root)| (c / root) * (c / root)).sum::<f64>().sqrt();
        if length > 0.0 && multiplier * length > (qp.limit[k] - normal.dot(&point)) / length {
            held.push((k, length));
        }
    }
    let mut next_multipliers = vec![0.0; qp.rows()];
    let (f, m) = (free.len(), held.len());
    if f + m == 0 {
        return Some((next, next_multipliers));
    }
    let mut system = DMatrix::zeros(f + m, f + m);
    for (row, &i) in free.iter().enumerate() {
        for (column, &j) in free.iter().enumerate() {
            system[(row, column)] = qp.h[(i, j)] / (roots[i] * roots[j]);
        }
        for (place, (k, length)) in held.iter().enumerate() {
            let entry = qp.normals[(i, *k)] / (roots[i] * length);
            (system[(row, f + place)], system[(f + place, row)]) = (entry, entry);
        }
    }
    let factors = system.full_piv_lu();
    let mut right = DVector::zeros(f + m);
    for _ in 0..CORRECTIONS {
        write_gradient(qp, &next, &next_multipliers, &mut gradient);
        for (row, &i) in free.iter().enumerate() {
            right[row] = -gradient[i] / roots[i];
        }
        let point = DVector::from_column_slice(&next);
        for (place, (k, length)) in held.iter().enumerate() {
            right[f + place] = (qp.limit[*k] - qp.normals.column(*k).dot(&point)) / length;
        }
        let step = factors.solve(&right)?;
        for (row, &i) in free.iter().enumerate() {
            next[i] += step[row] / roots[i];
        }
        for (place, (k, length)) in held.iter().enumerate() {
            next_multipliers[*k] += step[f + place] / length;
        }
    }
    Some((next, next_multipliers))
}

/// `H x + g + C u`.
fn write_gradient(qp: &QpProblem, x: &[f64], multipliers: &[f64], gradient: &mut [f64]) {
    let n = qp.len();
    gradient.copy_from_slice(qp.g.as_slice());
    linalg::add_mat_vec(gradient, qp.h.as_slice(), n, x);
    linalg::add_mat_vec(gradient, qp.normals.as_slice(), n, multipliers);
}
