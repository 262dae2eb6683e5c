//! A monotone primal active-set method for boxes.
//!
//! Every pass holds a *working set* of variables at their bounds and computes the Newton step `d` of the
//! free ones. Then it follows the step **bent at the bounds**, `y(t) = clamp(y + t d)`, to the first
//! minimum of the objective along that path: a variable that meets its bound stays there and the rest
//! go on, so many bounds are found for one factorisation. Once the whole step fits, the point is the
//! minimiser for its working set, and all bounds that only hold the point back are let go.
//!
//! Why it ends: along the path the objective falls, also just after a release (a released variable whose
//! step points back out is dropped at once, and dropping it only steepens the descent, because its
//! gradient and its step have the same sign). So each such minimiser lies strictly below the last, no
//! working set returns, and between two of them the working set only grows: at most n passes.
//! Block pivoting and projected Newton have no such argument and do fail on saturated problems.

use super::scaled::Scaled;
use super::{QpAnswer, QpProblem, QpSolver, QpStatus};
use crate::linalg;

/// Passes allowed per variable. A calm tick needs one in all; the worst of four million fuzzed problems
/// needed 3.3 per variable.
pub const PASSES_PER_VARIABLE: u32 = 10;

/// How often the final refinement may change the working set. By then it is a matter of rounding, and
/// bounds that rounding takes and gives back must not go on for ever.
const CORRECTION_LIMIT: u32 = 4;

/// Where a variable is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    /// Not held; it may still happen to touch a bound.
    Free,
    /// At its lower bound.
    Lower,
    /// At its upper bound.
    Upper,
}

/// Where a solve begins: the last answer and its working set.
#[derive(Debug, Clone, PartialEq)]
pub struct WarmStart {
    x: Vec<f64>,
    side: Vec<Side>,
}

impl WarmStart {
    /// Begins at `clamp(0)` with nothing held, in `n` variables.
    #[must_use]
    pub fn cold(n: usize) -> Self {
        Self { x: vec![0.0; n], side: vec![Side::Free; n] }
    }

    /// Number of variables.
    #[must_use]
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there are no variables.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }
}

/// The method of a flying tick: exact, warm started, no allocation after [`PrimalActiveSet::new`].
///
/// Works in `y_i = x_i / s_i`, `s_i ≈ 1/√H_ii` rounded to a power of two, so that thrust rates and joint
/// velocities weigh the same and the scaling itself rounds nothing.
#[derive(Debug, Clone)]
pub struct PrimalActiveSet {
    n: usize,
    iteration_limit: u32,
    /// The answer, in the units of the problem; the starting point of the next solve.
    x: Vec<f64>,
    /// The working set, kept for the next solve.
    side: Vec<Side>,
    scaled: Scaled,
    /// Current point, always inside the bounds.
    y: Vec<f64>,
    /// `H y + g`.
    gradient: Vec<f64>,
    /// Let go since the factor was last brought up to date.
    released: Vec<bool>,
    /// Newton step, zero where a variable is held.
    step: Vec<f64>,
    /// `H · step`.
    h_step: Vec<f64>,
    /// Multiple of `step` at which a variable meets its bound; infinite where it does not.
    meets: Vec<f64>,
    /// Free variables in the order of `factor`: a released one joins at the end.
    free: Vec<usize>,
    /// Cholesky factor of the free rows and columns, leading dimension n.
    factor: Vec<f64>,
    /// Leading columns of `factor` that are valid for `free`.
    factored: usize,
    /// Right-hand side and solution over the free variables.
    reduced: Vec<f64>,
}

impl QpSolver for PrimalActiveSet {
    /// Starts from the last answer and its working set. `x` is unchanged for `NonFinite`, `InfeasibleBounds`
    /// and `SizeMismatch`, which a problem with rows is; for the other failures it is the best feasible point
    /// that was reached.
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer {
        let loaded = qp.check(self.n, 0).and_then(|()| self.scaled.load(qp));
        if let Err(status) = loaded {
            return QpAnswer::refused(status);
        }
        self.start();
        let mut iterations = 0;
        let end = self.descend(&mut iterations);
        if end == QpStatus::NonFinite {
            return QpAnswer { iterations, ..QpAnswer::refused(end) };
        }
        self.scaled.unscale(qp, &mut self.y);
        let mut answer = QpAnswer::judged(qp, &self.y, &[], iterations, QpStatus::Inaccurate);
        if answer.status != QpStatus::NonFinite {
            self.x.copy_from_slice(&self.y);
            if end != QpStatus::Solved {
                answer.status = end;
            }
        }
        answer
    }

    fn x(&self) -> &[f64] {
        &self.x
    }

    fn multipliers(&self) -> &[f64] {
        &[]
    }
}

impl PrimalActiveSet {
    /// Space for problems in `n` variables. The first solve starts from `clamp(0)`, nothing held.
    #[must_use]
    pub fn new(n: usize) -> Self {
        let zeros = || vec![0.0; n];
        Self {
            n,
            iteration_limit: PASSES_PER_VARIABLE.saturating_mul(u32::try_from(n.max(1)).unwrap_or(u32::MAX)),
            x: zeros(),
            side: vec![Side::Free; n],
            scaled: Scaled::new(n),
            y: zeros(),
            gradient: zeros(),
            released: vec![false; n],
            step: zeros(),
            h_step: zeros(),
            meets: zeros(),
            free: Vec::with_capacity(n),
            factor: vec![0.0; n * n],
            factored: 0,
            reduced: zeros(),
        }
    }

    /// Stops after `limit` factorisations instead of [`PASSES_PER_VARIABLE`] times n.
    #[must_use]
    pub fn with_iteration_limit(mut self, limit: u32) -> Self {
        self.iteration_limit = limit;
        self
    }

    /// Begins the next solve at `start`; without effect for another number of variables.
    pub fn set_start(&mut self, start: &WarmStart) {
        if start.x.len() == self.n {
            self.x.copy_from_slice(&start.x);
            self.side.copy_from_slice(&start.side);
        }
    }

    /// Stores where the next solve would begin; without effect for another number of variables.
    pub fn store_start(&self, start: &mut WarmStart) {
        if start.x.len() == self.n {
            start.x.copy_from_slice(&self.x);
            start.side.copy_from_slice(&self.side);
        }
    }

    /// Forgets the last answer and its working set: the next solve starts cold.
    pub fn reset(&mut self) {
        self.x.fill(0.0);
        self.side.fill(Side::Free);
    }

    /// Puts `y` where the last solve ended, as far as the new bounds allow.
    fn start(&mut self) {
        let Scaled { inverse_s, lower, upper, .. } = &self.scaled;
        let bounds = lower.iter().zip(upper);
        let last = self.x.iter().zip(inverse_s);
        self.released.fill(false);
        self.free.clear();
        self.factored = 0;
        for (((y, side), (x, inverse_s)), (&lower, &upper)) in
            self.y.iter_mut().zip(&mut self.side).zip(last).zip(bounds)
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
        self.free.extend((0..self.n).filter(|&i| self.side[i] == Side::Free));
    }

    /// The active-set loop. `Solved` means that it found the right working set.
    fn descend(&mut self, iterations: &mut u32) -> QpStatus {
        self.update_gradient();
        if !self.gradient.iter().all(|q| q.is_finite()) {
            return QpStatus::NonFinite;
        }
        let mut corrections = 0;
        loop {
            if *iterations >= self.iteration_limit {
                return QpStatus::IterationLimit;
            }
            *iterations += 1;
            if !self.update_factor() {
                return QpStatus::NotPositiveDefinite;
            }
            self.newton_step();
            if !self.follow_step() {
                continue;
            }
            self.update_gradient();
            if self.release() {
                continue;
            }
            // One step of iterative refinement: same factor, gradient fresh from the data. On an
            // ill-conditioned face it can reach a bound, which then has to be held like any other.
            self.newton_step();
            if corrections == CORRECTION_LIMIT {
                self.add_whole_step();
                return QpStatus::Solved;
            }
            if self.follow_step() {
                return QpStatus::Solved;
            }
            corrections += 1;
        }
    }

    /// `gradient = H y + g`, from the data every time: running updates would keep their rounding.
    fn update_gradient(&mut self) {
        self.gradient.copy_from_slice(&self.scaled.g);
        linalg::add_mat_vec(&mut self.gradient, &self.scaled.h, self.n, &self.y);
    }

    /// Lets go of every bound whose multiplier has the wrong sign; `false` if there is none.
    fn release(&mut self) -> bool {
        // Below this a multiplier is rounding of the gradient.
        let size = linalg::max_abs(&self.scaled.g).max(linalg::max_abs(&self.y));
        let tolerance = self.n as f64 * f64::EPSILON * size;
        let Scaled { lower, upper, .. } = &self.scaled;
        let bounds = lower.iter().zip(upper);
        let held = self.side.iter_mut().zip(&mut self.released);
        let mut any = false;
        for (((side, released), q), (lower, upper)) in held.zip(&self.gradient).zip(bounds) {
            let held_back = match side {
                Side::Free => false,
                Side::Lower => *q < -tolerance,
                Side::Upper => *q > tolerance,
            };
            if held_back && lower < upper {
                *side = Side::Free;
                *released = true;
                any = true;
            }
        }
        any
    }

    /// Brings `free` and its factor up to date with the working set.
    ///
    /// Columns left of the first change keep their values: a variable that is held takes its row with
    /// it, a released one adds a row, and only the columns from there on are factored again.
    fn update_factor(&mut self) -> bool {
        let n = self.n;
        let old = self.free.len();
        let kept = self.free.iter().position(|&i| self.side[i] != Side::Free).unwrap_or(old);
        self.factored = self.factored.min(kept);
        let mut m = kept;
        for row in kept..old {
            let i = self.free[row];
            if self.side[i] == Side::Free {
                self.free[m] = i;
                for column in self.factor.chunks_exact_mut(n.max(1)).take(self.factored) {
                    column[m] = column[row];
                }
                m += 1;
            }
        }
        self.free.truncate(m);
        for i in 0..n {
            if self.released[i] {
                self.append_row(i);
                self.released[i] = false;
            }
        }
        let m = self.free.len();
        for (c, &j) in self.free.iter().enumerate().skip(self.factored) {
            let from = &self.scaled.h[j * n..][..n];
            let to = &mut self.factor[c * n..][c..m];
            for (to, &i) in to.iter_mut().zip(&self.free[c..]) {
                *to = from[i];
            }
        }
        let definite = linalg::cholesky_resume_in_place(&mut self.factor, self.factored, m, n);
        self.factored = m;
        definite
    }

    /// Adds variable i to `free` and its row to the factored columns: `L row_i = H_Fi`.
    fn append_row(&mut self, i: usize) {
        let n = self.n;
        let row = self.free.len();
        let entries = &mut self.reduced[..self.factored];
        for (entry, &j) in entries.iter_mut().zip(&self.free) {
            *entry = self.scaled.h[j + i * n];
        }
        linalg::solve_lower_in_place(&self.factor, self.factored, n, entries);
        for (column, entry) in self.factor.chunks_exact_mut(n.max(1)).zip(entries) {
            column[row] = *entry;
        }
        self.free.push(i);
    }

    /// `step_F = −H_FF⁻¹ gradient_F`, zero elsewhere.
    fn newton_step(&mut self) {
        let m = self.free.len();
        let reduced = &mut self.reduced[..m];
        for (r, &i) in reduced.iter_mut().zip(&self.free) {
            *r = -self.gradient[i];
        }
        linalg::solve_lower_in_place(&self.factor, m, self.n, reduced);
        linalg::solve_lower_transposed_in_place(&self.factor, m, self.n, reduced);
        self.step.fill(0.0);
        for (r, &i) in reduced.iter().zip(&self.free) {
            self.step[i] = *r;
        }
    }

    /// Adds the step; the clamp takes back no more than rounding.
    fn add_whole_step(&mut self) {
        let bounds = self.scaled.lower.iter().zip(&self.scaled.upper);
        for ((y, d), (lower, upper)) in self.y.iter_mut().zip(&self.step).zip(bounds) {
            *y = (*y + d).max(*lower).min(*upper);
        }
    }

    /// Follows the bent step to the first minimum of the objective on it, and holds the variables that
    /// met a bound. `true` if the whole step fits: `y` is then the minimiser for its working set. Also
    /// if nothing is left to gain but rounding, so that no pass leaves everything as it was.
    fn follow_step(&mut self) -> bool {
        let Scaled { h, lower, upper, .. } = &self.scaled;
        let mut nearest = f64::INFINITY;
        let bounds = lower.iter().zip(upper);
        for (((t, d), y), (lower, upper)) in self.meets.iter_mut().zip(&self.step).zip(&self.y).zip(bounds) {
            let room = if *d > 0.0 { upper - y } else { lower - y };
            *t = if *d == 0.0 { f64::INFINITY } else { room / d };
            nearest = nearest.min(*t);
        }
        if nearest >= 1.0 {
            self.add_whole_step();
            return true;
        }
        self.h_step.fill(0.0);
        linalg::add_mat_vec(&mut self.h_step, h, self.n, &self.step);
        let mut t = 0.0;
        let mut met_any = false;
        // Each turn but the last holds one more variable.
        for _ in 0..=self.free.len() {
            let slope = linalg::dot(&self.gradient, &self.step);
            let curvature = linalg::dot(&self.step, &self.h_step);
            if slope >= 0.0 || curvature <= 0.0 {
                return !met_any;
            }
            let minimum = t - slope / curvature;
            let mut met = None;
            let mut t_next = minimum;
            for (i, &t_i) in self.meets.iter().enumerate() {
                if t_i < t_next {
                    (met, t_next) = (Some(i), t_i);
                }
            }
            // A degenerate bound is met at t = 0; rounding may say a little earlier.
            let dt = (t_next - t).max(0.0);
            linalg::add_scaled(&mut self.y, dt, &self.step);
            linalg::add_scaled(&mut self.gradient, dt, &self.h_step);
            let Some(i) = met else { break };
            met_any = true;
            t = t.max(t_next);
            let d = self.step[i];
            (self.side[i], self.y[i]) =
                if d > 0.0 { (Side::Upper, upper[i]) } else { (Side::Lower, lower[i]) };
            self.step[i] = 0.0;
            self.meets[i] = f64::INFINITY;
            linalg::add_scaled(&mut self.h_step, -d, &h[i * self.n..][..self.n]);
        }
        false
    }
}
