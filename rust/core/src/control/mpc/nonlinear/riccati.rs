//! The feedback that minimises the expanded cost, backwards from the end, with inputs within bounds.

use super::knot::Expansion;
use crate::linalg;

/// Passes in which inputs are found to lie at their bounds.
const PASSES: usize = 4;

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
    free: Vec<bool>,
    factor: Vec<f64>,
    right: Vec<f64>,
}

impl Riccati {
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
            free: vec![true; m],
            factor: vec![0.0; m * m],
            right: vec![0.0; m],
        }
    }

    /// Computes the feedback along `inputs` by knot: changes of the inputs and their derivatives by the state (m × n);
    /// `false` where the cost is not convex or not finite.
    pub fn solve(
        &mut self,
        expansions: &[Expansion],
        inputs: &[f64],
        bounds: &[(f64, f64)],
        damping: f64,
        (steps, gains): (&mut [f64], &mut [f64]),
    ) -> bool {
        let (n, m) = (self.n, self.m);
        let w = n + m;
        let Some((last, before)) = expansions.split_last() else { return false };
        for column in 0..n {
            self.p[column * n..(column + 1) * n].copy_from_slice(&last.hessian[column * w..column * w + n]);
        }
        self.p_vector.copy_from_slice(&last.gradient[..n]);
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
            if !self.minimise(&inputs[range], bounds, step, gain) {
                return false;
            }
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
        true
    }

    /// Step and gain of a knot from Q and q: inputs that reach their bounds stay there.
    fn minimise(
        &mut self,
        inputs: &[f64],
        bounds: &[(f64, f64)],
        step: &mut [f64],
        gain: &mut [f64],
    ) -> bool {
        let (n, m) = (self.n, self.m);
        let w = n + m;
        let Self { q, q_vector, free, factor, right, .. } = self;
        free.fill(true);
        step.fill(0.0);
        for _ in 0..=PASSES {
            for input in 0..m {
                right[input] = if free[input] {
                    let held = (0..m).filter(|other| !free[*other]);
                    let of_held: f64 = held.map(|other| q[n + input + (n + other) * w] * step[other]).sum();
                    -q_vector[n + input] - of_held
                } else {
                    0.0
                };
                for row in 0..m {
                    factor[row + input * m] = match (free[input], free[row]) {
                        (true, true) => q[n + row + (n + input) * w],
                        _ => f64::from(u8::from(row == input)),
                    };
                }
            }
            if !linalg::cholesky_in_place(factor, m, m, m) {
                return false;
            }
            linalg::solve_lower_in_place(factor, m, m, right);
            linalg::solve_lower_transposed_in_place(factor, m, m, right);
            let mut has_changed = false;
            for input in 0..m {
                if !free[input] {
                    continue;
                }
                let (least, greatest) = bounds[input];
                let wanted = inputs[input] + right[input];
                step[input] = right[input];
                if wanted < least || wanted > greatest {
                    step[input] = wanted.max(least).min(greatest) - inputs[input];
                    free[input] = false;
                    has_changed = true;
                }
            }
            if !has_changed {
                break;
            }
        }
        // The factor may be that of a pass before; inputs held since then have no feedback.
        for column in 0..n {
            for input in 0..m {
                right[input] = if free[input] { -q[n + input + column * w] } else { 0.0 };
            }
            linalg::solve_lower_in_place(factor, m, m, right);
            linalg::solve_lower_transposed_in_place(factor, m, m, right);
            for input in 0..m {
                gain[input + column * m] = if free[input] { right[input] } else { 0.0 };
            }
        }
        gain.iter().chain(step.iter()).all(|value| value.is_finite())
    }
}
