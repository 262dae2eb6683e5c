//! The feedback that minimises the expanded cost, backwards from the end, with inputs within bounds.

use super::knot::Expansion;
use crate::linalg;
use crate::qp::{PrimalActiveSet, QpAnswer, QpProblem, QpSolver, QpStatus};

/// Workspace of the backward pass.
#[derive(Debug)]
pub struct Riccati {
    n: usize,
    m: usize,
    /// P and p of the cost to go.
    p: Vec<f64>,
    p_vector: Vec<f64>,
    /// `P (A B)`, and Q and q of the knot.
    product: Vec<f64>,
    q: Vec<f64>,
    q_vector: Vec<f64>,
    /// The QP of the knot's inputs.
    problem: QpProblem,
    solver: PrimalActiveSet,
}

impl Riccati {
    /// Allocates for `n` states and `m` inputs.
    #[must_use]
    pub fn new(n: usize, m: usize) -> Self {
        Self {
            n,
            m,
            p: vec![0.0; n * n],
            p_vector: vec![0.0; n],
            product: vec![0.0; n * (n + m)],
            q: vec![0.0; (n + m) * (n + m)],
            q_vector: vec![0.0; n + m],
            problem: QpProblem::new(m, 0),
            solver: PrimalActiveSet::new(m),
        }
    }

    /// Computes the feedback along `inputs` by knot: changes of the inputs and their derivatives by the state (m × n). Returns
    /// the worst certificate of the knots' QPs, with all their factorisations; without one that is solved there is no feedback.
    pub fn solve(
        &mut self,
        expansions: &[Expansion],
        inputs: &[f64],
        bounds: &[(f64, f64)],
        damping: f64,
        (steps, gains): (&mut [f64], &mut [f64]),
    ) -> QpAnswer {
        let (n, m) = (self.n, self.m);
        let w = n + m;
        let mut all = QpAnswer { kkt: 0.0, ..QpAnswer::from_status(QpStatus::Solved) };
        let Some((last, before)) = expansions.split_last() else { return all };
        for column in 0..n {
            self.p[column * n..(column + 1) * n].copy_from_slice(&last.hessian[column * w..column * w + n]);
        }
        self.p_vector.copy_from_slice(&last.gradient[..n]);
        self.solver.reset(); // then each knot begins with what the next one holds
        for (knot, expansion) in before.iter().enumerate().rev() {
            self.product.fill(0.0);
            self.q.copy_from_slice(&expansion.hessian);
            self.q_vector.copy_from_slice(&expansion.gradient);
            linalg::add_mat_vec(&mut self.q_vector, &expansion.transposed, w, &self.p_vector);
            linalg::add_mat_mat(&mut self.product, &self.p, n, &expansion.dynamics, w);
            linalg::add_mat_mat(&mut self.q, &expansion.transposed, w, &self.product, w);
            for input in 0..m {
                self.q[(n + input) * (w + 1)] += damping;
            }
            let range = knot * m..(knot + 1) * m;
            let gain = &mut gains[range.start * n..range.end * n];
            let step = &mut steps[range.clone()];
            let answer = self.minimise(&inputs[range], bounds, step, gain);
            all.iterations += answer.iterations;
            all.active += answer.active;
            if answer.status != QpStatus::Solved {
                return QpAnswer { iterations: all.iterations, ..answer };
            }
            all.kkt = all.kkt.max(answer.kkt);
            // P = Q_xx + Q_xu K,  p = q_x + Q_xu k
            let q_xu = &self.q[n * w..];
            for column in 0..n {
                self.p[column * n..(column + 1) * n].copy_from_slice(&self.q[column * w..column * w + n]);
            }
            linalg::add_mat_mat(&mut self.p, q_xu, w, gain, n);
            self.p_vector.copy_from_slice(&self.q_vector[..n]);
            linalg::add_mat_vec(&mut self.p_vector, q_xu, w, step);
            for column in 0..n {
                for row in 0..column {
                    let mean = 0.5 * (self.p[row + column * n] + self.p[column + row * n]);
                    (self.p[row + column * n], self.p[column + row * n]) = (mean, mean);
                }
            }
        }
        all
    }

    /// Step and gain of a knot from Q and q: inputs that are held at their bounds have no feedback.
    fn minimise(
        &mut self,
        inputs: &[f64],
        bounds: &[(f64, f64)],
        step: &mut [f64],
        gain: &mut [f64],
    ) -> QpAnswer {
        let (n, m) = (self.n, self.m);
        let w = n + m;
        let Self { q, q_vector, problem, solver, .. } = self;
        for (input, (value, (least, greatest))) in inputs.iter().zip(bounds).enumerate() {
            problem.g[input] = q_vector[n + input];
            (problem.lower[input], problem.upper[input]) = (least - value, greatest - value);
            for row in 0..=input {
                let entry = q[n + row + (n + input) * w];
                (problem.h[(row, input)], problem.h[(input, row)]) = (entry, entry);
            }
        }
        let answer = solver.solve(problem);
        if answer.status != QpStatus::Solved {
            return answer;
        }
        step.copy_from_slice(solver.x());
        for (column, gain) in gain.chunks_exact_mut(m).enumerate() {
            for (gain, by) in gain.iter_mut().zip(&q[n + column * w..(column + 1) * w]) {
                *gain = -by;
            }
            solver.solve_free(gain);
        }
        let is_finite = gain.iter().all(|value| value.is_finite());
        if is_finite { answer } else { QpAnswer::from_status(QpStatus::NonFinite) }
    }
}
