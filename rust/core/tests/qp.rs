//! The box QP: optimality on every answer, agreement with two independent solvers, and total behaviour.

#![allow(clippy::expect_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]
#![allow(clippy::cast_possible_truncation, reason = "numbers of variables are below 65")]

use crate::common::{assert_within, normal, rng};
use flight_core::qp::{
    ClarabelSolver, KKT_TOLERANCE, PASSES_PER_VARIABLE, PrimalActiveSet, QpProblem, QpSolver, QpStatus,
    kkt_residual,
};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;

/// Variables of the momentum QP in flight: 4 thrust rates, 23 joint velocities.
const FLIGHT: usize = 27;
const JETS: usize = 4;

fn log_uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    (rng.random_range(low.ln()..high.ln())).exp()
}

/// A problem like the momentum QP: momentum task (6 rows, weight 10), angular-momentum task (3 rows,
/// weight 150), posture and regularisation. `push` is how far the tasks want to go, in bound ranges.
fn flight_problem(rng: &mut ChaCha8Rng, push: f64) -> QpProblem {
    let jet = |j: usize| j < JETS;
    let momentum = DMatrix::from_fn(6, FLIGHT, |_, j| {
        normal(rng) * if jet(j) { 1.0 } else { log_uniform(rng, 100.0, 1000.0) }
    });
    let angular =
        DMatrix::from_fn(
            3,
            FLIGHT,
            |_, j| if jet(j) { 0.0 } else { normal(rng) * log_uniform(rng, 0.01, 2.0) },
        );
    let mut h = 10.0 * momentum.tr_mul(&momentum) + 150.0 * angular.tr_mul(&angular);
    for j in 0..FLIGHT {
        h[(j, j)] += 1e-4 + if jet(j) { 0.01 } else { 13.75 };
    }
    let wanted = DVector::from_fn(FLIGHT, |j, _| push * normal(rng) * if jet(j) { 20.0 } else { 0.2 });
    let posture = DVector::from_fn(FLIGHT, |j, _| if jet(j) { 0.0 } else { 2.0 * push * normal(rng) });
    let g = -10.0 * momentum.tr_mul(&(&momentum * wanted)) + posture;
    let mut side = |j: usize| {
        if jet(j) {
            100.0 * rng.random_range(0.2..2.0_f64).tanh()
        } else {
            45_f64.to_radians() * rng.random_range(0.0..2.5_f64).tanh()
        }
    };
    let lower = DVector::from_fn(FLIGHT, |j, _| -side(j));
    let upper = DVector::from_fn(FLIGHT, |j, _| side(j));
    QpProblem::without_rows(0.5 * (&h + h.transpose()), g, lower, upper)
}

/// A problem with eigenvalues spread over `1/condition .. 1` and units over `1e-3 .. 1e3`.
fn spectrum_problem(rng: &mut ChaCha8Rng, n: usize, condition: f64, push: f64) -> QpProblem {
    let q = DMatrix::from_fn(n, n, |_, _| normal(rng)).qr().q();
    let eigenvalues = DVector::from_fn(n, |_, _| log_uniform(rng, 1.0 / condition, 1.0 + 1e-9));
    let units = DVector::from_fn(n, |_, _| log_uniform(rng, 1e-3, 1e3));
    let root = DMatrix::from_diagonal(&units.map(f64::recip)) * q;
    let h = &root * DMatrix::from_diagonal(&eigenvalues) * root.transpose();
    let h = 0.5 * (&h + h.transpose());
    let wanted = DVector::from_fn(n, |i, _| push * units[i] * normal(rng));
    let g = -(&h * wanted);
    let lower = DVector::from_fn(n, |i, _| -units[i] * rng.random_range(0.0..1.0));
    let upper = DVector::from_fn(n, |i, _| units[i] * rng.random_range(0.0..1.0));
    QpProblem::without_rows(h, g, lower, upper)
}

/// Fixes some variables, some of them but for a billionth of their range, frees some sides, and lets some bounds
/// touch the start `clamp(0)`.
fn make_awkward(rng: &mut ChaCha8Rng, qp: &mut QpProblem) {
    for i in 0..qp.len() {
        match rng.random_range(0..8) {
            0 => qp.lower[i] = qp.upper[i],
            1 => qp.lower[i] = f64::NEG_INFINITY,
            2 => qp.upper[i] = f64::INFINITY,
            3 => (qp.lower[i], qp.upper[i]) = (f64::NEG_INFINITY, f64::INFINITY),
            4 => qp.lower[i] = 0.0,
            5 => qp.upper[i] = 0.0,
            6 => qp.upper[i] = qp.lower[i] + 1e-9 * (qp.upper[i] - qp.lower[i]),
            _ => {}
        }
    }
}

/// Largest difference in units of the bound range.
fn difference(qp: &QpProblem, a: &[f64], b: &[f64]) -> f64 {
    let ranges = qp.upper.iter().zip(qp.lower.iter()).map(|(u, l)| u - l);
    a.iter().zip(b).zip(ranges).map(|((a, b), range)| (a - b).abs() / range).fold(0.0, f64::max)
}

/// Solves cold and checks everything that must hold for any solvable problem; returns `x`, the
/// iterations and the number of active bounds.
#[track_caller]
fn solve(qp: &QpProblem) -> (Vec<f64>, u32, u32) {
    let mut solver = PrimalActiveSet::new(qp.len());
    let answer = solver.solve(qp);
    let x = solver.x();
    assert_eq!(answer.status, QpStatus::Solved, "{answer:?}");
    assert!(answer.kkt <= KKT_TOLERANCE && answer.kkt == kkt_residual(qp, x, &[]), "{answer:?}");
    for (x, (lower, upper)) in x.iter().zip(qp.lower.iter().zip(qp.upper.iter())) {
        assert!(lower <= x && x <= upper, "{lower} <= {x} <= {upper}");
    }
    (x.to_vec(), answer.iterations, answer.active)
}

#[test]
fn flight_problems_are_solved_from_calm_to_fully_saturated() {
    let mut rng = rng(1);
    for (push, fewest, most) in [(0.1, 0.0, 2.0), (1.0, 0.5, 5.0), (4.0, 12.0, 20.0), (20.0, 24.0, 27.0)] {
        let mut active = 0.0;
        let count = 1500;
        for _ in 0..count {
            let (_, iterations, on_bounds) = solve(&flight_problem(&mut rng, push));
            // Far below the limit: it is a guard, not a working point.
            assert!(iterations <= 4 * FLIGHT as u32, "{iterations}");
            active += f64::from(on_bounds) / f64::from(count);
        }
        // The generator must visit what the name of the test says.
        assert!((fewest..=most).contains(&active), "push {push}: {active} bounds active");
    }
}

#[test]
fn ill_conditioned_problems_of_every_size_are_solved() {
    let mut rng = rng(2);
    for n in [1, 2, 3, 7, 16, 23, 33, 64] {
        for condition in [1e1, 1e4, 1e7, 1e10] {
            for round in 0..40 {
                let push = [0.1, 1.0, 5.0][round % 3];
                solve(&spectrum_problem(&mut rng, n, condition, push));
            }
        }
    }
}

#[test]
fn fixed_unbounded_and_touching_variables_are_solved() {
    let mut rng = rng(3);
    for round in 0..3000 {
        let mut qp = if round % 2 == 0 {
            flight_problem(&mut rng, 2.0)
        } else {
            let n = rng.random_range(1..30);
            spectrum_problem(&mut rng, n, 1e6, 1.0)
        };
        make_awkward(&mut rng, &mut qp);
        let (x, _, _) = solve(&qp);
        for i in (0..qp.len()).filter(|&i| qp.lower[i] == qp.upper[i]) {
            assert_eq!(x[i], qp.lower[i]);
        }
    }
}

/// Moves the unconstrained minimiser to a face, edge or corner of the box, where every multiplier is
/// zero and it is a matter of rounding which bounds are held; returns it.
fn put_minimiser_on_bounds(rng: &mut ChaCha8Rng, qp: &mut QpProblem) -> DVector<f64> {
    let minimiser = DVector::from_fn(qp.len(), |i, _| match rng.random_range(0..3) {
        0 => qp.lower[i],
        1 => qp.upper[i],
        _ => 0.5 * (qp.lower[i] + qp.upper[i]),
    });
    qp.g = -(&qp.h * &minimiser);
    minimiser
}

#[test]
fn bounds_with_zero_multipliers_do_not_cycle() {
    let mut rng = rng(4);
    for _ in 0..2000 {
        let n = rng.random_range(2..28);
        let mut qp = spectrum_problem(&mut rng, n, 1e5, 1.0);
        let minimiser = put_minimiser_on_bounds(&mut rng, &mut qp);
        let (x, iterations, _) = solve(&qp);
        assert!(difference(&qp, &x, minimiser.as_slice()) < 1e-9);
        assert!(iterations <= 2 * n as u32, "{iterations} for n = {n}");
    }
}

#[test]
fn a_bound_reached_by_the_refinement_is_held() {
    let mut rng = rng(18);
    for _ in 0..20_000 {
        let n = rng.random_range(2..8);
        let mut qp = spectrum_problem(&mut rng, n, 1e11, 1.0);
        put_minimiser_on_bounds(&mut rng, &mut qp);
        // The minimiser is uncertain by 1e-5 of the range here; the residual is not.
        solve(&qp);
    }
}

/// The minimiser by trying every one of the 3ⁿ working sets.
fn solve_by_enumeration(qp: &QpProblem) -> DVector<f64> {
    let n = qp.len();
    let mut best = (f64::INFINITY, DVector::zeros(n));
    for code in 0..3_usize.pow(n as u32) {
        let digit = |i: usize| code / 3_usize.pow(i as u32) % 3;
        // Held variables get a unit row; free ones keep theirs.
        let mut a = DMatrix::identity(n, n);
        let mut b = DVector::zeros(n);
        for i in 0..n {
            match digit(i) {
                0 => {
                    a.set_row(i, &qp.h.row(i));
                    b[i] = -qp.g[i];
                }
                1 => b[i] = qp.lower[i],
                _ => b[i] = qp.upper[i],
            }
        }
        if b.iter().any(|v| v.is_infinite()) {
            continue;
        }
        let x = a.lu().solve(&b).expect("a definite block with unit rows is regular");
        let inside = (0..n).all(|i| {
            let slack = 1e-12 * (1.0 + x[i].abs());
            qp.lower[i] - slack <= x[i] && x[i] <= qp.upper[i] + slack
        });
        let objective = qp.objective(x.as_slice());
        if inside && objective < best.0 {
            best = (objective, x);
        }
    }
    best.1
}

#[test]
fn tiny_problems_agree_with_enumeration() {
    let mut rng = rng(5);
    for n in 1..=5 {
        for round in 0..120 {
            let mut qp = spectrum_problem(&mut rng, n, 1e3, 1.5);
            if round % 2 == 0 {
                make_awkward(&mut rng, &mut qp);
            }
            let (x, _, _) = solve(&qp);
            let expected = solve_by_enumeration(&qp);
            for i in 0..n {
                let scale = expected[i].abs() + qp.h[(i, i)].sqrt().recip();
                assert_within!((x[i] - expected[i]).abs(), 1e-10 * scale, "{x:?} is not {expected}");
            }
        }
    }
}

#[test]
fn polished_clarabel_is_a_certified_fallback() {
    let mut rng = rng(7);
    let mut clarabel = ClarabelSolver::new(FLIGHT, 0);
    for round in 0..160 {
        let mut qp = flight_problem(&mut rng, [0.1, 1.0, 3.0, 10.0][round % 4]);
        if round % 2 == 0 {
            make_awkward(&mut rng, &mut qp);
        }
        let answer = clarabel.solve(&qp);
        assert_eq!(answer.status, QpStatus::Solved, "{answer:?}");
        assert_eq!(answer.kkt, kkt_residual(&qp, clarabel.x(), &[]));
        if round % 2 == 1 {
            assert!(difference(&qp, &solve(&qp).0, clarabel.x()) < 1e-9);
        }
    }
}

/// `g = λ − H x*` in small integers and dyadic fractions, so that the data are exact in double
/// precision and `x*` is the exact answer. What is left is the rounding of `H x + g` times the condition
/// number of the scaled `H` (1e6 here): no solver in double precision does better.
#[test]
fn the_exact_answer_is_found_to_1e_9_of_the_range() {
    let mut rng = rng(8);
    for _ in 0..1000 {
        let jet = |j: usize| j < JETS;
        let rows = DMatrix::from_fn(9, FLIGHT, |i, j| match (i < 6, jet(j)) {
            (true, false) => f64::from(rng.random_range(-1000..=1000)),
            (false, true) => 0.0,
            (true, true) | (false, false) => f64::from(rng.random_range(-64..=64)) / 32.0,
        });
        let weights = DMatrix::from_diagonal(&DVector::from_fn(9, |i, _| if i < 6 { 10.0 } else { 150.0 }));
        let mut h = rows.transpose() * weights * &rows;
        for j in 0..FLIGHT {
            h[(j, j)] += if jet(j) { 1.0 / 128.0 } else { 13.75 };
        }
        let range = |j: usize| if jet(j) { 64.0 } else { 0.5 };
        let mut exact = DVector::from_fn(FLIGHT, |j, _| range(j) * f64::from(rng.random_range(-7..=7)) / 8.0);
        let mut multiplier = DVector::zeros(FLIGHT);
        for j in 0..FLIGHT {
            if rng.random_bool(0.3) {
                let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
                exact[j] = side * range(j);
                multiplier[j] = -side * f64::from(rng.random_range(0..=8)) * if jet(j) { 0.25 } else { 16.0 };
            }
        }
        let g = &multiplier - &h * &exact;
        let (lower, upper) =
            (DVector::from_fn(FLIGHT, |j, _| -range(j)), DVector::from_fn(FLIGHT, |j, _| range(j)));
        let qp = QpProblem::without_rows(h, g, lower, upper);
        assert_eq!(&qp.h * &exact + &qp.g, multiplier, "the construction must be exact");
        let (x, _, _) = solve(&qp);
        let error = difference(&qp, &x, exact.as_slice());
        assert!(error <= 1e-9, "{error:e} of the range");
    }
}

#[test]
fn every_pass_lowers_the_objective() {
    let mut rng = rng(9);
    let mut longest = 0;
    for round in 0..300 {
        let mut qp = flight_problem(&mut rng, [1.0, 3.0, 8.0][round % 3]);
        if round % 2 == 0 {
            make_awkward(&mut rng, &mut qp);
        }
        let (x, iterations, _) = solve(&qp);
        let minimum = qp.objective(&x);
        longest = longest.max(iterations);
        let mut last = f64::INFINITY;
        for limit in 0..iterations {
            let mut solver = PrimalActiveSet::new(FLIGHT).with_iteration_limit(limit);
            let answer = solver.solve(&qp);
            assert_eq!((answer.status, answer.iterations), (QpStatus::IterationLimit, limit));
            let now = qp.objective(solver.x());
            let rounding = 1e-13 * (1.0 + now.abs().max(minimum.abs()));
            // A pass may stand still only to hold a variable that already touches its bound.
            assert!(now <= last + rounding && now >= minimum - rounding, "{last} -> {now}, least {minimum}");
            last = now;
        }
    }
    assert!(longest > 20, "no problem of this test took more than {longest} passes");
}

#[test]
fn the_start_does_not_change_the_answer() {
    let mut rng = rng(10);
    let mut solver = PrimalActiveSet::new(FLIGHT);
    for round in 0..2000 {
        // Neighbouring rounds have nothing in common, so every warm start is wrong.
        let mut qp = flight_problem(&mut rng, [0.1, 20.0, 2.0][round % 3]);
        let awkward = round % 4 == 0;
        if awkward {
            // A bound that was held may be gone.
            make_awkward(&mut rng, &mut qp);
        }
        let answer = solver.solve(&qp);
        assert_eq!(answer.status, QpStatus::Solved, "{answer:?}");
        // Without bounds there is no range to measure by, and the certificate has to do.
        assert!(awkward || difference(&qp, solver.x(), &solve(&qp).0) < 2e-9);
        if round % 10 == 0 {
            solver.reset();
            solver.solve(&qp);
            assert_eq!(solver.x(), solve(&qp).0, "a reset solver is a new one");
        }
    }
}

#[test]
fn slowly_varying_problems_take_one_pass() {
    let mut rng = rng(11);
    let (a, b) = (flight_problem(&mut rng, 2.0), flight_problem(&mut rng, 2.0));
    let mut solver = PrimalActiveSet::new(FLIGHT);
    let mut passes = 0;
    let mut active = 0;
    let ticks = 2000_u32;
    for tick in 0..ticks {
        let s = f64::from(tick) / f64::from(ticks);
        let qp = QpProblem::without_rows(
            &a.h * (1.0 - s) + &b.h * s,
            &a.g * (1.0 - s) + &b.g * s,
            &a.lower * (1.0 - s) + &b.lower * s,
            &a.upper * (1.0 - s) + &b.upper * s,
        );
        let answer = solver.solve(&qp);
        assert_eq!(answer.status, QpStatus::Solved);
        passes += answer.iterations;
        active += answer.active;
    }
    assert!(active > ticks, "only {active} active bounds in {ticks} ticks");
    assert!(f64::from(passes) <= 1.05 * f64::from(ticks), "{passes} passes in {ticks} ticks");
    // The same problem again: one pass to confirm.
    solver.solve(&b);
    assert_eq!(solver.solve(&b).iterations, 1);
}

#[test]
fn other_units_give_the_same_bits() {
    let mut rng = rng(12);
    for _ in 0..200 {
        let qp = flight_problem(&mut rng, 2.0);
        let unit = DVector::from_fn(FLIGHT, |_, _| 2_f64.powi(rng.random_range(-12..12)));
        let other = QpProblem::without_rows(
            DMatrix::from_fn(FLIGHT, FLIGHT, |i, j| qp.h[(i, j)] / (unit[i] * unit[j])),
            qp.g.component_div(&unit),
            qp.lower.component_mul(&unit),
            qp.upper.component_mul(&unit),
        );
        let x = DVector::from_vec(solve(&qp).0).component_mul(&unit);
        assert_eq!(solve(&other).0, x.as_slice());
    }
}

#[test]
fn the_certificate_sees_small_errors_of_every_kind() {
    let mut rng = rng(13);
    for _ in 0..300 {
        let qp = spectrum_problem(&mut rng, 12, 1e3, 1.0);
        let (x, _, _) = solve(&qp);
        for i in 0..12 {
            for step in [-1e-6, 1e-6] {
                let mut wrong = x.clone();
                // On a bound this is infeasible one way and not optimal the other.
                wrong[i] += step / qp.h[(i, i)].sqrt();
                assert!(kkt_residual(&qp, &wrong, &[]) > KKT_TOLERANCE, "variable {i}, step {step}");
            }
        }
    }
}

#[test]
fn the_certificate_is_its_equation() {
    // H = diag(4, 1), g = (−8, 1), box [0, 1] × [−3, 3]: y = (2 x1, x2), q = (4 x1 − 8, 1 + x2)/(2, 1).
    let qp = QpProblem::without_rows(
        DMatrix::from_diagonal(&DVector::from_vec(vec![4.0, 1.0])),
        DVector::from_vec(vec![-8.0, 1.0]),
        DVector::from_vec(vec![0.0, -3.0]),
        DVector::from_vec(vec![1.0, 3.0]),
    );
    // Minimiser (1, −1): the first multiplier pushes outwards, the second gradient is zero.
    assert_eq!(kkt_residual(&qp, &[1.0, -1.0], &[]), 0.0);
    // x = (1, 0): only r_2 = 1 is left; |g scaled| = 4 is the largest scale.
    assert_eq!(kkt_residual(&qp, &[1.0, 0.0], &[]), 1.0 / 4.0);
    // x = (2, −1): infeasible by 1, that is 2 in y; q_1 = 0, so y_1 = 4 is clamped to 2; scale 4.
    assert_eq!(kkt_residual(&qp, &[2.0, -1.0], &[]), 2.0 / 4.0);
    // x = (0, −1): y_1 − q_1 = 4 is clamped to 2.
    assert_eq!(kkt_residual(&qp, &[0.0, -1.0], &[]), 2.0 / 4.0);
    assert_eq!(qp.objective(&[1.0, -1.0]), -6.5);
    assert!(kkt_residual(&qp, &[1.0], &[]).is_nan());
    assert!(kkt_residual(&qp, &[f64::NAN, 0.0], &[]).is_nan());
    assert!(qp.objective(&[1.0]).is_nan());
}

/// A flight problem with one thing wrong.
fn spoil_problem(spoil: impl Fn(&mut QpProblem)) -> QpProblem {
    let mut qp = flight_problem(&mut rng(14), 1.0);
    spoil(&mut qp);
    qp
}

#[test]
fn bad_problems_are_reported_and_leave_the_solvers_usable() {
    let good = flight_problem(&mut rng(15), 1.0);
    let mut solver = PrimalActiveSet::new(FLIGHT);
    let mut clarabel = ClarabelSolver::new(FLIGHT, 0);
    let expected = solve(&good).0;
    let cases = [
        (QpStatus::NonFinite, spoil_problem(|qp| qp.h[(3, 7)] = f64::NAN)),
        (QpStatus::NonFinite, spoil_problem(|qp| qp.h[(5, 5)] = f64::NAN)),
        (QpStatus::NonFinite, spoil_problem(|qp| qp.h[(5, 5)] = f64::INFINITY)),
        (QpStatus::NonFinite, spoil_problem(|qp| qp.h[(26, 0)] = f64::NEG_INFINITY)),
        (QpStatus::NonFinite, spoil_problem(|qp| qp.g[26] = f64::NAN)),
        (QpStatus::NonFinite, spoil_problem(|qp| qp.g[0] = f64::INFINITY)),
        (QpStatus::NonFinite, spoil_problem(|qp| qp.lower[2] = f64::NAN)),
        (QpStatus::NonFinite, spoil_problem(|qp| qp.upper[2] = f64::NAN)),
        (QpStatus::InfeasibleBounds, spoil_problem(|qp| qp.lower[9] = qp.upper[9] + 1e-9)),
        (
            QpStatus::InfeasibleBounds,
            spoil_problem(|qp| (qp.lower[9], qp.upper[9]) = (f64::INFINITY, f64::INFINITY)),
        ),
        (
            QpStatus::InfeasibleBounds,
            spoil_problem(|qp| (qp.lower[9], qp.upper[9]) = (f64::NEG_INFINITY, f64::NEG_INFINITY)),
        ),
        (QpStatus::NotPositiveDefinite, spoil_problem(|qp| qp.h[(8, 8)] = 0.0)),
        (QpStatus::NotPositiveDefinite, spoil_problem(|qp| qp.h[(8, 8)] *= -1.0)),
        (
            QpStatus::NotPositiveDefinite,
            spoil_problem(|qp| {
                let off = 1.1 * (qp.h[(8, 8)] * qp.h[(2, 2)]).sqrt();
                (qp.h[(8, 2)], qp.h[(2, 8)]) = (off, off);
            }),
        ),
        (QpStatus::SizeMismatch, QpProblem::new(FLIGHT - 1, 0)),
        (QpStatus::SizeMismatch, spoil_problem(|qp| qp.h = DMatrix::identity(FLIGHT, FLIGHT - 1))),
        (QpStatus::SizeMismatch, spoil_problem(|qp| qp.upper = DVector::zeros(3))),
    ];
    for (status, bad) in &cases {
        solver.reset();
        solver.solve(&good);
        let before = solver.x().to_vec();
        assert_eq!(solver.solve(bad).status, *status);
        assert!(solver.x().iter().all(|x| x.is_finite()));
        if *status != QpStatus::NotPositiveDefinite {
            assert_eq!(solver.x(), before);
        }
        assert_eq!(solver.solve(&good).status, QpStatus::Solved, "after {status:?}");
        assert!(difference(&good, solver.x(), &expected) < 2e-9);
        assert_eq!(clarabel.solve(bad).status, *status);
        assert_eq!(clarabel.solve(&good).status, QpStatus::Solved, "after {status:?}");
    }
}

#[test]
fn random_garbage_never_panics_and_is_never_called_solved_unjustly() {
    let mut rng = rng(16);
    let special = [0.0, -0.0, 1.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 1e-310];
    let mut statuses = std::collections::HashSet::new();
    for _ in 0..20_000 {
        let n = rng.random_range(0..5);
        let mut qp = spectrum_problem(&mut rng, n, 10.0, 1.0);
        for _ in 0..rng.random_range(0..3) {
            if n > 0 {
                let value = special[rng.random_range(0..special.len())];
                let (i, j) = (rng.random_range(0..n), rng.random_range(0..n));
                match rng.random_range(0..4) {
                    0 => (qp.h[(i, j)], qp.h[(j, i)]) = (value, value),
                    1 => qp.g[i] = value,
                    2 => qp.lower[i] = value,
                    _ => qp.upper[i] = value,
                }
            }
        }
        let mut solver = PrimalActiveSet::new(n);
        let answer = solver.solve(&qp);
        assert!(solver.x().iter().all(|x| x.is_finite()));
        assert!(answer.iterations <= PASSES_PER_VARIABLE * n.max(1) as u32);
        if answer.status == QpStatus::Solved {
            assert!(kkt_residual(&qp, solver.x(), &[]) <= KKT_TOLERANCE);
        }
        statuses.insert(answer.status);
    }
    for expected in
        [QpStatus::Solved, QpStatus::NonFinite, QpStatus::InfeasibleBounds, QpStatus::NotPositiveDefinite]
    {
        assert!(statuses.contains(&expected), "{expected:?} never came up");
    }
}

#[test]
fn problems_without_bounds_or_variables_are_problems_too() {
    let empty = QpProblem::new(0, 0);
    assert!(empty.is_empty());
    assert_eq!(PrimalActiveSet::new(0).solve(&empty).status, QpStatus::Solved);
    assert_eq!(ClarabelSolver::new(0, 0).solve(&empty).status, QpStatus::Solved);

    let mut rng = rng(17);
    let mut qp = flight_problem(&mut rng, 1.0);
    qp.lower.fill(f64::NEG_INFINITY);
    qp.upper.fill(f64::INFINITY);
    let (x, iterations, active) = solve(&qp);
    assert_eq!((iterations, active), (1, 0));
    let mut clarabel = ClarabelSolver::new(FLIGHT, 0);
    assert_eq!(clarabel.solve(&qp).status, QpStatus::Solved);
    // In units of 1/√H_ii, where the error of a Cholesky solve is rounding times the condition (Higham, Accuracy and
    // Stability of Numerical Algorithms, theorem 10.4; its factor n is that of the worst signs).
    let roots = qp.h.diagonal().map(f64::sqrt);
    let scaled = DMatrix::from_fn(FLIGHT, FLIGHT, |i, j| qp.h[(i, j)] / (roots[i] * roots[j]));
    let direct = scaled.clone().cholesky().expect("definite").solve(&-qp.g.component_div(&roots));
    let eigenvalues = scaled.symmetric_eigenvalues();
    let rounding = f64::EPSILON * eigenvalues.max() / eigenvalues.min() * direct.amax();
    for found in [&x, clarabel.x()] {
        let found = DVector::from_column_slice(found).component_mul(&roots);
        assert_within!((found - &direct).amax(), rounding, "{rounding:e}");
    }

    // Everything fixed: nothing to decide.
    qp.lower.fill(0.25);
    qp.upper.fill(0.25);
    let (x, iterations, active) = solve(&qp);
    assert_eq!((x, iterations, active), (vec![0.25; FLIGHT], 1, FLIGHT as u32));
    assert_eq!(clarabel.solve(&qp).status, QpStatus::Solved);
    assert_eq!(clarabel.x(), vec![0.25; FLIGHT]);
}

/// An answer whose residual is 2e-9 is the minimiser for a linear term that differs in the ninth digit: it is
/// flown. Twice as far as the limit it is refused.
#[test]
fn an_answer_is_accepted_down_to_the_square_root_of_rounding() {
    assert_eq!(KKT_TOLERANCE, f64::EPSILON.sqrt());
    let mut rng = rng(31);
    for _ in 0..50 {
        let qp = flight_problem(&mut rng, 1.0);
        let (x, _, _) = solve(&qp);
        let roots = qp.h.diagonal().map(f64::sqrt);
        let y = DVector::from_vec(x.clone()).component_mul(&roots);
        let size = qp.g.component_div(&roots).amax().max(y.amax()).max(1.0);
        // The variable that is farthest from its bounds, so that no bound hides the change.
        let inside = |i: usize| roots[i] * (x[i] - qp.lower[i]).min(qp.upper[i] - x[i]);
        let i = (0..FLIGHT).max_by(|&a, &b| inside(a).total_cmp(&inside(b))).expect("variables");
        for (change, is_accepted) in [(2e-9, true), (3e-8, false)] {
            let mut near = qp.clone();
            near.g[i] += change * size * roots[i];
            let (y, _, _) = solve(&near);
            let kkt = kkt_residual(&qp, &y, &[]);
            assert_eq!(kkt <= KKT_TOLERANCE, is_accepted, "residual {kkt:e} after a change of {change:e}");
        }
    }
}

#[test]
fn status_codes_are_stable() {
    let codes = [
        (QpStatus::Solved, 0),
        (QpStatus::IterationLimit, 1),
        (QpStatus::NotPositiveDefinite, 2),
        (QpStatus::InfeasibleBounds, 3),
        (QpStatus::NonFinite, 4),
        (QpStatus::Inaccurate, 5),
        (QpStatus::SizeMismatch, 6),
        (QpStatus::Breakdown, 7),
    ];
    for (status, code) in codes {
        assert_eq!(status.code(), code);
    }
}
