//! Result of a solver, and the residual by which it is accepted: equation M66 of `docs/model`.

use super::{QpProblem, QpStatus};
use crate::linalg;

/// Largest [`kkt_residual`] of an answer with status [`QpStatus::Solved`]: `√ε ≈ 1.5e-8`.
///
/// The residual is a backward error: `x` is the exact minimiser for a `g` that differs from the given one by this
/// fraction of its largest scaled entry. This is below the resolution of single precision (6e-8), and so of any
/// measurement from which `g` is computed. The consequences for `x`, over 60 problems of 2 to 30 variables for each
/// condition, with units from 1e-6 to 1e6, none to all bounds active, and minimisers computed with residuals in twice
/// the precision (`cargo test -p flight-core --test main certificate -- --nocapture`; errors are those of `y`,
/// relative to `size`):
///
/// ```text
/// condition of the scaled H         1        1e3      1e6      1e9      1e12
/// residual, primal method           3e-16    3e-16    4e-16    4e-16    5e-16
/// residual, dual method             4e-16    2e-15    1e-12    3e-13    7e-16
/// error, primal method              3e-16    1e-14    2e-11    1e-8     2e-5
/// worst error that is accepted      2e-8     5e-6     3e-3     0.4      0.8
/// and its excess cost / size²       6e-16    1e-13    7e-11    8e-9     2e-9
/// ```
///
/// The residuals of both methods are four decades below the limit, so their answers are accepted; where the dual
/// method fails (4 problems in 60 at 1e9, 12 at 1e12) its residual shows it. The condition is 2e5 for the momentum QP
/// in flight, 2e4 for the torque QP, and 5e8 for the torque QP on the ground. In flight an answer at the limit would
/// be wrong by a thousandth of the largest step, at an excess cost of 1e-11. Without this answer there would be no
/// command at all, so a lower limit would not be safer.
pub const KKT_TOLERANCE: f64 = 1.490_116_119_384_765_6e-8;

/// Status and certificate of a solver's answer `x`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QpAnswer {
    /// Outcome of the solve.
    pub status: QpStatus,
    /// Factorisations (primal), changes of the active set (dual) or interior-point iterations (Clarabel).
    pub iterations: u32,
    /// [`kkt_residual`] of `x`; NaN without an answer.
    pub kkt: f64,
    /// Number of variables at a bound, with fixed ones, and of rows with a multiplier.
    pub active: u32,
}

impl QpAnswer {
    /// Status of a solve without an answer `x`.
    #[must_use]
    pub fn from_status(status: QpStatus) -> Self {
        Self { status, iterations: 0, kkt: f64::NAN, active: 0 }
    }

    /// Accepts or rejects `x` and the multipliers of the rows by their residual alone. `otherwise` is the status if
    /// they are rejected.
    pub(super) fn judge(
        qp: &QpProblem,
        x: &[f64],
        multipliers: &[f64],
        iterations: u32,
        otherwise: QpStatus,
    ) -> Self {
        let kkt = kkt_residual(qp, x, multipliers);
        let status = if kkt <= KKT_TOLERANCE {
            QpStatus::Solved
        } else if kkt.is_finite() {
            otherwise
        } else {
            QpStatus::NonFinite
        };
        let bounds = qp.lower.as_slice().iter().zip(qp.upper.as_slice());
        #[allow(clippy::needless_bitwise_bool, reason = "`||` branches")]
        let on_bounds =
            x.iter().zip(bounds).map(|(x, (lower, upper))| u32::from((x <= lower) | (x >= upper)));
        let pressing = multipliers.iter().map(|multiplier| u32::from(*multiplier > 0.0));
        Self { status, iterations, kkt, active: on_bounds.chain(pressing).sum() }
    }
}

/// Dimensionless residual of the optimality conditions at `x`, with multipliers `u ≥ 0` of the rows.
///
/// ```text
/// y_i = √H_ii x_i,   q_i = (H x + g + C u)_i / √H_ii,   d_k = |(C_ik / √H_ii)_i|
/// kkt = max( max_i | y_i − clamp(y_i − q_i, √H_ii lower_i, √H_ii upper_i) |,
///            max_k | min(d_k u_k, (limit_k − c_kᵀ x) / d_k) | )  /  size
/// ```
///
/// Zero exactly at the minimiser: there a free variable has `q_i = 0`, one at its lower bound `q_i ≥ 0`, one at its
/// upper bound `q_i ≤ 0`; rows are satisfied, their multipliers are not negative, and of slack and multiplier one
/// vanishes. `d_k` is the length of row k in the scaled variables, so all entries have the unit of y. `size` is the
/// largest of 1, `|g/√H_ii|`, `|y|` and `|d u|`. NaN for data that are not finite, for a diagonal that is not
/// positive, and for sizes that do not match. Depends on the problem, `x` and `u` only, so it applies to any solver.
#[must_use]
pub fn kkt_residual(qp: &QpProblem, x: &[f64], multipliers: &[f64]) -> f64 {
    /// Number of variables processed at a time, on the stack.
    const BLOCK: usize = 32;
    let n = qp.len();
    let is_complete = multipliers.len() == qp.rows() || (multipliers.is_empty() && qp.is_box());
    if x.len() != n || !is_complete || !qp.sizes_agree() {
        return f64::NAN;
    }
    let (h, g, normals) = (qp.h.as_slice(), qp.g.as_slice(), qp.normals.as_slice());
    let (mut residual, mut size, mut finite) = (0.0_f64, 1.0_f64, true);
    for first in (0..n).step_by(BLOCK) {
        let count = BLOCK.min(n - first);
        let mut gradient = [0.0; BLOCK];
        gradient[..count].copy_from_slice(&g[first..first + count]);
        linalg::add_mat_vec(&mut gradient[..count], &h[first..], n, x);
        for (k, multiplier) in multipliers.iter().enumerate() {
            if *multiplier != 0.0 {
                linalg::add_scaled(&mut gradient[..count], *multiplier, &normals[k * n + first..]);
            }
        }
        // All entries first, then their maxima, without branches, so that the loop vectorises.
        let (mut roots, mut distances, mut scaled_g, mut y) =
            ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
        for (root, i) in roots.iter_mut().zip(first..first + count) {
            *root = h[i + i * n];
        }
        let (g, x) = (&g[first..][..count], &x[first..][..count]);
        let (lower, upper) = (&qp.lower.as_slice()[first..][..count], &qp.upper.as_slice()[first..][..count]);
        #[allow(clippy::needless_bitwise_bool, clippy::needless_range_loop, reason = "so that it vectorises")]
        for i in 0..count {
            let root = roots[i].sqrt();
            let inverse = root.recip();
            let q = gradient[i] * inverse;
            y[i] = root * x[i];
            scaled_g[i] = g[i] * inverse;
            distances[i] = y[i] - (y[i] - q).max(root * lower[i]).min(root * upper[i]);
            // `max` and `min` ignore NaN, so it is tested separately.
            finite &= q.is_finite() & y[i].is_finite() & !lower[i].is_nan() & !upper[i].is_nan();
        }
        residual = residual.max(linalg::max_abs(&distances));
        size = size.max(linalg::max_abs(&scaled_g)).max(linalg::max_abs(&y));
    }
    for (k, (multiplier, limit)) in multipliers.iter().zip(&qp.limit).enumerate() {
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
            // A row of zeros: 0 ≤ limit holds or not, independently of x.
            residual = residual.max(multiplier.abs()).max(-limit.min(0.0));
        }
    }
    if finite { residual / size } else { f64::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of `½ x²` the residual at a small `x` is `x`: on either side of the tolerance.
    #[test]
    fn an_answer_is_solved_up_to_the_tolerance() {
        let judged =
            |x: f64| QpAnswer::judge(&QpProblem::new(1, 0), &[x], &[], 0, QpStatus::Inaccurate).status;
        assert_eq!(judged(0.99 * KKT_TOLERANCE), QpStatus::Solved);
        assert_eq!(judged(1.01 * KKT_TOLERANCE), QpStatus::Inaccurate);
        assert_eq!(judged(f64::NAN), QpStatus::NonFinite);
    }
}
