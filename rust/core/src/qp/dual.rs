//! A dual active-set method for bounds and general rows (Goldfarb and Idnani, 1983).
//!
//! It starts from the unconstrained minimiser and adds violated constraints one after the other to the active
//! set, keeping all multipliers non-negative. Each intermediate point is the minimiser for its active set,
//! and the objective increases from one to the next. So no active set recurs and the method terminates, even
//! at degenerate corners, where steps in the dual variables alone remove constraints.
//!
//! With `H = L Lᵀ` and the active normals `N`, it keeps `J = L⁻ᵀ Q` and the triangle R of `Jᵀ N = (R; 0)`:
//! the first columns of J span the directions fixed by the active set, the others the free ones. Adding a
//! constraint takes one reflection of the free columns; removing one takes rotations of the others.
//!
//! At our condition numbers the iteration loses digits. The final active set is therefore solved again from
//! the data, with iterative refinement until the residual no longer decreases, before the certificate is
//! evaluated.

use super::scaled::Scaled;
use super::{QpAnswer, QpProblem, QpSolver, QpStatus};
use crate::linalg;

/// Limit of changes of the active set per constraint and variable. A calm tick needs one for each active
/// constraint.
const CHANGES_PER_CONSTRAINT: usize = 6;

/// Relative size above which a violation counts; below it is rounding.
const VIOLATION: f64 = 1e-12;

/// Limit of refinements of the final point; two reach rounding error on our problems.
const CORRECTIONS: usize = 3;

/// Limit of rounds in which the corrected point shows another violated constraint or a negative multiplier.
const ROUNDS: usize = 4;

/// The method for standing: exact, without allocation after [`DualActiveSet::new`].
///
/// Works in `y_i = x_i / s_i` with powers of two `s_i ≈ 1/√H_ii`, as the box solver does.
#[derive(Debug, Clone)]
pub struct DualActiveSet {
    n: usize,
    rows: usize,
    x: Vec<f64>,
    multipliers: Vec<f64>,
    scaled: Scaled,
    /// Scaled normals of the rows, n entries each.
    normals: Vec<f64>,
    /// Length of each scaled normal; zero for a row of zeros.
    lengths: Vec<f64>,
    limits: Vec<f64>,
    factor: Vec<f64>,
    /// `J`, column-major, n entries each.
    j: Vec<f64>,
    /// `R`, column-major; column k starts with its k + 1 entries.
    r: Vec<f64>,
    active: Vec<Constraint>,
    pressure: Vec<f64>,
    y: Vec<f64>,
    d: Vec<f64>,
    step: Vec<f64>,
    dual_step: Vec<f64>,
    work: Vec<f64>,
    is_active: Vec<bool>,
}

/// One inequality `normal · y ≤ limit`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Constraint {
    /// `−y_i ≤ −lower_i`
    Lower(usize),
    /// `y_i ≤ upper_i`
    Upper(usize),
    /// Row k.
    Row(usize),
}

/// Outcome of an attempt to add a constraint.
enum Added {
    Yes,
    Infeasible,
    OutOfChanges,
    NotFinite,
}

impl QpSolver for DualActiveSet {
    /// Solves from scratch. `x` is unchanged unless the status is `Solved` or `Inaccurate`.
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer {
        let loaded = qp.check(self.n, self.rows).and_then(|()| self.load(qp));
        if let Err(status) = loaded {
            return QpAnswer::from_status(status);
        }
        let limit = CHANGES_PER_CONSTRAINT * (self.n + self.rows).max(1);
        let mut changes = 0;
        let end = self.ascend(limit, &mut changes);
        let iterations = u32::try_from(changes).unwrap_or(u32::MAX);
        if end != QpStatus::Solved {
            return QpAnswer { iterations, ..QpAnswer::from_status(end) };
        }
        self.scaled.unscale(qp, &self.y, &mut self.work);
        self.multipliers.fill(0.0);
        for (constraint, pressure) in self.active.iter().zip(&self.pressure) {
            if let Constraint::Row(k) = constraint {
                self.multipliers[*k] = pressure.max(0.0);
            }
        }
        let (x, u) = (&self.work, &self.multipliers);
        let answer = QpAnswer::judge(qp, x, u, iterations, QpStatus::Inaccurate);
        if answer.status != QpStatus::NonFinite {
            self.x.copy_from_slice(x);
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

impl DualActiveSet {
    /// Allocates for problems in `n` variables with `rows` inequalities in addition to the bounds.
    #[must_use]
    pub fn new(n: usize, rows: usize) -> Self {
        let zeros = || vec![0.0; n];
        Self {
            n,
            rows,
            x: zeros(),
            multipliers: vec![0.0; rows],
            scaled: Scaled::new(n, n),
            normals: vec![0.0; n * rows],
            lengths: vec![0.0; rows],
            limits: vec![0.0; rows],
            factor: vec![0.0; n * n],
            j: vec![0.0; n * n],
            r: vec![0.0; n * n],
            active: Vec::with_capacity(n + 1),
            pressure: Vec::with_capacity(n + 1),
            y: zeros(),
            d: zeros(),
            step: zeros(),
            dual_step: zeros(),
            work: zeros(),
            is_active: vec![false; 2 * n + rows],
        }
    }

    /// Scales and factorises the problem, and computes the unconstrained minimiser.
    fn load(&mut self, qp: &QpProblem) -> Result<(), QpStatus> {
        let n = self.n;
        self.scaled.load(qp)?;
        for k in 0..self.rows {
            let from = &qp.normals.as_slice()[k * n..][..n];
            let to = &mut self.normals[k * n..][..n];
            for ((to, from), s) in to.iter_mut().zip(from).zip(&self.scaled.s) {
                *to = from * s;
            }
            self.lengths[k] = linalg::dot(to, to).sqrt();
            self.limits[k] = qp.limit[k];
            if !self.lengths[k].is_finite() {
                return Err(QpStatus::NonFinite);
            }
            if self.lengths[k] == 0.0 && self.limits[k] < 0.0 {
                return Err(QpStatus::InfeasibleBounds);
            }
        }
        if !self.scaled.h.iter().chain(&self.scaled.g).all(|entry| entry.is_finite()) {
            return Err(QpStatus::NonFinite);
        }
        self.factor.copy_from_slice(&self.scaled.h);
        if !linalg::cholesky_in_place(&mut self.factor, n, n, n) {
            return Err(QpStatus::NotPositiveDefinite);
        }
        linalg::invert_lower_transposed(&self.factor, n, n, &mut self.j);
        self.active.clear();
        self.pressure.clear();
        self.is_active.fill(false);
        for (y, g) in self.y.iter_mut().zip(&self.scaled.g) {
            *y = -g;
        }
        linalg::solve_lower_in_place(&self.factor, n, n, &mut self.y);
        linalg::solve_lower_transposed_in_place(&self.factor, n, n, &mut self.y);
        Ok(())
    }

    /// Adds violated constraints until none is left and the corrected point agrees.
    fn ascend(&mut self, limit: usize, changes: &mut usize) -> QpStatus {
        for _ in 0..ROUNDS {
            while let Some(constraint) = self.find_most_violated() {
                match self.add(constraint, limit, changes) {
                    Added::Yes => {}
                    Added::Infeasible => return QpStatus::InfeasibleBounds,
                    Added::OutOfChanges => return QpStatus::IterationLimit,
                    Added::NotFinite => return QpStatus::NonFinite,
                }
            }
            self.correct();
            if !self.y.iter().chain(&self.pressure).all(|value| value.is_finite()) {
                return QpStatus::NonFinite;
            }
            if !self.drop_pulling(changes) && self.find_most_violated().is_none() {
                break;
            }
        }
        QpStatus::Solved
    }

    fn index(&self, constraint: Constraint) -> usize {
        match constraint {
            Constraint::Lower(i) => i,
            Constraint::Upper(i) => self.n + i,
            Constraint::Row(k) => 2 * self.n + k,
        }
    }

    /// `limit − normal · y`.
    fn slack(&self, constraint: Constraint) -> f64 {
        match constraint {
            Constraint::Lower(i) => self.y[i] - self.scaled.lower[i],
            Constraint::Upper(i) => self.scaled.upper[i] - self.y[i],
            Constraint::Row(k) => {
                self.limits[k] - linalg::dot(&self.normals[k * self.n..][..self.n], &self.y)
            }
        }
    }

    /// The most violated constraint, by distance in scaled variables.
    fn find_most_violated(&self) -> Option<Constraint> {
        let size = 1.0 + linalg::max_abs(&self.y);
        let mut worst = (VIOLATION * size, None);
        let mut consider = |constraint: Constraint, violation: f64| {
            if violation > worst.0 && !self.is_active[self.index(constraint)] {
                worst = (violation, Some(constraint));
            }
        };
        for i in 0..self.n {
            consider(Constraint::Lower(i), -self.slack(Constraint::Lower(i)));
            consider(Constraint::Upper(i), -self.slack(Constraint::Upper(i)));
        }
        for k in 0..self.rows {
            if self.lengths[k] > 0.0 {
                consider(Constraint::Row(k), -self.slack(Constraint::Row(k)) / self.lengths[k]);
            }
        }
        worst.1
    }

    /// `d = −Jᵀ normal`; the sign converts `normal · y ≤ limit` to the textbook's `≥`.
    fn project_normal(&mut self, constraint: Constraint) {
        let n = self.n;
        match constraint {
            Constraint::Lower(i) => {
                for (column, d) in self.d.iter_mut().enumerate() {
                    *d = self.j[i + column * n];
                }
            }
            Constraint::Upper(i) => {
                for (column, d) in self.d.iter_mut().enumerate() {
                    *d = -self.j[i + column * n];
                }
            }
            Constraint::Row(k) => {
                let normal = &self.normals[k * n..][..n];
                for (column, d) in self.d.iter_mut().enumerate() {
                    *d = -linalg::dot(&self.j[column * n..][..n], normal);
                }
            }
        }
    }

    /// `dual_step = R⁻¹ d₁` over the active set.
    fn solve_triangle(n: usize, r: &[f64], q: usize, right: &[f64], out: &mut [f64]) {
        out[..q].copy_from_slice(&right[..q]);
        for k in (0..q).rev() {
            let column = &r[k * n..][..=k];
            let (head, tail) = out[..=k].split_at_mut(k);
            tail[0] /= column[k];
            linalg::add_scaled(head, -tail[0], &column[..k]);
        }
    }

    /// Adds one constraint, preceded by as many dual steps as necessary.
    fn add(&mut self, constraint: Constraint, limit: usize, changes: &mut usize) -> Added {
        let n = self.n;
        let mut own_pressure = 0.0;
        loop {
            if *changes >= limit {
                return Added::OutOfChanges;
            }
            *changes += 1;
            let q = self.active.len();
            self.project_normal(constraint);
            let free: f64 = linalg::dot(&self.d[q..], &self.d[q..]);
            let whole: f64 = linalg::dot(&self.d, &self.d);
            Self::solve_triangle(n, &self.r, q, &self.d, &mut self.dual_step);
            let rounding = n as f64 * f64::EPSILON;
            let dependent = q == n || free <= rounding * rounding * whole;
            // Step length up to which all multipliers stay non-negative.
            let mut leaving = None;
            let mut dual_limit = f64::INFINITY;
            for (k, (pressure, rate)) in self.pressure.iter().zip(&self.dual_step[..q]).enumerate() {
                if *rate > 0.0 && pressure / rate < dual_limit {
                    (leaving, dual_limit) = (Some(k), pressure / rate);
                }
            }
            let primal_limit = if dependent { f64::INFINITY } else { -self.slack(constraint) / free };
            let t = dual_limit.min(primal_limit);
            if t == f64::INFINITY {
                return Added::Infeasible;
            }
            if !t.is_finite() {
                return Added::NotFinite;
            }
            if !dependent {
                for column in q..n {
                    let d = self.d[column];
                    linalg::add_scaled(&mut self.y, t * d, &self.j[column * n..][..n]);
                }
            }
            for (pressure, rate) in self.pressure.iter_mut().zip(&self.dual_step[..q]) {
                *pressure = (*pressure - t * rate).max(0.0);
            }
            own_pressure += t;
            match leaving {
                Some(k) if dual_limit < primal_limit => self.remove(k),
                _ => {
                    self.reflect(q);
                    let index = self.index(constraint);
                    self.is_active[index] = true;
                    self.active.push(constraint);
                    self.pressure.push(own_pressure);
                    return Added::Yes;
                }
            }
        }
    }

    /// Reflects the free columns of J so that `d` has one entry left among them, which becomes column q of R.
    fn reflect(&mut self, q: usize) {
        let n = self.n;
        let length = linalg::dot(&self.d[q..], &self.d[q..]).sqrt();
        let head = self.d[q];
        let alpha = if head > 0.0 { -length } else { length };
        // v = d₂ − α e₁, H = 1 − 2 v vᵀ / vᵀv.
        self.d[q] = head - alpha;
        let squared = linalg::dot(&self.d[q..], &self.d[q..]);
        if squared > 0.0 {
            self.work.fill(0.0);
            for column in q..n {
                linalg::add_scaled(&mut self.work, self.d[column], &self.j[column * n..][..n]);
            }
            for column in q..n {
                let factor = -2.0 * self.d[column] / squared;
                linalg::add_scaled(&mut self.j[column * n..][..n], factor, &self.work);
            }
        }
        self.d[q] = alpha;
        self.r[q * n..][..=q].copy_from_slice(&self.d[..=q]);
    }

    /// Removes one constraint: its column leaves R, and rotations restore the triangle.
    fn remove(&mut self, k: usize) {
        let n = self.n;
        let q = self.active.len();
        let index = self.index(self.active[k]);
        self.is_active[index] = false;
        self.active.remove(k);
        self.pressure.remove(k);
        for column in k + 1..q {
            let (left, right) = self.r.split_at_mut(column * n);
            left[(column - 1) * n..][..=column].copy_from_slice(&right[..=column]);
        }
        for row in k..q - 1 {
            let (a, b) = (self.r[row + row * n], self.r[row + 1 + row * n]);
            let length = libm::hypot(a, b);
            if length == 0.0 {
                continue;
            }
            let (c, s) = (a / length, b / length);
            for column in row..q - 1 {
                let (x, y) = (self.r[row + column * n], self.r[row + 1 + column * n]);
                self.r[row + column * n] = c * x + s * y;
                self.r[row + 1 + column * n] = c * y - s * x;
            }
            let (left, right) = self.j.split_at_mut((row + 1) * n);
            for (x, y) in left[row * n..].iter_mut().zip(&mut right[..n]) {
                (*x, *y) = (c * *x + s * *y, c * *y - s * *x);
            }
        }
    }

    /// Solves the equations of the active set again, with residuals from the data: `H y + g + Σ u n = 0`,
    /// `n · y = limit`.
    fn correct(&mut self) {
        let n = self.n;
        let q = self.active.len();
        for _ in 0..CORRECTIONS {
            // step ← −(H y + g + Σ u n), work ← residuals of the active constraints.
            for (step, g) in self.step.iter_mut().zip(&self.scaled.g) {
                *step = -g;
            }
            for (column, y) in self.y.iter().enumerate() {
                linalg::add_scaled(&mut self.step, -y, self.scaled.column(column));
            }
            for k in 0..q {
                let pressure = self.pressure[k];
                match self.active[k] {
                    Constraint::Lower(i) => self.step[i] += pressure,
                    Constraint::Upper(i) => self.step[i] -= pressure,
                    Constraint::Row(row) => {
                        linalg::add_scaled(&mut self.step, -pressure, &self.normals[row * n..][..n]);
                    }
                }
                // −normal · dy = −slack in the textbook's sign.
                self.work[k] = -self.slack(self.active[k]);
            }
            // Rᵀ w₁ = work, w₂ = J₂ᵀ step; dy = J w and R du = w₁ − J₁ᵀ step.
            for k in 0..q {
                let column = &self.r[k * n..][..=k];
                let sum = linalg::dot(&column[..k], &self.d[..k]);
                self.d[k] = (self.work[k] - sum) / column[k];
            }
            for k in 0..n {
                let along = linalg::dot(&self.j[k * n..][..n], &self.step);
                if k < q {
                    self.work[k] = self.d[k] - along;
                } else {
                    self.d[k] = along;
                }
            }
            Self::solve_triangle(n, &self.r, q, &self.work, &mut self.dual_step);
            for k in 0..n {
                linalg::add_scaled(&mut self.y, self.d[k], &self.j[k * n..][..n]);
            }
            for (pressure, change) in self.pressure.iter_mut().zip(&self.dual_step[..q]) {
                *pressure += change;
            }
        }
    }

    /// Removes constraints whose corrected multipliers are negative; `false` if there are none.
    fn drop_pulling(&mut self, changes: &mut usize) -> bool {
        let size = linalg::max_abs(&self.pressure).max(1.0);
        let mut any = false;
        let mut k = 0;
        while k < self.active.len() {
            if self.pressure[k] < -VIOLATION * size {
                self.remove(k);
                *changes += 1;
                any = true;
            } else {
                k += 1;
            }
        }
        if any {
            self.correct();
        }
        any
    }
}
