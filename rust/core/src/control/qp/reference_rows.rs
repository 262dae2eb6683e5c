//! Clarabel for bounds and general rows: the reference for tests and the fallback on the ground.

use super::reference::{GeneralRows, bound_rows, clamped, run_clarabel, unless_certified};
use super::rows::judged_with_rows;
use super::{QpAnswer, QpStatus, RowQp, row_kkt_residual};
use crate::linalg;
use nalgebra::{DMatrix, DVector};

/// Corrections of the set of active constraints by the polish.
const POLISH_ROUNDS: usize = 4;

/// Solves of the equations of one active set, each from the residual of the last.
const CORRECTIONS: usize = 3;

/// The interior-point method of Clarabel with the rows of [`RowQp`]: slow and **allocating**, and with
/// nothing in common with [`super::DualActiveSetSolver`], the polish included: it solves the equations of
/// the constraints that Clarabel presses on as one linear system.
#[derive(Debug, Clone)]
pub struct ClarabelRowSolver {
    x: Vec<f64>,
    multipliers: Vec<f64>,
    polish: bool,
}

impl ClarabelRowSolver {
    /// A solver for problems in `n` variables with `rows` inequalities besides the bounds.
    #[must_use]
    pub fn new(n: usize, rows: usize) -> Self {
        Self { x: vec![0.0; n], multipliers: vec![0.0; rows], polish: true }
    }

    /// Leaves the answer as Clarabel gives it, for comparisons; expect [`QpStatus::Inaccurate`] often.
    #[must_use]
    pub fn without_polish(mut self) -> Self {
        self.polish = false;
        self
    }

    /// The last answer, inside its bounds. Zero before the first solve.
    #[must_use]
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// Multipliers of the rows in the last answer.
    #[must_use]
    pub fn multipliers(&self) -> &[f64] {
        &self.multipliers
    }

    /// Solves `qp` from scratch. Total, like [`super::ClarabelSolver::solve`].
    pub fn solve(&mut self, qp: &RowQp) -> QpAnswer {
        let (n, rows) = (self.x.len(), self.multipliers.len());
        if qp.len() != n || qp.rows() != rows || !qp.sizes_agree() {
            return QpAnswer::refused(QpStatus::SizeMismatch);
        }
        if let Some(status) = qp.fault() {
            return QpAnswer::refused(status);
        }
        if !qp.bounded.h.iter().chain(qp.bounded.g.iter()).all(|v| v.is_finite()) {
            return QpAnswer::refused(QpStatus::NonFinite);
        }
        if qp.is_empty() {
            return judged_with_rows(qp, &self.x, &self.multipliers, 0, QpStatus::Inaccurate);
        }
        if !linalg::cholesky_in_place(&mut qp.bounded.h.as_slice().to_vec(), n, n) {
            return QpAnswer::refused(QpStatus::NotPositiveDefinite);
        }
        let (fixed, bounds) = bound_rows(&qp.bounded);
        // Rows that limit nothing stay out.
        let given: Vec<usize> = (0..rows).filter(|&k| qp.limit[k].is_finite()).collect();
        let mut general = GeneralRows::default();
        for (place, &k) in given.iter().enumerate() {
            let column = qp.normals.column(k);
            let set = column.iter().enumerate().filter(|(_, value)| **value != 0.0);
            general.entries.extend(set.map(|(i, value)| (place, i, *value)));
            general.limits.push(qp.limit[k]);
        }
        let Some(solution) = run_clarabel(&qp.bounded, &fixed, &bounds, &general) else {
            return QpAnswer::refused(QpStatus::Breakdown);
        };
        let mut x = clamped(&qp.bounded, &solution.x);
        let mut multipliers = vec![0.0; rows];
        for (&k, z) in given.iter().zip(&solution.z[fixed.len() + bounds.len()..]) {
            multipliers[k] = z.max(0.0);
        }
        if self.polish {
            (x, multipliers) = polished(qp, x, multipliers);
        }
        let otherwise = unless_certified(solution.status);
        let answer = judged_with_rows(qp, &x, &multipliers, solution.iterations, otherwise);
        if answer.status != QpStatus::NonFinite {
            (self.x, self.multipliers) = (x, multipliers);
        }
        answer
    }
}

/// The point moved to the minimiser of the constraints it presses on, if that lowers its residual.
fn polished(qp: &RowQp, x: Vec<f64>, multipliers: Vec<f64>) -> (Vec<f64>, Vec<f64>) {
    let mut best_kkt = row_kkt_residual(qp, &x, &multipliers);
    let mut best = (x.clone(), multipliers.clone());
    let (mut x, mut multipliers) = (x, multipliers);
    for _ in 0..POLISH_ROUNDS {
        let Some((next_x, next_multipliers)) = solve_active(qp, &x, &multipliers) else { break };
        (x, multipliers) = (next_x, next_multipliers);
        let candidate = clamped(&qp.bounded, &x);
        let pressing: Vec<f64> = multipliers.iter().map(|u| u.max(0.0)).collect();
        let kkt = row_kkt_residual(qp, &candidate, &pressing);
        if best_kkt.is_nan() || kkt < best_kkt {
            (best_kkt, best) = (kkt, (candidate, pressing));
        }
    }
    best
}

/// Guesses which bounds and rows hold and solves their equations; `None` if they have no single answer.
///
/// A bound holds if a step of its coordinate alone ends beyond it, a row if its multiplier outweighs its
/// slack, both in scaled units.
fn solve_active(qp: &RowQp, x: &[f64], multipliers: &[f64]) -> Option<(Vec<f64>, Vec<f64>)> {
    let n = qp.len();
    let (h, g) = (&qp.bounded.h, &qp.bounded.g);
    let roots: Vec<f64> = (0..n).map(|i| h[(i, i)].sqrt()).collect();
    let point = DVector::from_column_slice(x);
    let pressure = DVector::from_column_slice(multipliers);
    let gradient = h * &point + g + &qp.normals * &pressure;
    // Equations a · x = b, scaled: (entries over y, b).
    let mut equations: Vec<(DVector<f64>, f64)> = Vec::new();
    for i in 0..n {
        let wanted = x[i] - gradient[i] / h[(i, i)];
        let (lower, upper) = (qp.bounded.lower[i], qp.bounded.upper[i]);
        if wanted <= lower || wanted >= upper {
            let mut unit = DVector::zeros(n);
            unit[i] = 1.0;
            equations.push((unit, if wanted <= lower { lower } else { upper } * roots[i]));
        }
    }
    let mut held_rows = Vec::new();
    for (k, multiplier) in multipliers.iter().enumerate() {
        let scaled = DVector::from_fn(n, |i, _| qp.normals[(i, k)] / roots[i]);
        let length = scaled.norm();
        let slack = (qp.limit[k] - qp.normals.column(k).dot(&point)) / length;
        if length > 0.0 && multiplier * length > slack {
            held_rows.push((k, equations.len(), length));
            equations.push((scaled / length, qp.limit[k] / length));
        }
    }
    let m = equations.len();
    let mut system = DMatrix::zeros(n + m, n + m);
    for j in 0..n {
        for i in 0..n {
            system[(i, j)] = h[(i, j)] / (roots[i] * roots[j]);
        }
    }
    let mut right = DVector::zeros(n + m);
    for i in 0..n {
        right[i] = -g[i] / roots[i];
    }
    for (k, (normal, limit)) in equations.iter().enumerate() {
        system.view_mut((0, n + k), (n, 1)).copy_from(normal);
        system.view_mut((n + k, 0), (1, n)).copy_from(&normal.transpose());
        right[n + k] = *limit;
    }
    let factors = system.clone().full_piv_lu();
    let mut solution = DVector::zeros(n + m);
    for _ in 0..CORRECTIONS {
        let residual = &right - &system * &solution;
        solution += factors.solve(&residual)?;
    }
    let mut next = vec![0.0; qp.rows()];
    for (k, place, length) in held_rows {
        next[k] = solution[n + place] / length;
    }
    Some(((0..n).map(|i| solution[i] / roots[i]).collect(), next))
}
