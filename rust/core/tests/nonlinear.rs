//! The nonlinear plan of a descent: its expansion against JAX's, its backward pass against dense solutions, and against costs
//! of other inputs.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::{Loop, Running, assert_says, assert_within, at, experiment, random_state, rng};
use flight_core::Measurement;
use flight_core::aero::LinkConventions;
use flight_core::control::config::ControllerConfig;
use flight_core::control::law::momentum::RateFeedback;
use flight_core::control::mpc::clearance::Clearance;
use flight_core::control::mpc::config::Air;
use flight_core::control::mpc::nonlinear::WORK;
use flight_core::control::mpc::nonlinear::knot::{Expansion, Knot, State, World};
use flight_core::control::mpc::nonlinear::riccati::Riccati;
use flight_core::control::{Modes, Present};
use flight_core::jets::JetDynamics;
use flight_core::qp::{KKT_TOLERANCE, QpStatus};
use flight_core::spatial::exp_so3;
use flight_io::{load_aero, load_robot};
use flight_sim::disturbances::{FailureKind, JetFailure};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::RngExt;

/// Greatest difference from JAX's expansions, relative to numbers greater than one.
const TOLERANCE: f64 = 1e-5;

/// A knot that begins where a controller is; the ground is at zero, and touched at 0.5 m/s.
fn knot_at<'a>(controller: &'a Running, law: &ControllerConfig) -> (Knot, World<'a>) {
    let (mpc, robot) = (law.mpc.as_ref().unwrap(), controller.model());
    let joints = mpc.joints(robot).unwrap();
    let clearance = Clearance::new(mpc.clearance.as_ref(), robot, joints.len()).unwrap();
    let mut knot = Knot::new(mpc, robot, robot.jet_models(law.jet_dynamics), joints, clearance);
    let world = World {
        robot,
        conventions: LinkConventions::default(),
        air: mpc.air,
        now: Present { estimate: controller.state().estimate(), terms: controller.terms() },
        posture: controller.state().posture(),
        ground: 0.0,
        speed: 0.5,
    };
    knot.begin(&world);
    (knot, world)
}

/// The expansion is that of JAX's derivatives, within and beyond limits: `tests/parity/test_knot.py` stores it times vectors.
#[test]
fn the_expansion_is_that_of_jax() {
    let config = experiment("robot");
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/knots.toml");
    let stored: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
    for (number, case) in stored["case"].as_array().unwrap().iter().enumerate() {
        let read = |name: &str| -> Vec<f64> {
            case[name].as_array().unwrap().iter().map(|x| x.as_float().unwrap()).collect()
        };
        let vector = |name: &str| Vector3::from_row_slice(&read(name));
        let robot = load_robot(&config.robot).unwrap();
        let mut aero = load_aero(&config.controller.aero, &robot).unwrap();
        let mut seen = random_state(&mut rng(0), &robot);
        seen.joint_position.copy_from_slice(&read("posture"));
        let mut controller = Running::new(config.controller(robot).unwrap());
        controller.tick(&Measurement { wind: vector("wind"), ..at(0.0, &seen, &[80.0; 4]) });
        let (mut knot, world) = knot_at(&controller, &config.controller.law);
        let state = State {
            height: read("height")[0],
            velocity: vector("velocity"),
            rotation: Matrix3::from_row_slice(&read("rotation")),
            momentum: vector("momentum"),
            thrust: read("thrust"),
            rate: read("rate"),
            joints: read("joints"),
        };
        let (inputs, durations) = (read("inputs"), read("durations"));
        let (n, m) = (state.size(), inputs.len());
        let (mut next, mut expansion) = (state.clone(), Expansion::new(n, m));
        let durations = (durations[0], durations[1]);
        knot.advance(&mut aero, &world, (&state, &inputs), durations, &mut next, &mut expansion).unwrap();

        let mut after = vec![next.height];
        after
            .extend(next.velocity.iter().chain(next.rotation.transpose().iter()).chain(next.momentum.iter()));
        after.extend(next.thrust.iter().chain(&next.rate).chain(&next.joints));
        let along = |matrix: &[f64], rows: usize| -> Vec<f64> {
            let matrix = DMatrix::from_column_slice(rows, n + m, matrix);
            let direction = |turns: f64| DVector::from_fn(n + m, |k, _| (turns * (k + 1) as f64).cos());
            let product = |turns: f64| (&matrix * direction(turns)).as_slice().to_vec();
            [1.0, 2.0, 3.0].into_iter().flat_map(product).collect()
        };
        let found = [
            ("next", after),
            ("dynamics", along(&expansion.dynamics, n)),
            ("cost", vec![expansion.cost]),
            ("gradient", expansion.gradient.clone()),
            ("hessian", along(&expansion.hessian, n + m)),
        ];
        for (name, found) in found {
            let expected = read(name);
            assert_eq!(found.len(), expected.len());
            for (place, (found, expected)) in found.iter().zip(&expected).enumerate() {
                // The crate has derivatives of engines by differences of 1e-4.
                let most = TOLERANCE * (1.0 + expected.abs());
                assert!(
                    (found - expected).abs() <= most,
                    "case {number}: {name} {place}: {found}, {expected}"
                );
            }
        }
    }
}

/// Whatever part of the air the law's momentum rate has, the plan begins with that rate: the air that is observed does not
/// count twice. Where the air stays, it is that of the beginning.
#[test]
fn a_plan_begins_with_the_momentum_rate_of_the_law() {
    use RateFeedback::{Force, Moment, None, Wrench};
    let wind = Vector3::new(0.0, -10.0, 0.0);
    for (part, air) in
        [(Wrench, Air::Linear), (Force, Air::Linear), (Moment, Air::Constant), (None, Air::Linear)]
    {
        let mut config = experiment("robot");
        let law = &mut config.controller.law;
        law.aero_feedback.momentum_rate = part;
        let mut flight = Loop::new(&config);
        flight.run(0.5, |_| wind);
        let (controller, estimate) = (&flight.controller, flight.controller.state().estimate());
        let (terms, robot) = (controller.terms(), controller.model());
        assert!(part == Wrench || terms.momentum.unmodelled_wrench.norm() > 0.5);
        let mut aero = load_aero(&config.controller.aero, robot).unwrap();
        let (mut knot, world) = knot_at(controller, &config.controller.law);
        let world = World { air, ..world };
        knot.begin(&world);
        let mut state = State::new(4, knot.joints.len());
        state.set_from(&world.now, &knot.joints);
        let (n, m) = (state.size(), knot.bounds.len());
        let mut inputs = vec![0.5; m];
        for (input, joint) in inputs[4..].iter_mut().zip(&knot.joints) {
            *input = estimate.robot.state.joint_velocity()[*joint];
        }
        let (mut next, mut expansion, h) = (state.clone(), Expansion::new(n, m), 1e-6);
        knot.advance(&mut aero, &world, (&state, &inputs), (h, h), &mut next, &mut expansion).unwrap();
        let rate = &terms.momentum.rate_estimate;
        let force = (next.velocity - state.velocity) * (terms.kinematics.mass() / h);
        let moment = (next.momentum - state.momentum) / h;
        // A velocity near 1 m/s rounds by 1e-16, which makes 1e-8 N of it; h F ẋ is 1e-3 N; joints that the plan does not move
        // are at rest there.
        let error = (force - rate.fixed_rows::<3>(0)).amax().max((moment - rate.fixed_rows::<3>(3)).amax());
        assert!(error < 0.05, "{part:?}: {force} {moment}, {rate}");
    }
}

/// A descent that cannot be planned, or would never be flown, is refused by key.
#[test]
fn what_cannot_be_planned_is_refused() {
    type Change = fn(&mut ControllerConfig);
    let cases: [(Change, &str); 2] = [
        (|law| law.mpc.as_mut().unwrap().descent = None, "controller.mpc.nonlinear_descent is true"),
        (|law| law.jet_dynamics = JetDynamics::Ideal, "controller.jet_dynamics is ideal"),
    ];
    for (change, words) in cases {
        let mut config = experiment("robot");
        change(&mut config.controller.law);
        let robot = load_robot(&config.robot).unwrap();
        assert_says(&config.controller(robot).unwrap_err().to_string(), &[words]);
    }
}

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
    let answer = riccati.solve(&expansions, &known, &free, 0.0, (&mut steps, &mut gains));
    assert!(answer.status == QpStatus::Solved && answer.kkt <= KKT_TOLERANCE, "{answer:?}");
    assert_eq!((answer.iterations, answer.active), (6, 0));
    let (least, _) = cost_of(&expansions, (n, m), (&steps, &gains), &known);
    for _ in 0..50 {
        let away: Vec<f64> = known.iter().map(|_| rng.random_range(-0.1..0.1)).collect();
        assert!(cost_of(&expansions, (n, m), (&steps, &gains), &away).0 > least);
    }
    // One knot: a convex QP within a box.
    let (one, bounds) = (&expansions[..2], vec![(-0.05, 0.05); m]);
    let (steps, gains) = (&mut steps[..m], &mut gains[..m * n]);
    let answer = riccati.solve(one, &known[..m], &bounds, 0.0, (&mut *steps, &mut *gains));
    assert!(answer.status == QpStatus::Solved && answer.kkt <= KKT_TOLERANCE, "{answer:?}");
    let (least, inputs) = cost_of(one, (n, m), (steps, gains), &known[..m]);
    assert!(inputs.iter().any(|input| input.abs() >= 0.05), "{inputs:?}");
    for _ in 0..200 {
        let away: Vec<f64> = inputs.iter().map(|input| rng.random_range(-0.05..=0.05) - input).collect();
        assert!(cost_of(one, (n, m), (steps, gains), &away).0 >= least - 1e-12);
    }
    // From another state the inputs differ by the feedback; one that is held has none.
    let bounds = [(-1e-3, 1e-3), free[0], free[0]];
    riccati.solve(one, &known[..m], &bounds, 0.0, (&mut *steps, &mut *gains));
    let mut moved = expansions[..2].to_vec();
    let by = DVector::from_fn(n, |row, _| 1e-4 * (1.0 + row as f64));
    let w = n + m;
    let [of_knot, of_end] = [0, 1].map(|place: usize| {
        let state = DMatrix::from_column_slice(n, w, &moved[0].dynamics).columns(0, n) * &by;
        let hessian = DMatrix::from_column_slice(w, w, &moved[place].hessian);
        hessian.columns(0, n) * if place == 0 { by.clone() } else { state }
    });
    for (expansion, more) in moved.iter_mut().zip([of_knot, of_end]) {
        expansion.gradient.iter_mut().zip(&more).for_each(|(to, more)| *to += more);
    }
    let (mut other, mut unused) = (vec![0.0; m], vec![0.0; m * n]);
    riccati.solve(&moved, &known[..m], &bounds, 0.0, (&mut other, &mut unused));
    let fed_back = DMatrix::from_column_slice(m, n, gains) * &by;
    assert!(fed_back.iter().any(|by| *by == 0.0) && fed_back.amax() > 1e-5, "{fed_back}");
    for (input, by) in fed_back.iter().enumerate() {
        assert!((other[input] - steps[input] - by).abs() < 1e-12, "{input}: {other:?} {steps:?} {by}");
    }
}

/// A cost without a least value has no certificate.
#[test]
fn a_cost_that_is_not_convex_is_refused() {
    let (n, m) = (5, 3);
    let mut expansions = random_problem(n, m, 2);
    expansions[1].hessian[n * (n + m + 1)] = -100.0;
    let mut riccati = Riccati::new(n, m);
    let (mut steps, mut gains) = ([0.0; 6], [0.0; 30]);
    let answer = riccati.solve(&expansions, &[0.0; 6], &[(-1.0, 1.0); 3], 0.0, (&mut steps, &mut gains));
    assert_eq!(answer.status, QpStatus::NotPositiveDefinite);
}

/// After an engine's loss no tick expands more knots than a whole plan has, trials that are refused with it; each answer is
/// certified.
#[test]
fn the_work_of_a_tick_is_that_of_a_whole_plan() {
    let mut config = experiment("robot");
    config.disturbances.jets.failure =
        Some(JetFailure { jet: "l_arm_jet".into(), time: 0.3, kind: FailureKind::Off, decay: 0.0 });
    let mut flight = Loop::new(&config);
    let (mut most, mut at_bounds) = (0, [0; 2]);
    for tick in 0..160 {
        flight.observe(&Vector3::zeros());
        let (found, command) = (flight.controller.expanded_knots(), flight.controller.command());
        if command.modes.contains(Modes::ENGINE_LIMITED) {
            assert!(found <= WORK, "tick {tick}: {found}");
            let answer = command.rates_qp;
            assert!(answer.status == QpStatus::Solved && answer.kkt <= KKT_TOLERANCE, "{tick}: {answer:?}");
            assert!(answer.iterations > 0);
            let (_, inputs) = flight.controller.state().descent_plan().unwrap().motion().unwrap();
            let (knot, _) = knot_at(&flight.controller, &config.controller.law);
            for (input, (lower, upper)) in inputs.iter().zip(knot.bounds.iter().cycle()) {
                assert!((lower..=upper).contains(&input), "tick {tick}: {input}");
                at_bounds[0] += usize::from(input <= lower);
                at_bounds[1] += usize::from(input >= upper);
            }
        }
        most = most.max(found);
        flight.advance(&Vector3::zeros());
    }
    assert_eq!(most, WORK);
    assert!(at_bounds[0] > 1000 && at_bounds[1] > 100, "{at_bounds:?}");
}

/// An engine that has stopped keeps its thrust whatever the input is, and has none; the inputs of a first plan hold those of the
/// others, and the joints.
#[test]
fn a_plan_has_nothing_from_an_engine_that_has_stopped() {
    let mut config = experiment("robot");
    config.disturbances.jets.failure =
        Some(JetFailure { jet: "l_arm_jet".into(), time: 0.1, kind: FailureKind::Off, decay: 0.0 });
    let mut flight = Loop::new(&config);
    flight.run(0.5, |_| Vector3::zeros());
    let controller = &flight.controller;
    assert_eq!(controller.terms().limits.works, [false, true, true, true]);
    let mut aero = load_aero(&config.controller.aero, controller.model()).unwrap();
    let (mut knot, world) = knot_at(controller, &config.controller.law);
    let mut inputs = vec![f64::NAN; knot.bounds.len()];
    knot.hold(&world, &mut inputs);
    assert_eq!((knot.bounds[0], inputs[0]), ((0.0, 0.0), 0.0));
    assert!(inputs[4..].iter().all(|velocity| *velocity == 0.0));
    let mut state = State::new(4, knot.joints.len());
    state.set_from(&world.now, &knot.joints);
    for (jet, input) in inputs.iter().enumerate().take(4).skip(1) {
        assert_eq!(knot.bounds[jet], (0.0, 1.0));
        let held = knot.acceleration(jet, state.thrust[jet], 0.0, *input);
        assert!((0.0..1.0).contains(input) && held.abs() < 1e-9, "{jet}: {held}");
    }
    (state.thrust[0], state.rate[0], inputs[0]) = (50.0, 30.0, 0.5);
    let (mut next, mut expansion) = (state.clone(), Expansion::new(state.size(), inputs.len()));
    knot.advance(&mut aero, &world, (&state, &inputs), (0.1, 0.1), &mut next, &mut expansion).unwrap();
    assert_eq!((next.thrust[0], next.rate[0]), (50.0, 30.0));
    let moved = [next.thrust[1] - state.thrust[1], next.rate[1] - state.rate[1]];
    assert!(moved.iter().all(|by| by.abs() > 1e-6), "{moved:?}");
}

/// The change of a knot's inputs that a backward pass gives, `step + gain δx`, along all knots: columns are the motions that
/// begin with the columns of `start`; those after the first have no step.
fn follow(
    expansions: &[Expansion],
    (n, m): (usize, usize),
    (steps, gains): (&[f64], &[f64]),
    start: &DMatrix<f64>,
) -> DMatrix<f64> {
    let knots = expansions.len() - 1;
    let (mut state, mut all) = (start.clone(), DMatrix::zeros(knots * m, start.ncols()));
    for knot in 0..knots {
        let gain = DMatrix::from_column_slice(m, n, &gains[knot * m * n..(knot + 1) * m * n]);
        let mut inputs = gain * &state;
        let mut first = inputs.column_mut(0);
        first += DVector::from_column_slice(&steps[knot * m..(knot + 1) * m]);
        all.rows_mut(knot * m, m).copy_from(&inputs);
        let dynamics = DMatrix::from_column_slice(n, n + m, &expansions[knot].dynamics);
        state = dynamics.columns(0, n) * &state + dynamics.columns(n, m) * inputs;
    }
    all
}

/// The cost of a motion as one quadratic function of everything that is free: the difference at its beginning, and all inputs.
/// Returns its second derivative, and the first one at zero.
fn dense_cost(
    expansions: &[Expansion],
    (n, m): (usize, usize),
    damping: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let knots = expansions.len() - 1;
    let size = n + knots * m;
    let (mut hessian, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    let mut state = DMatrix::zeros(n, size);
    state.view_mut((0, 0), (n, n)).fill_with_identity();
    for (knot, expansion) in expansions.iter().enumerate() {
        let mut both = DMatrix::zeros(n + m, size);
        both.rows_mut(0, n).copy_from(&state);
        if knot < knots {
            both.view_mut((n, n + knot * m), (m, m)).fill_with_identity();
            for input in n + knot * m..n + (knot + 1) * m {
                hessian[(input, input)] += damping;
            }
        }
        let own = DMatrix::from_column_slice(n + m, n + m, &expansion.hessian);
        hessian += both.transpose() * own * &both;
        gradient += both.transpose() * DVector::from_column_slice(&expansion.gradient);
        state = DMatrix::from_column_slice(n, n + m, &expansion.dynamics) * both;
    }
    (hessian, gradient)
}

/// A backward pass without bounds has the least cost of one dense linear system in all inputs of all knots, from every
/// beginning. With bounds, each knot's inputs cost least as long as later ones follow their feedback: the derivative of the dense
/// cost along that policy vanishes for free inputs, from every beginning, and pushes held ones against their bounds.
fn assert_is_dense(expansions: &[Expansion], known: &[f64], bounds: &[(f64, f64)], damping: f64) -> usize {
    let (m, knots) = (bounds.len(), expansions.len() - 1);
    let n = expansions[0].gradient.len() - m;
    let (hessian, gradient) = dense_cost(expansions, (n, m), damping);
    let of_inputs = hessian.view((n, n), (knots * m, knots * m)).into_owned();
    // Beginnings: none and every unit difference.
    let mut start = DMatrix::zeros(n, n + 1);
    start.columns_mut(1, n).fill_with_identity();
    let (mut steps, mut gains) = (vec![0.0; knots * m], vec![0.0; knots * m * n]);
    let mut riccati = Riccati::new(n, m);

    let free = vec![(f64::NEG_INFINITY, f64::INFINITY); m];
    let answer = riccati.solve(expansions, known, &free, damping, (&mut steps, &mut gains));
    assert!(answer.status == QpStatus::Solved, "{answer:?}");
    let found = follow(expansions, (n, m), (&steps, &gains), &start);
    let mut right = hessian.view((n, 0), (knots * m, n)) * &start;
    let mut first = right.column_mut(0);
    first += gradient.rows(n, knots * m);
    let dense = -of_inputs.clone().cholesky().unwrap().solve(&right);
    let scale = dense.amax();
    assert!((&found - &dense).amax() < TOLERANCE_DENSE * scale, "{} of {scale}", (&found - &dense).amax());

    let answer = riccati.solve(expansions, known, bounds, damping, (&mut steps, &mut gains));
    assert!(answer.status == QpStatus::Solved && answer.kkt <= KKT_TOLERANCE, "{answer:?}");
    // How all inputs change when a knot's inputs do and later ones follow; before it the robot is as it was.
    let mut held = 0;
    for knot in 0..knots {
        let rest = &expansions[knot..];
        let (hessian, gradient) = dense_cost(rest, (n, m), damping);
        let after = (&steps[knot * m..], &gains[knot * m * n..]);
        let motion = follow(rest, (n, m), after, &start);
        let mut by_inputs = DMatrix::zeros(n + (knots - knot) * m, m);
        by_inputs.view_mut((n, 0), (m, m)).fill_with_identity();
        if knot + 1 < knots {
            let dynamics = DMatrix::from_column_slice(n, n + m, &rest[0].dynamics);
            let moved = dynamics.columns(n, m).into_owned();
            let none = vec![0.0; steps.len()];
            let after = (&none[..(knots - knot - 1) * m], &gains[(knot + 1) * m * n..]);
            let later = follow(&rest[1..], (n, m), after, &moved);
            by_inputs.rows_mut(n + m, (knots - knot - 1) * m).copy_from(&later);
        }
        // Along the policy from each beginning the derivative of the cost by this knot's inputs, and what it is made of.
        let mut both = DMatrix::zeros(n + (knots - knot) * m, n + 1);
        both.rows_mut(0, n).copy_from(&start);
        both.rows_mut(n, (knots - knot) * m).copy_from(&motion);
        let mut slope = &hessian * &both;
        let mut first = slope.column_mut(0);
        first += gradient;
        let scale = (by_inputs.abs().transpose() * (hessian.abs() * both.abs())).amax();
        let of_knot = by_inputs.transpose() * slope;
        for (input, (least, greatest)) in bounds.iter().enumerate() {
            let place = knot * m + input;
            let to = known[place] + steps[place];
            assert!(to >= least - 1e-12 && to <= greatest + 1e-12, "{knot} {input}: {to}");
            let gain = (0..n)
                .map(|state| gains[knot * m * n + input + state * m])
                .fold(0.0, |most: f64, by| most.max(by.abs()));
            if gain == 0.0 {
                held += 1;
                let is_least = (to - least).abs() <= (to - greatest).abs();
                let pushes = if is_least { of_knot[(input, 0)] } else { -of_knot[(input, 0)] };
                assert!((to - least).abs().min((to - greatest).abs()) < 1e-12, "{knot} {input}: {to}");
                // That of an engine that has stopped lies at both.
                assert!(
                    greatest - least <= 0.0 || pushes >= -TOLERANCE_DENSE * scale,
                    "{knot} {input}: {pushes} of {scale}"
                );
            } else {
                let off = of_knot.row(input).amax();
                assert!(off <= TOLERANCE_DENSE * scale, "{knot} {input}: {off} of {scale}");
            }
        }
    }
    held
}

/// Sums of products of some hundred numbers, of which the greatest and the least differ by 1e6.
const TOLERANCE_DENSE: f64 = 1e-9;

#[test]
fn the_backward_pass_is_a_dense_solution() {
    for damping in [0.0, 0.7] {
        let (n, m, knots) = (5, 3, 6);
        let expansions = random_problem(n, m, knots);
        let mut rng = rng(9);
        let known: Vec<f64> = (0..knots * m).map(|_| rng.random_range(-0.1..0.1)).collect();
        let held = assert_is_dense(&expansions, &known, &[(-0.1, 0.1); 3], damping);
        assert!(held > 0 && held < knots * m, "{held}");
    }
}

/// The same of what a plan expands a moment after the loss of an arm's or of the chest's engine, on both robots.
#[test]
fn the_backward_pass_of_a_descent_is_a_dense_solution() {
    for name in ["robot", "mk3_robot"] {
        let mut config = experiment(name);
        config.controller.law.mpc.as_mut().unwrap().nonlinear_descent = true;
        for jet in load_robot(&config.robot).unwrap().jets.iter().step_by(2) {
            config.disturbances.jets.failure =
                Some(JetFailure { jet: jet.name.clone(), time: 0.1, kind: FailureKind::Off, decay: 0.0 });
            let mut flight = Loop::new(&config);
            flight.run(0.5, |_| Vector3::new(0.0, -8.0, 0.0));
            let controller = &flight.controller;
            assert!(controller.command().modes.contains(Modes::ENGINE_LIMITED), "{name}: {}", jet.name);
            let mut aero = load_aero(&config.controller.aero, controller.model()).unwrap();
            let (mut knot, world) = knot_at(controller, &config.controller.law);
            let mut state = State::new(world.robot.jets.len(), knot.joints.len());
            state.set_from(&world.now, &knot.joints);
            let (n, m, knots) = (state.size(), knot.bounds.len(), 4);
            let mut inputs = vec![0.0; m];
            knot.hold(&world, &mut inputs);
            let mut next = state.clone();
            let mut expansions = vec![Expansion::new(n, m); knots + 1];
            let none = vec![0.0; m];
            for (place, expansion) in expansions.iter_mut().enumerate() {
                let (inputs, durations) =
                    if place < knots { (&inputs, (0.04, 0.04)) } else { (&none, (0.0, 1.0)) };
                knot.advance(&mut aero, &world, (&state, inputs), durations, &mut next, expansion).unwrap();
                state = next.clone();
            }
            let known = inputs.repeat(knots);
            let held = assert_is_dense(&expansions, &known, &knot.bounds, 1.0);
            assert!(held >= knots && held < knots * m, "{name} {}: {held}", jet.name);
        }
    }
}

/// A state that is the other moved by every number: each of their differences is its own.
#[test]
fn differences_of_states_are_those_of_their_numbers() {
    let (first, turn) = (State::new(2, 1), Vector3::new(0.1, -0.2, 0.3));
    let mut moved = first.clone();
    moved.height = 1.0;
    (moved.velocity, moved.momentum) = (Vector3::new(2.0, 3.0, 4.0), Vector3::new(5.0, 6.0, 7.0));
    moved.rotation = exp_so3(&turn);
    (moved.thrust, moved.rate, moved.joints) = (vec![8.0, 9.0], vec![10.0, 11.0], vec![12.0]);
    let mut found = DVector::from_element(moved.size(), f64::NAN);
    moved.minus(&first, &mut found);
    let expected = [1.0, 2.0, 3.0, 4.0, turn.x, turn.y, turn.z, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0];
    for (found, expected) in found.iter().zip(expected) {
        assert_within!((found - expected).abs(), 1e-14);
    }
}
