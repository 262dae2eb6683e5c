//! The box QP with further rows: what the torques of a standing robot have to respect.
//!
//! Equation M66 of `docs/model.md`.

use super::{BoxQp, QpAnswer, QpStatus};
use crate::linalg;
use nalgebra::{DMatrix, DVector};

/// Data of one QP with bounds and general inequalities, allocated once and overwritten every tick.
///
/// ```text
/// minimise  ½ xᵀ H x + gᵀ x   subject to   lower ≤ x ≤ upper,   Cᵀ x ≤ limit
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RowQp {
    /// Hessian, linear term and bounds.
    pub bounded: BoxQp,
    /// `C`: one *column* for each inequality, so that each lies in one piece.
    pub normals: DMatrix<f64>,
    /// Right-hand sides; `+inf` where there is none.
    pub limit: DVector<f64>,
}

impl RowQp {
    /// The problem `½ |x|²` in `n` variables, with `rows` inequalities that say nothing.
    #[must_use]
    pub fn new(n: usize, rows: usize) -> Self {
        Self {
            bounded: BoxQp::new(n),
            normals: DMatrix::zeros(n, rows),
            limit: DVector::from_element(rows, f64::INFINITY),
        }
    }

    /// Number of variables.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bounded.len()
    }

    /// True for the problem without variables.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bounded.is_empty()
    }

    /// Number of inequalities besides the bounds.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.limit.len()
    }

    /// Every part is of the order `g` has.
    pub(super) fn sizes_agree(&self) -> bool {
        self.bounded.sizes_agree() && self.normals.shape() == (self.len(), self.rows())
    }

    /// What is wrong with bounds and rows: as for the box, and a row that is not finite or that nothing
    /// finite satisfies.
    pub(super) fn fault(&self) -> Option<QpStatus> {
        let nan = self.limit.iter().any(|limit| limit.is_nan())
            || !self.normals.iter().all(|entry| entry.is_finite());
        let impossible = self.limit.iter().any(|limit| *limit == f64::NEG_INFINITY);
        match self.bounded.bounds_fault() {
            Some(QpStatus::NonFinite) => Some(QpStatus::NonFinite),
            _ if nan => Some(QpStatus::NonFinite),
            fault => fault.or_else(|| impossible.then_some(QpStatus::InfeasibleBounds)),
        }
    }
}

/// How far `x` with multipliers `u ≥ 0` of the rows is from satisfying the optimality conditions,
/// without units.
///
/// ```text
/// y_i = √H_ii x_i,   q_i = (H x + g + C u)_i / √H_ii,   d_k = |(C_ik / √H_ii)_i|
/// kkt = max( max_i | y_i − clamp(y_i − q_i, bounds) |,  max_k | min(d_k u_k, (limit_k − c_kᵀ x) / d_k) | )  /  size
/// ```
///
/// `d_k` is the length of row k in the scaled variables, so both of its entries have the unit of y; the
/// smaller of the two vanishes where the row is satisfied, its multiplier is not negative, and one of
/// them is zero. `size` is the largest of 1, `|g/√H_ii|`, `|y|` and `|d u|`. Reads the problem, `x` and
/// `u` only, so it judges any solver. NaN for data that are not finite or do not fit together.
#[must_use]
pub fn row_kkt_residual(qp: &RowQp, x: &[f64], multipliers: &[f64]) -> f64 {
    let n = qp.len();
    if x.len() != n || multipliers.len() != qp.rows() || !qp.sizes_agree() {
        return f64::NAN;
    }
    let BoxQp { h, g, lower, upper } = &qp.bounded;
    let (h, normals) = (h.as_slice(), qp.normals.as_slice());
    let (mut residual, mut size, mut finite) = (0.0_f64, 1.0_f64, true);
    for i in 0..n {
        // H is symmetric: its row i is its column i.
        let mut gradient = g[i] + linalg::dot(&h[i * n..][..n], x);
        for (k, multiplier) in multipliers.iter().enumerate() {
            if *multiplier != 0.0 {
                gradient += normals[i + k * n] * multiplier;
            }
        }
        let root = h[i + i * n].sqrt();
        let (y, q) = (root * x[i], gradient / root);
        let projected = (y - q).max(root * lower[i]).min(root * upper[i]);
        residual = residual.max((y - projected).abs());
        size = size.max((g[i] / root).abs()).max(y.abs());
        finite &= q.is_finite() && y.is_finite() && !lower[i].is_nan() && !upper[i].is_nan();
    }
    for (k, (multiplier, limit)) in multipliers.iter().zip(qp.limit.iter()).enumerate() {
        let normal = &normals[k * n..][..n];
        let squares = normal.iter().enumerate().map(|(i, c)| c * c / h[i + i * n]);
        let length = squares.sum::<f64>().sqrt();
        finite &= length.is_finite() && multiplier.is_finite() && !limit.is_nan();
        if length > 0.0 {
            let slack = (limit - linalg::dot(normal, x)) / length;
            let pressure = length * multiplier;
            residual = residual.max(slack.min(pressure).abs());
            size = size.max(pressure.abs());
        } else {
            // 0 ≤ limit: true or false whatever x is.
            residual = residual.max(multiplier.abs()).max(-limit.min(0.0));
        }
    }
    if finite { residual / size } else { f64::NAN }
}

/// Judges `x` and the multipliers of the rows by the certificate alone; `otherwise` is the status where
/// they do not pass. Active are variables on a bound and rows with a multiplier.
pub(super) fn judged_with_rows(
    qp: &RowQp,
    x: &[f64],
    multipliers: &[f64],
    iterations: u32,
    otherwise: QpStatus,
) -> QpAnswer {
    let pressing: u32 = multipliers.iter().map(|multiplier| u32::from(*multiplier > 0.0)).sum();
    let active = super::on_bounds(&qp.bounded, x) + pressing;
    QpAnswer::certified(row_kkt_residual(qp, x, multipliers), active, iterations, otherwise)
}
