//! A monotone primal active-set method for box constraints.
//!
//! Every pass holds a *working set* of variables at their bounds and computes the Newton step `d` of the free ones.
//! It then follows the step **projected onto the box**, `y(t) = clamp(y + t d)`, to the first minimum of the
//! objective along this path: a variable that reaches its bound stays there and the others continue, so one
//! factorisation can find many bounds. When the whole step is feasible, the point is the minimiser for its working
//! set, and all bounds with a multiplier of the wrong sign are released.
//!
//! Termination: the objective decreases along the path, also after a release. (A released variable whose step points
//! out of the box is held again at once, which only steepens the descent, because its gradient and its step have the
//! same sign.) So each such minimiser is strictly below the last, no working set recurs, and between two minimisers
//! the working set only grows: at most n passes. Block pivoting and projected Newton have no such proof and do fail
//! on saturated problems.

use super::scaled::Scaled;
use super::warm_start::{Side, WarmStart};
use super::{QpAnswer, QpProblem, QpSolver, QpStatus};
use crate::linalg;

/// Limit of passes per variable. A calm tick needs one pass in total; the worst of four million fuzzed problems
/// needed 3.3 per variable.
pub const PASSES_PER_VARIABLE: u32 = 10;

/// Limit of changes of the working set by the final refinement. They are due to rounding, and could otherwise add and
/// release bounds without end.
const CORRECTION_LIMIT: u32 = 4;

/// Least pivot of a factor whose solution is not refined: its rounding error is about `ε / PIVOT_MIN = 2e-12`,
/// relative.
const PIVOT_MIN: f64 = 1e-4;

/// Extent to which a step was followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Followed {
    /// To its end, or until the remaining decrease is rounding.
    Whole,
    /// To the first minimum along it; more variables are held.
    Part,
    /// Not at all: the data are not finite.
    NotFinite,
}

/// The method for flight: exact, warm started, without allocation after [`PrimalActiveSet::new`].
///
/// Works in `y_i = x_i / s_i`, with `s_i ≈ 1/√H_ii` rounded to a power of two, so that thrust rates and joint
/// velocities have similar scale and the scaling is free of rounding.
#[derive(Debug, Clone)]
pub struct PrimalActiveSet {
    n: usize,
    iteration_limit: u32,
    /// The answer, in the units of the problem, and the working set, from which the next solve starts.
    warm: WarmStart,
    scaled: Scaled,
    /// Current point, always within the bounds.
    y: Vec<f64>,
    /// `y` in the units of the problem.
    candidate: Vec<f64>,
    /// `H y + g`.
    gradient: Vec<f64>,
    /// End of the Newton step; equal to `y` for held variables.
    target: Vec<f64>,
    /// Newton step, zero for held variables.
    step: Vec<f64>,
    /// `H · step`.
    h_step: Vec<f64>,
    /// Multiple of `step` at which a variable reaches its bound; infinite if it does not.
    meets: Vec<f64>,
    /// The free variables.
    free: Vec<usize>,
    /// Cholesky factor of their block of H, and below it the right-hand side as one more row; leading dimension n +
    /// 1.
    factor: Vec<f64>,
    /// One entry for each free variable.
    work: Vec<f64>,
}

impl QpSolver for PrimalActiveSet {
    /// Starts from the last answer and its working set. `x` is unchanged for `NonFinite`, `InfeasibleBounds` and
    /// `SizeMismatch`, which is also the status for a problem with active rows; for the other failures it is the best
    /// feasible point reached.
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer {
        self.solve_at_most(self.iteration_limit, qp)
    }

    fn solve_from(&mut self, start: &mut WarmStart, qp: &QpProblem) -> QpAnswer {
        self.solve_from_at_most(self.iteration_limit, start, qp)
    }

    fn x(&self) -> &[f64] {
        &self.warm.x
    }

    fn multipliers(&self) -> &[f64] {
        &[]
    }
}

impl PrimalActiveSet {
    fn solve_at_most(&mut self, limit: u32, qp: &QpProblem) -> QpAnswer {
        let rows = if qp.is_box() { qp.rows() } else { 0 };
        let loaded = qp.check(self.n, rows).and_then(|()| self.scaled.load(qp));
        if let Err(status) = loaded {
            return QpAnswer::from_status(status);
        }
        self.start();
        let mut iterations = 0;
        let end = self.descend(limit, &mut iterations);
        if end == QpStatus::NonFinite {
            return QpAnswer { iterations, ..QpAnswer::from_status(end) };
        }
        self.scaled.unscale(qp, &self.y, &mut self.candidate);
        let x = &self.candidate;
        let mut answer = QpAnswer::judge(qp, x, &[], iterations, QpStatus::Inaccurate);
        if answer.status != QpStatus::NonFinite {
            self.warm.x.copy_from_slice(x);
            if end != QpStatus::Solved {
                answer.status = end;
            }
        }
        answer
    }

    /// As [`QpSolver::solve_from`], in at most `limit` factorisations.
    pub(crate) fn solve_from_at_most(
        &mut self,
        limit: u32,
        start: &mut WarmStart,
        qp: &QpProblem,
    ) -> QpAnswer {
        self.warm.copy_from(start);
        let answer = self.solve_at_most(limit, qp);
        start.copy_from(&self.warm);
        answer
    }

    /// Allocates for problems in `n` variables. The first solve starts from `clamp(0)` with no variable held.
    #[must_use]
    pub fn new(n: usize) -> Self {
        let zeros = || vec![0.0; n];
        Self {
            n,
            iteration_limit: PASSES_PER_VARIABLE.saturating_mul(u32::try_from(n.max(1)).unwrap_or(u32::MAX)),
            warm: WarmStart::cold(n),
            scaled: Scaled::new(n, n + 1),
            y: zeros(),
            candidate: zeros(),
            gradient: zeros(),
            target: zeros(),
            step: zeros(),
            h_step: zeros(),
            meets: zeros(),
            free: Vec::with_capacity(n),
            factor: vec![0.0; n * (n + 1)],
            work: zeros(),
        }
    }

    /// Stops after `limit` factorisations instead of [`PASSES_PER_VARIABLE`] times n.
    #[must_use]
    pub fn with_iteration_limit(mut self, limit: u32) -> Self {
        self.iteration_limit = limit;
        self
    }

    /// Greatest number of factorisations of a solve.
    pub(crate) fn iteration_limit(&self) -> u32 {
        self.iteration_limit
    }

    /// Discards the last answer and its working set: the next solve starts cold.
    pub fn reset(&mut self) {
        self.warm.x.fill(0.0);
        self.warm.side.fill(Side::Free);
    }

    /// Sets `y` to the last answer, clamped to the new bounds.
    fn start(&mut self) {
        let Scaled { inverse_s, lower, upper, .. } = &self.scaled;
        let bounds = lower.iter().zip(upper);
        let last = self.warm.x.iter().zip(inverse_s);
        for (((y, side), (x, inverse_s)), (&lower, &upper)) in
            self.y.iter_mut().zip(&mut self.warm.side).zip(last).zip(bounds)
        {
            if lower >= upper {
                *side = Side::Lower;
            }
            *y = match side {
                Side::Lower if lower.is_finite() => lower,
                Side::Upper if upper.is_finite() => upper,
                _ => {
                    *side = Side::Free;
                    (x * inverse_s).max(lower).min(upper)
                }
            };
        }
    }

    /// The active-set loop. `Solved` means that it found the correct working set.
    fn descend(&mut self, limit: u32, iterations: &mut u32) -> QpStatus {
        let mut corrections = 0;
        loop {
            if *iterations >= limit {
                return QpStatus::IterationLimit;
            }
            *iterations += 1;
            // The first pass needs no gradient if its step is feasible. The others solve for the remaining gradient,
            // so that they converge to rounding error.
            let is_first = *iterations == 1;
            if !is_first {
                self.update_gradient();
            }
            if !self.aim(is_first) {
                self.update_gradient();
                let finite = self.gradient.iter().all(|q| q.is_finite());
                return if finite { QpStatus::NotPositiveDefinite } else { QpStatus::NonFinite };
            }
            match self.follow(!is_first) {
                Followed::Whole => {}
                Followed::Part => continue,
                Followed::NotFinite => return QpStatus::NonFinite,
            }
            // Without held variables there is nothing to release.
            if self.free.len() < self.n {
                self.update_gradient();
                if self.release() {
                    continue;
                }
            }
            if self.is_well_conditioned() {
                return QpStatus::Solved;
            }
            // One step of iterative refinement with the same factor and a gradient from the data. Even an answer that
            // is certified to 2 ε needs it: with an ill-conditioned H, x would be wrong by 1e-7 of its bounds. On an
            // ill-conditioned face the step can reach a bound, which is then held as usual.
            self.update_gradient();
            self.correct();
            if corrections == CORRECTION_LIMIT {
                self.take_target();
                return QpStatus::Solved;
            }
            if self.follow(true) == Followed::Whole {
                return QpStatus::Solved;
            }
            corrections += 1;
        }
    }

    /// `gradient = H y + g`, from the data every time, because incremental updates would accumulate rounding errors.
    fn update_gradient(&mut self) {
        self.gradient.copy_from_slice(&self.scaled.g);
        self.scaled.add_hessian_times(&self.y, &mut self.gradient);
    }

    /// Releases every bound whose multiplier has the wrong sign; `false` if there is none.
    fn release(&mut self) -> bool {
        // Below this value a multiplier is rounding error of the gradient.
        let size = linalg::max_abs(&self.scaled.g).max(linalg::max_abs(&self.y));
        let tolerance = self.n as f64 * f64::EPSILON * size;
        let Scaled { lower, upper, .. } = &self.scaled;
        let bounds = lower.iter().zip(upper);
        let mut any = false;
        for ((side, q), (lower, upper)) in self.warm.side.iter_mut().zip(&self.gradient).zip(bounds) {
            let held_back = match side {
                Side::Free => false,
                Side::Lower => *q < -tolerance,
                Side::Upper => *q > tolerance,
            };
            if held_back && lower < upper {
                *side = Side::Free;
                any = true;
            }
        }
        any
    }

    /// Sets the target to the minimiser over the free variables with the others fixed; `false` if H is not positive
    /// definite on the free ones.
    ///
    /// ```text
    /// H_FF y_F = −(g_F + H_FB y_B),   given the gradient   H_FF (y_F − y_F,now) = −gradient_F
    /// ```
    fn aim(&mut self, is_first: bool) -> bool {
        let (n, ld) = (self.n, self.n + 1);
        self.free.clear();
        self.free.extend((0..n).filter(|&j| self.warm.side[j] == Side::Free));
        self.target.copy_from_slice(&self.y);
        if is_first {
            self.gradient.copy_from_slice(&self.scaled.g);
            for j in (0..n).filter(|&j| self.warm.side[j] != Side::Free) {
                linalg::add_scaled(&mut self.gradient, self.y[j], self.scaled.column(j));
            }
        }
        // The columns beyond the last held variable are moved in one piece, which is possible because H and its
        // factor have columns of equal length.
        let m = self.free.len();
        let rest = self.warm.side.iter().rposition(|side| *side != Side::Free).map_or(0, |held| held + 1);
        let first = m - (n - rest);
        for (place, &j) in self.free[..first].iter().enumerate() {
            let (from, to) = (self.scaled.column(j), &mut self.factor[place * ld..][..m]);
            for (to, &i) in to[place..].iter_mut().zip(&self.free[place..]) {
                *to = from[i];
            }
        }
        let piece = self.scaled.h.get(rest * (ld + 1)..).unwrap_or_default();
        self.factor[first * (ld + 1)..][..piece.len()].copy_from_slice(piece);
        for (column, &j) in self.factor.chunks_exact_mut(ld).zip(&self.free) {
            column[m] = -self.gradient[j];
        }
        if !linalg::cholesky_in_place(&mut self.factor, m, m + 1, ld) {
            return false;
        }
        let steps = &mut self.work[..m];
        for (step, column) in steps.iter_mut().zip(self.factor.chunks_exact(ld)) {
            *step = column[m];
        }
        linalg::solve_lower_transposed_in_place(&self.factor, m, ld, steps);
        for (&j, step) in self.free.iter().zip(steps) {
            self.target[j] = if is_first { *step } else { self.y[j] + *step };
        }
        true
    }

    /// Whether all pivots of the factor are at least [`PIVOT_MIN`]; the diagonal entries are between 1 and 4.
    fn is_well_conditioned(&self) -> bool {
        let mut reciprocals = self.factor.iter().step_by(self.n + 2).take(self.free.len());
        reciprocals.all(|reciprocal| reciprocal * reciprocal <= 1.0 / PIVOT_MIN)
    }

    /// Sets the target to `y − H_FF⁻¹ gradient_F` with the present factor.
    fn correct(&mut self) {
        let (m, ld) = (self.free.len(), self.n + 1);
        let steps = &mut self.work[..m];
        for (step, &j) in steps.iter_mut().zip(&self.free) {
            *step = -self.gradient[j];
        }
        linalg::solve_lower_in_place(&self.factor, m, ld, steps);
        linalg::solve_lower_transposed_in_place(&self.factor, m, ld, steps);
        self.target.copy_from_slice(&self.y);
        for (step, &j) in steps.iter().zip(&self.free) {
            self.target[j] += step;
        }
    }

    /// `x_F = H_FF⁻¹ b_F` with the variables that the last answer leaves free, in the units of its problem; zero for the
    /// others.
    pub(crate) fn solve_free(&mut self, b: &mut [f64]) {
        let (m, ld) = (self.free.len(), self.n + 1);
        let free = &mut self.work[..m];
        for (to, &j) in free.iter_mut().zip(&self.free) {
            *to = b[j] * self.scaled.s[j];
        }
        linalg::solve_lower_in_place(&self.factor, m, ld, free);
        linalg::solve_lower_transposed_in_place(&self.factor, m, ld, free);
        b.fill(0.0);
        for (x, &j) in free.iter().zip(&self.free) {
            b[j] = x * self.scaled.s[j];
        }
    }

    /// Moves to the target; the clamp changes it by rounding only.
    fn take_target(&mut self) {
        let bounds = self.scaled.lower.iter().zip(&self.scaled.upper);
        for ((y, target), (lower, upper)) in self.y.iter_mut().zip(&self.target).zip(bounds) {
            *y = target.max(*lower).min(*upper);
        }
    }

    /// Follows the projected step to the first minimum of the objective along it, and holds the variables that
    /// reached a bound. The result is `Whole` if the target is within the bounds, so that `y` is the minimiser for
    /// its working set, and also if the remaining decrease is rounding, so that no pass leaves everything unchanged.
    fn follow(&mut self, is_gradient_known: bool) -> Followed {
        let bounds = self.scaled.lower.iter().zip(&self.scaled.upper);
        // No branch in the loop, so that it vectorises.
        #[allow(clippy::needless_bitwise_bool, reason = "`&&` branches")]
        let inside = |fits: bool, (target, (lower, upper)): (&f64, (&f64, &f64))| {
            fits & (lower <= target) & (target <= upper)
        };
        if self.target.iter().zip(bounds).fold(true, inside) {
            self.y.copy_from_slice(&self.target);
            return Followed::Whole;
        }
        if !is_gradient_known {
            self.update_gradient();
        }
        if !self.gradient.iter().chain(&self.target).all(|value| value.is_finite()) {
            return Followed::NotFinite;
        }
        let Scaled { lower, upper, .. } = &self.scaled;
        let points = self.target.iter().zip(&self.y).zip(lower.iter().zip(upper));
        for ((t, d), ((target, y), (lower, upper))) in self.meets.iter_mut().zip(&mut self.step).zip(points) {
            *d = target - y;
            let distance = if *d > 0.0 { upper - y } else { lower - y };
            *t = if *d == 0.0 { f64::INFINITY } else { distance / *d };
        }
        self.h_step.fill(0.0);
        self.scaled.add_hessian_times(&self.step, &mut self.h_step);
        let mut t = 0.0;
        let mut met_any = false;
        // Each iteration but the last holds one more variable.
        for _ in 0..=self.n {
            let slope = linalg::dot(&self.gradient, &self.step);
            let curvature = linalg::dot(&self.step, &self.h_step);
            if slope >= 0.0 || curvature <= 0.0 {
                return if met_any { Followed::Part } else { Followed::Whole };
            }
            let minimum = t - slope / curvature;
            let mut met = None;
            let mut t_next = minimum;
            for (i, &t_i) in self.meets.iter().enumerate() {
                if t_i < t_next {
                    (met, t_next) = (Some(i), t_i);
                }
            }
            // A degenerate bound is reached at t = 0; rounding may give a slightly negative t.
            let dt = (t_next - t).max(0.0);
            linalg::add_scaled(&mut self.y, dt, &self.step);
            linalg::add_scaled(&mut self.gradient, dt, &self.h_step);
            let Some(i) = met else { break };
            met_any = true;
            t = t.max(t_next);
            let d = self.step[i];
            (self.warm.side[i], self.y[i]) =
                if d > 0.0 { (Side::Upper, upper[i]) } else { (Side::Lower, lower[i]) };
            self.step[i] = 0.0;
            self.meets[i] = f64::INFINITY;
            linalg::add_scaled(&mut self.h_step, -d, self.scaled.column(i));
        }
        if met_any { Followed::Part } else { Followed::Whole }
    }
}
