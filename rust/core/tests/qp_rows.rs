//! The QP with general rows: optimality on every answer, agreement with Clarabel, with the box solver and with
//! enumeration, degenerate corners, and total behaviour.

#![allow(clippy::expect_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, normal, rng};
use flight_core::control::law::contact::WrenchLimits;
use flight_core::qp::{
    ClarabelSolver, DualActiveSet, KKT_TOLERANCE, PrimalActiveSet, QpChain, QpProblem, QpSolver, QpStatus,
    kkt_residual,
};
use flight_core::robot::{Foot, Frame};
use flight_core::spatial::Pose;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;

const FEET: usize = 2;
const FORCES: usize = 6 * FEET;
const JOINTS: usize = 23;
const N: usize = FORCES + JOINTS;

fn limits() -> WrenchLimits {
    WrenchLimits { friction: 0.1, vertical_force_min: 1.0, centre_of_pressure_margin: 0.0 }
}

fn foot() -> Foot {
    Foot {
        name: String::new(),
        frame: Frame { name: String::new(), body: 0, body_from_frame: Pose::identity() },
        vertices_f: vec![Vector3::new(-0.07, -0.045, 0.0), Vector3::new(0.12, 0.05, 0.0)],
    }
}

/// A problem like the torque QP of a standing robot: `P W P` of rank 29 with the published weights, the
/// wrench rows of two feet. `push` moves the wanted wrenches towards and across their limits.
fn standing_problem(rng: &mut ChaCha8Rng, push: f64) -> QpProblem {
    let rows = limits().rows(&foot());
    let mut qp = QpProblem::new(N, rows.len() * FEET);
    let y = DMatrix::from_fn(29, N, |_, j| normal(rng) * if j < FORCES { 0.7 } else { 3.0 });
    let p = y.tr_mul(&y);
    let weights = DVector::from_fn(N, |i, _| if i < FORCES { 100.0 } else { 1.0 });
    let own = DVector::from_fn(N, |i, _| if i < FORCES { 1.0 } else { 0.001 } + 1e-4);
    let h = &p * DMatrix::from_diagonal(&weights) * &p + DMatrix::from_diagonal(&own);
    let wanted = DVector::from_fn(N, |i, _| match i {
        2 | 8 => 212.0 + push * 100.0 * normal(rng),
        i if i < FORCES => push * normal(rng) * if i % 6 < 3 { 20.0 } else { 10.0 },
        _ => push * 30.0 * normal(rng),
    });
    qp.g = -(&h * wanted);
    qp.h = 0.5 * (&h + h.transpose());
    qp.lower.rows_mut(FORCES, JOINTS).fill(-50.0);
    qp.upper.rows_mut(FORCES, JOINTS).fill(50.0);
    for foot in 0..FEET {
        for (k, (row, bound)) in rows.iter().enumerate() {
            let column = rows.len() * foot + k;
            qp.normals.fixed_view_mut::<6, 1>(6 * foot, column).copy_from(row);
            qp.limit[column] = *bound;
        }
    }
    qp
}

/// Random rows through a point that satisfies them all, so that there is an answer.
fn random_problem(rng: &mut ChaCha8Rng, n: usize, rows: usize) -> QpProblem {
    let mut qp = QpProblem::new(n, rows);
    let root = DMatrix::from_fn(n, n, |_, _| normal(rng));
    let mut h = root.tr_mul(&root);
    for i in 0..n {
        h[(i, i)] += 10.0_f64.powf(rng.random_range(-4.0..0.0));
    }
    qp.h = 0.5 * (&h + h.transpose());
    qp.g = DVector::from_fn(n, |_, _| 5.0 * normal(rng));
    let inside = DVector::from_fn(n, |_, _| normal(rng));
    for i in 0..n {
        qp.lower[i] = inside[i] - rng.random_range(0.0..2.0);
        qp.upper[i] = inside[i] + rng.random_range(0.0..2.0);
    }
    qp.normals = DMatrix::from_fn(n, rows, |_, _| normal(rng));
    qp.limit = qp.normals.tr_mul(&inside).map(|value| value + rng.random_range(0.0..1.0));
    qp
}

#[track_caller]
fn solve(qp: &QpProblem) -> (DVector<f64>, u32) {
    let mut solver = DualActiveSet::new(qp.len(), qp.rows());
    let answer = solver.solve(qp);
    assert_eq!(answer.status, QpStatus::Solved, "{answer:?}");
    let x = solver.x();
    assert!(answer.kkt <= KKT_TOLERANCE && answer.kkt == kkt_residual(qp, x, solver.multipliers()));
    for (x, (lower, upper)) in x.iter().zip(qp.lower.iter().zip(qp.upper.iter())) {
        assert!(lower <= x && x <= upper, "{lower} <= {x} <= {upper}");
    }
    (DVector::from_column_slice(x), answer.active)
}

fn difference(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    (a - b).amax() / (1.0 + a.amax())
}

/// From calm to far beyond the limits: certified, and the same point as polished Clarabel's.
#[test]
fn standing_problems_are_solved_and_agree_with_clarabel() {
    let mut rng = rng(1);
    for (push, fewest) in [(0.02, 0.0), (0.3, 0.3), (1.0, 2.0), (5.0, 8.0)] {
        let (mut active, mut agreed) = (0.0, 0);
        let count = 60;
        for _ in 0..count {
            let qp = standing_problem(&mut rng, push);
            let (x, held) = solve(&qp);
            active += f64::from(held) / f64::from(count);
            let mut clarabel = ClarabelSolver::new(qp.len(), qp.rows());
            let answer = clarabel.solve(&qp);
            let other = DVector::from_column_slice(clarabel.x());
            let (ours, theirs) = (qp.objective(x.as_slice()), qp.objective(other.as_slice()));
            assert_within!(ours, theirs + 1e-8 * theirs.abs().max(1.0), because "an inequality: the left side may come as near as it likes", "{ours} {theirs}");
            if answer.status == QpStatus::Solved {
                agreed += 1;
                assert_within!(difference(&x, &other), 1e-7, "push {push}: {:e}", difference(&x, &other));
            }
        }
        assert!(agreed > count * 8 / 10, "push {push}: Clarabel certified {agreed} of {count}");
        println!("push {push}: {active} active, Clarabel certified {agreed} of {count}");
        assert!(active >= fewest, "push {push}: {active} constraints active on average");
    }
}

/// Any size, more rows than variables: certified, and no worse than Clarabel.
#[test]
fn random_problems_of_every_size_are_solved() {
    let mut rng = rng(2);
    for (n, rows) in [(1, 3), (2, 9), (5, 5), (12, 40), (35, 38), (40, 1)] {
        for _ in 0..60 {
            let qp = random_problem(&mut rng, n, rows);
            let (x, _) = solve(&qp);
            let mut clarabel = ClarabelSolver::new(n, rows);
            if clarabel.solve(&qp).status == QpStatus::Solved {
                let other = DVector::from_column_slice(clarabel.x());
                assert_within!(difference(&x, &other), 1e-7, "{n} variables, {rows} rows");
            }
        }
    }
}

/// Rows that limit nothing leave a box, which the primal method solves; a row that limits something is refused, and
/// there is no certificate without its multiplier.
#[test]
fn rows_that_limit_nothing_leave_a_box() {
    let mut qp = random_problem(&mut rng(13), 5, 8);
    let limit = qp.limit[3];
    let mut solver = PrimalActiveSet::new(5);
    assert_eq!(solver.solve(&qp).status, QpStatus::SizeMismatch);
    qp.limit.fill(f64::INFINITY);
    let answer = solver.solve(&qp);
    assert_eq!(answer.status, QpStatus::Solved);
    assert_eq!(answer.kkt, kkt_residual(&qp, solver.x(), &[0.0; 8]));
    let (x, _) = solve(&qp);
    assert_within!(difference(&x, &DVector::from_column_slice(solver.x())), 1e-9);
    qp.limit[3] = limit;
    assert_eq!(solver.solve(&qp).status, QpStatus::SizeMismatch);
    assert!(kkt_residual(&qp, solver.x(), &[]).is_nan());
}

/// Brute force over all sets of rows that could hold, for problems small enough.
#[test]
fn tiny_problems_agree_with_enumeration() {
    let mut rng = rng(4);
    for _ in 0..150 {
        let mut qp = random_problem(&mut rng, 3, 5);
        qp.lower.fill(f64::NEG_INFINITY);
        qp.upper.fill(f64::INFINITY);
        let (h, g) = (&qp.h, &qp.g);
        let mut best = (f64::INFINITY, DVector::zeros(3));
        for set in 0..32_u32 {
            let held: Vec<usize> = (0..5).filter(|k| set & (1 << k) != 0).collect();
            let m = held.len();
            let mut system = DMatrix::zeros(3 + m, 3 + m);
            system.view_mut((0, 0), (3, 3)).copy_from(h);
            let mut right = DVector::zeros(3 + m);
            right.rows_mut(0, 3).copy_from(&-g);
            for (place, &k) in held.iter().enumerate() {
                system.view_mut((0, 3 + place), (3, 1)).copy_from(&qp.normals.column(k));
                system.view_mut((3 + place, 0), (1, 3)).copy_from(&qp.normals.column(k).transpose());
                right[3 + place] = qp.limit[k];
            }
            let Some(solution) = system.lu().solve(&right) else { continue };
            let x: DVector<f64> = solution.rows(0, 3).into();
            let slack = &qp.limit - qp.normals.tr_mul(&x);
            let value = qp.objective(x.as_slice());
            if slack.min() > -1e-9 && value < best.0 {
                best = (value, x);
            }
        }
        let (x, _) = solve(&qp);
        assert_within!(difference(&x, &best.1), 1e-7, "{x} {}", best.1);
    }
}

/// Rows that repeat, that touch the minimiser, and that meet in one corner: multipliers are not unique,
/// the minimiser is.
#[test]
fn degenerate_corners_do_not_cycle() {
    let mut rng = rng(5);
    for case in 0..200 {
        let mut qp = random_problem(&mut rng, 8, 24);
        let corner = DVector::from_fn(8, |_, _| normal(&mut rng));
        qp.lower.fill(-100.0);
        qp.upper.fill(100.0);
        for k in 0..24 {
            if k % 3 == 2 {
                let twin: DVector<f64> = qp.normals.column(k - 1).into();
                qp.normals.set_column(k, &(twin * 2.0));
            }
            qp.limit[k] = qp.normals.column(k).dot(&corner);
        }
        if case % 2 == 0 {
            // The minimiser is the corner itself.
            let pull = &qp.normals * DVector::from_fn(24, |_, _| rng.random_range(0.0..1.0));
            qp.g = -(&qp.h * &corner) - pull;
            let (x, _) = solve(&qp);
            assert_within!((x - &corner).amax(), 1e-7);
        } else {
            solve(&qp);
        }
    }
}

/// The certificate detects an error of every kind.
#[test]
fn the_certificate_sees_small_errors_of_every_kind() {
    let mut rng = rng(6);
    let qp = standing_problem(&mut rng, 1.0);
    let mut solver = DualActiveSet::new(N, qp.rows());
    assert_eq!(solver.solve(&qp).status, QpStatus::Solved);
    let (x, u) = (solver.x().to_vec(), solver.multipliers().to_vec());
    assert!(u.iter().any(|u| *u > 0.0), "no row presses");
    for i in 0..N {
        let mut moved = x.clone();
        moved[i] += 1e-3 * (1.0 + x[i].abs());
        assert!(kkt_residual(&qp, &moved, &u) > KKT_TOLERANCE, "x[{i}]");
    }
    let roots = qp.h.diagonal().map(f64::sqrt);
    let size = qp.g.component_div(&roots).amax();
    for k in 0..qp.rows() {
        let length = qp.normals.column(k).component_div(&roots).norm();
        for change in [1e-7, -1e-7] {
            let mut moved = u.clone();
            moved[k] += change * size / length;
            assert!(kkt_residual(&qp, &x, &moved) > KKT_TOLERANCE, "u[{k}] by {change}");
        }
    }
    assert!(kkt_residual(&qp, &x[1..], &u).is_nan());
    assert!(kkt_residual(&qp, &x, &u[1..]).is_nan());
}

/// Point and multipliers of a chain are those of the method that answered: together they give its residual.
#[test]
fn a_chain_has_point_and_multipliers_of_the_method_that_answered() {
    let qp = random_problem(&mut rng(11), 5, 8);
    let dual = || Box::new(DualActiveSet::new(5, 8)) as Box<dyn QpSolver>;
    let clarabel = || Box::new(ClarabelSolver::new(5, 8)) as Box<dyn QpSolver>;
    let primal = || Box::new(PrimalActiveSet::new(5)) as Box<dyn QpSolver>; // refuses rows
    for methods in [vec![dual()], vec![clarabel()], vec![primal(), dual()], vec![primal(), clarabel()]] {
        let mut chain = QpChain::new(methods);
        let answer = chain.solve(&qp);
        assert_eq!(answer.status, QpStatus::Solved);
        assert!(answer.iterations > 0);
        assert!(chain.multipliers().iter().any(|u| *u > 1e-3), "no row presses");
        assert_eq!(answer.kkt, kkt_residual(&qp, chain.x(), chain.multipliers()));
    }
}

/// An answer that fails says after how many steps: rows that exclude one another, and a step that overflows.
#[test]
fn a_failure_counts_the_steps_before_it() {
    let mut excluding = QpProblem::new(1, 2);
    excluding.h[(0, 0)] = 1.0;
    excluding.normals.copy_from_slice(&[1.0, -1.0]);
    excluding.limit.fill(-1.0);
    let answer = DualActiveSet::new(1, 2).solve(&excluding);
    assert_eq!(answer.status, QpStatus::InfeasibleBounds);
    assert!(answer.iterations > 0);

    let mut steep = QpProblem::new(2, 0);
    steep.h.copy_from_slice(&[1.0, -0.999_999, -0.999_999, 1.0]);
    steep.g.fill(1e307);
    let answer = PrimalActiveSet::new(2).solve(&steep);
    assert_eq!(answer.status, QpStatus::NonFinite);
    assert!(answer.iterations > 0);
}

/// What cannot be solved is said, `x` stays, and the solver goes on to solve the next problem.
#[test]
fn bad_problems_are_reported_and_leave_the_solvers_usable() {
    let mut rng = rng(7);
    let good = standing_problem(&mut rng, 0.3);
    let spoilt = |spoil: &dyn Fn(&mut QpProblem)| {
        let mut qp = good.clone();
        spoil(&mut qp);
        qp
    };
    let cases = [
        (spoilt(&|qp| qp.g[3] = f64::NAN), QpStatus::NonFinite),
        (spoilt(&|qp| qp.normals[(2, 5)] = f64::NAN), QpStatus::NonFinite),
        (spoilt(&|qp| qp.limit[5] = f64::NAN), QpStatus::NonFinite),
        (spoilt(&|qp| qp.h[(4, 4)] = f64::INFINITY), QpStatus::NonFinite),
        (spoilt(&|qp| qp.limit[5] = f64::NEG_INFINITY), QpStatus::InfeasibleBounds),
        (spoilt(&|qp| qp.lower[20] = 60.0), QpStatus::InfeasibleBounds),
        (spoilt(&|qp| qp.h[(13, 13)] = -1.0), QpStatus::NotPositiveDefinite),
        (spoilt(&|qp| qp.h.fill(1.0)), QpStatus::NotPositiveDefinite),
        // Two rows that exclude one another.
        (
            spoilt(&|qp| {
                let opposite: DVector<f64> = -DVector::from(qp.normals.column(0));
                qp.normals.set_column(1, &opposite);
                (qp.limit[0], qp.limit[1]) = (-3.0, -3.0);
            }),
            QpStatus::InfeasibleBounds,
        ),
        (QpProblem::new(N, 3), QpStatus::SizeMismatch),
        (QpProblem::new(3, good.rows()), QpStatus::SizeMismatch),
    ];
    let mut ours = DualActiveSet::new(N, good.rows());
    for (qp, expected) in &cases {
        let before = ours.x().to_vec();
        assert_eq!(ours.solve(qp).status, *expected);
        assert_eq!(ours.x(), before, "x moved");
        assert_eq!(ours.solve(&good).status, QpStatus::Solved);
        let theirs = ClarabelSolver::new(N, good.rows()).solve(qp).status;
        assert!(theirs != QpStatus::Solved, "Clarabel solved what {expected:?} says");
    }
}

/// Rows without limit or without entries say nothing; a problem without variables has the empty answer.
#[test]
fn empty_rows_and_problems_are_problems_too() {
    let mut rng = rng(8);
    let mut qp = standing_problem(&mut rng, 0.3);
    let (x, _) = solve(&qp);
    let mut more = QpProblem::new(N, qp.rows() + 2);
    (more.h, more.g) = (qp.h.clone(), qp.g.clone());
    (more.lower, more.upper) = (qp.lower.clone(), qp.upper.clone());
    more.normals.columns_mut(0, qp.rows()).copy_from(&qp.normals);
    more.limit.rows_mut(0, qp.rows()).copy_from(&qp.limit);
    more.normals.fixed_view_mut::<6, 1>(0, qp.rows()).copy_from(&Vector6::repeat(1.0));
    more.limit[qp.rows() + 1] = 0.0;
    assert_eq!(solve(&more).0, x);
    qp = QpProblem::new(0, 2);
    assert!(qp.is_empty());
    assert_eq!(solve(&qp).0.len(), 0);
}

/// Other units of variables and of rows do not change the answer.
#[test]
fn units_do_not_matter() {
    let mut rng = rng(9);
    for _ in 0..50 {
        let qp = standing_problem(&mut rng, 1.0);
        let (x, _) = solve(&qp);
        let s = DVector::from_fn(N, |_, _| 10.0_f64.powf(rng.random_range(-3.0..3.0)));
        let scale = DMatrix::from_diagonal(&s);
        let mut other = qp.clone();
        other.h = &scale * &qp.h * &scale;
        other.h = 0.5 * (&other.h + other.h.transpose());
        other.g = &scale * &qp.g;
        other.lower = qp.lower.component_div(&s);
        other.upper = qp.upper.component_div(&s);
        other.normals = &scale * &qp.normals;
        for k in 0..qp.rows() {
            let unit = 10.0_f64.powf(rng.random_range(-3.0..3.0));
            other.normals.column_mut(k).scale_mut(unit);
            other.limit[k] *= unit;
        }
        let (y, _) = solve(&other);
        assert_within!(difference(&x, &y.component_mul(&s)), 1e-7);
    }
}
