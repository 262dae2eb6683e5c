//! The backward pass of the nonlinear plan of a descent, against the costs of other inputs.

#![allow(clippy::float_cmp, reason = "an input at its bound is equal to it")]

use crate::common::rng;
use flight_core::control::mpc::nonlinear::knot::Expansion;
use flight_core::control::mpc::nonlinear::riccati::Riccati;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;

/// Random linear dynamics and convex quadratic cost of some knots.
fn random_problem(n: usize, m: usize, knots: usize) -> Vec<Expansion> {
    let mut rng = rng(7);
    let mut number = || rng.random_range(-1.0..1.0);
    let w = n + m;
    (0..=knots)
        .map(|_| {
            let mut expansion = Expansion::new(n, m);
            let dynamics =
                DMatrix::from_fn(n, w, |row, column| 0.3 * number() + f64::from(u8::from(row == column)));
            let root = DMatrix::from_fn(w, w, |_, _| number());
            expansion.dynamics.copy_from_slice(dynamics.as_slice());
            expansion.transposed.copy_from_slice(dynamics.transpose().as_slice());
            expansion
                .hessian
                .copy_from_slice((&root * root.transpose() + DMatrix::identity(w, w)).as_slice());
            expansion.gradient.iter_mut().for_each(|value| *value = number());
            expansion
        })
        .collect()
}

/// Cost of a motion that begins without a difference, and its inputs, each changed by `away`.
fn cost_of(
    expansions: &[Expansion],
    (n, m): (usize, usize),
    (steps, gains): (&[f64], &[f64]),
    away: &[f64],
) -> (f64, Vec<f64>) {
    let (mut state, mut cost, mut all) = (DVector::zeros(n), 0.0, Vec::new());
    for (knot, expansion) in expansions.iter().enumerate() {
        let is_last = knot + 1 == expansions.len();
        let mut inputs = DVector::zeros(m);
        if !is_last {
            let gain = DMatrix::from_column_slice(m, n, &gains[knot * m * n..(knot + 1) * m * n]);
            inputs = gain * &state + DVector::from_column_slice(&steps[knot * m..(knot + 1) * m]);
            inputs += DVector::from_column_slice(&away[knot * m..(knot + 1) * m]);
            all.extend(inputs.iter());
        }
        let z = DVector::from_iterator(n + m, state.iter().chain(inputs.iter()).copied());
        let hessian = DMatrix::from_column_slice(n + m, n + m, &expansion.hessian);
        cost += 0.5 * z.dot(&(hessian * &z)) + z.dot(&DVector::from_column_slice(&expansion.gradient));
        state = DMatrix::from_column_slice(n, n + m, &expansion.dynamics) * z;
    }
    (cost, all)
}

/// No other inputs cost less; where inputs are bounded, none within their bounds.
#[test]
fn the_backward_pass_finds_the_least_cost() {
    let (n, m, knots) = (5, 3, 6);
    let expansions = random_problem(n, m, knots);
    let (mut steps, mut gains) = (vec![0.0; knots * m], vec![0.0; knots * m * n]);
    let mut rng = rng(8);
    let free = vec![(-1e6, 1e6); m];
    let known = vec![0.0; knots * m];
    let mut riccati = Riccati::new(n, m);
    assert!(riccati.solve(&expansions, &known, &free, 0.0, (&mut steps, &mut gains)));
    let (least, _) = cost_of(&expansions, (n, m), (&steps, &gains), &known);
    for _ in 0..50 {
        let away: Vec<f64> = known.iter().map(|_| rng.random_range(-0.1..0.1)).collect();
        assert!(cost_of(&expansions, (n, m), (&steps, &gains), &away).0 > least);
    }
    // One knot: a convex QP within a box.
    let (one, bounds) = (&expansions[..2], vec![(-0.05, 0.05); m]);
    let (steps, gains) = (&mut steps[..m], &mut gains[..m * n]);
    assert!(riccati.solve(one, &known[..m], &bounds, 0.0, (&mut *steps, &mut *gains)));
    let (least, inputs) = cost_of(one, (n, m), (steps, gains), &known[..m]);
    assert!(inputs.iter().any(|input| input.abs() == 0.05), "{inputs:?}");
    for _ in 0..200 {
        let away: Vec<f64> = inputs.iter().map(|input| rng.random_range(-0.05..=0.05) - input).collect();
        assert!(cost_of(one, (n, m), (steps, gains), &away).0 >= least - 1e-12);
    }
}
