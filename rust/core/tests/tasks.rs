//! Each task of the momentum QP is what it is said to be: `A u + b` is the quantity it shapes, by differences along
//! the motion that the unknowns `u` stand for; and a task of one's own does what it asks.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "entries that are written as they are have their bits")]

use crate::common::{Running, assert_within, at, experiment, random_state, random_vector, rng};
use flight_core::aero::LinkForces;
use flight_core::control::law::attitude::{MomentumGains, attitude_demand};
use flight_core::control::law::momentum::{AeroFeedback, MomentumModel};
use flight_core::control::law::momentum_qp::{Equations, Layout, Task, TaskInputs};
use flight_core::control::law::setpoint::Setpoint;
use flight_core::dynamics::Dynamics;
use flight_core::kinematics::Kinematics;
use flight_core::qp::QpStatus;
use flight_core::spatial::{exp_so3, vee_of_skew_part};
use flight_core::{Measurement, RobotModel, RobotState};
use flight_io::load_robot;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use std::sync::Arc;

/// Differences of values of 1e4 over a step of 1e-5 keep 1e-16 · 1e4 / 1e-5 = 1e-7; relative to values of 1e3 and more.
const STEP: f64 = 1e-5;

/// A set-point none of whose derivatives is zero.
fn moving_setpoint(rng: &mut ChaCha8Rng) -> Setpoint {
    Setpoint {
        com_velocity: random_vector(rng, 1.0),
        com_acceleration: random_vector(rng, 1.0),
        com_jerk: random_vector(rng, 1.0),
        angular_velocity_b: random_vector(rng, 1.0),
        angular_acceleration_b: random_vector(rng, 1.0),
        angular_jerk_b: random_vector(rng, 1.0),
        ..Setpoint::at_rest(random_vector(rng, 1.0), exp_so3(&random_vector(rng, 1.0)))
    }
}

/// A controller behind a tick of a random robot state towards a set-point that moves, without wind; jets and their
/// thrusts.
fn run_tick(name: &str, seed: u64) -> (Running, RobotState, Vec<f64>) {
    let config = experiment(name);
    let mut controller = Running::new(config.controller(load_robot(&config.robot).unwrap()).unwrap());
    let mut rng = rng(seed);
    let mut state = random_state(&mut rng, controller.model());
    state.velocity *= 0.3;
    let thrust: Vec<f64> = (0..controller.n_jets()).map(|_| rng.random_range(10.0..150.0)).collect();
    let feet =
        [Vector6::new(3.0, -2.0, 212.5, 0.4, -1.2, 0.1), Vector6::new(1.0, 2.0, 200.0, -0.4, -1.0, 0.0)];
    let feet = &feet[..controller.terms().contact.soles.len()];
    // The first tick keeps its posture and inertia; the second one has left them.
    let mut start = state.clone();
    start.joint_position.add_scalar_mut(0.1);
    let foot_wrenches = DVector::from_iterator(6 * feet.len(), feet.iter().flatten().copied());
    let measure =
        |time, state| Measurement { foot_wrenches: foot_wrenches.clone(), ..at(time, state, &thrust) };
    controller.tick(&measure(0.0, &start));
    let setpoint = moving_setpoint(&mut rng);
    controller.tick_towards(&measure(0.01, &state), &setpoint);
    (controller, state, thrust)
}

fn equations(controller: &Running, name: &str, u: &DVector<f64>) -> DVector<f64> {
    let (matrix, offset, _) = controller.terms().momentum_qp.task(name).unwrap();
    matrix * u + offset
}

fn random_unknowns(controller: &Running, seed: u64) -> DVector<f64> {
    let (mut rng, unknowns) = (rng(seed), &controller.terms().momentum_qp.unknowns);
    let size = |i| if unknowns.joint_velocity.contains(&i) { 1.0 } else { 50.0 };
    DVector::from_fn(unknowns.len(), |i, _| size(i) * rng.random_range(-1.0..1.0))
}

/// The robot that moves with the measured base velocity and the joint velocities of `u`.
fn move_state(controller: &Running, state: &RobotState, u: &DVector<f64>, time: f64) -> RobotState {
    let unknowns = &controller.terms().momentum_qp.unknowns;
    let mut to = state.clone();
    to.velocity
        .rows_mut(6, unknowns.joint_velocity.len())
        .copy_from_slice(&u.as_slice()[unknowns.joint_velocity.clone()]);
    to.advance_pose(time);
    to
}

fn place_robot(robot: &RobotModel, state: &RobotState) -> (Kinematics, Dynamics) {
    let (mut kinematics, mut dynamics) = (Kinematics::new(robot), Dynamics::new(robot));
    kinematics.update(robot, state);
    dynamics.update(robot, state, &kinematics);
    (kinematics, dynamics)
}

/// `L̈(u)` by a central difference of `L̇ = Σ (f, r × f)` of thrusts and foot wrenches that change as `u` says.
fn momentum_acceleration(
    controller: &Running,
    state: &RobotState,
    thrust: &[f64],
    u: &DVector<f64>,
) -> Vector6<f64> {
    let (robot, terms) = (controller.model(), controller.terms());
    let unknowns = &terms.momentum_qp.unknowns;
    let rate = |time: f64| {
        let (kinematics, dynamics) = place_robot(robot, &move_state(controller, state, u, time));
        let thrust: Vec<f64> = thrust
            .iter()
            .zip(&u.as_slice()[unknowns.thrust_rate.clone()])
            .map(|(t, r)| t + r * time)
            .collect();
        let mut momentum = MomentumModel::new(robot);
        momentum.update(
            robot,
            &kinematics,
            &dynamics,
            &thrust,
            &LinkForces::new(robot),
            &AeroFeedback::default(),
        );
        let mut rate = momentum.rate_estimate;
        for (index, foot) in robot.feet.iter().enumerate() {
            let first = unknowns.force_rate.start + 6 * index;
            let wrench = controller.state().contact().force.fixed_rows::<6>(6 * index)
                + u.fixed_rows::<6>(first) * time;
            let arm = kinematics.frame_pose(&foot.frame).position - kinematics.com;
            rate += wrench;
            let mut moment = rate.fixed_rows_mut::<3>(3);
            moment += arm.cross(&wrench.fixed_rows::<3>(0));
        }
        rate
    };
    (rate(STEP) - rate(-STEP)) / (2.0 * STEP)
}

/// Flying, and standing on feet that carry.
const CASES: [(&str, u64); 4] = [("test1", 1), ("test1", 2), ("balancing_front", 3), ("balancing_front", 4)];

#[test]
fn the_linear_task_is_the_law_of_the_linear_momentum() {
    for (name, seed) in CASES {
        let (controller, state, thrust) = run_tick(name, seed);
        let (u, terms, gains) = (
            random_unknowns(&controller, seed),
            controller.terms(),
            experiment(name).controller.law.momentum,
        );
        let acceleration = momentum_acceleration(&controller, &state, &thrust, &u);
        let (_, dynamics) = place_robot(controller.model(), &move_state(&controller, &state, &u, 0.0));
        let (mass, setpoint) = (terms.kinematics.mass(), &terms.setpoint);
        let found = equations(&controller, "linear momentum", &u);
        for axis in 0..3 {
            let (kp, kd) = (gains.kp_linear[axis], gains.kd_linear[axis]);
            let law = acceleration[axis] - mass * setpoint.com_jerk[axis]
                + (kp + kd + 1.0 / gains.ko) * (dynamics.momentum[axis] - mass * setpoint.com_velocity[axis])
                + (kd + 1.0) * (terms.momentum.rate_estimate[axis] - mass * setpoint.com_acceleration[axis])
                + kp * mass * (terms.kinematics.com[axis] - setpoint.com_position[axis]);
            assert_within!((found[axis] - law).abs(), 1e-6 * (1e3 + law.abs()), "{name}, axis {axis}");
        }
    }
}

#[test]
fn the_attitude_task_is_the_law_of_the_angular_momentum() {
    for (name, seed) in CASES {
        let (controller, state, thrust) = run_tick(name, seed);
        let (u, terms) = (random_unknowns(&controller, seed), controller.terms());
        let acceleration = momentum_acceleration(&controller, &state, &thrust, &u);
        let angular: Vector3<f64> = acceleration.fixed_rows::<3>(3).into();
        let law = state.base.rotation.transpose() * (angular - terms.attitude.sigma_i)
            - terms.attitude.k_ddot_desired_b;
        let found = equations(&controller, "attitude", &u);
        let tolerance = 1e-6 * (1e3 + law.norm());
        assert_within!((found - law).norm(), tolerance, because "the error of a quotient of differences", "{name}");
    }
}

/// The attitude law term by term: each is left alone by gains of zero and a moment, or an attitude, that cancels the others.
#[test]
fn the_attitude_law_is_each_of_its_terms() {
    let mut rng = rng(5);
    for _ in 0..10 {
        let setpoint = moving_setpoint(&mut rng);
        let rotation = setpoint.rotation * exp_so3(&random_vector(&mut rng, 0.5));
        let inertia = Matrix3::from_diagonal(&Vector3::new(3.0, 5.0, 2.0)) + Matrix3::from_element(0.3);
        let inverse = inertia.try_inverse().unwrap();
        let (w, k_dot) = (random_vector(&mut rng, 2.0), random_vector(&mut rng, 3.0));
        let (k, gains) = (inertia * w, experiment("test2").controller.law.momentum);
        let demand = |c0, c1, setpoint: &Setpoint, rotation: &Matrix3<f64>, k_dot: &Vector3<f64>| {
            let (velocity, moment) = (rotation * w, rotation * (k_dot + w.cross(&k)));
            let gains = MomentumGains { c0, c1, ..gains };
            attitude_demand(&gains, setpoint, rotation, &velocity, &moment, &inertia, &inverse)
        };
        let still = Setpoint {
            angular_acceleration_b: Vector3::zeros(),
            angular_jerk_b: Vector3::zeros(),
            ..setpoint
        };
        // −ė alone, by differences of e along both motions.
        let e = |time: f64| {
            let desired = setpoint.rotation * exp_so3(&(setpoint.angular_velocity_b * time));
            vee_of_skew_part(&(desired.transpose() * rotation * exp_so3(&(w * time))))
        };
        let e_dot = (e(STEP) - e(-STEP)) / (2.0 * STEP);
        let found = demand(0.0, 0.0, &still, &rotation, &Vector3::zeros()).k_ddot_desired_b;
        assert_within!((found + e_dot).amax(), 1e-8, because "differences of numbers of order one over 2e-5");
        // I₀ ω̈_d − ė where the moment is the one of ω̇_d.
        let wanted = inertia * setpoint.angular_acceleration_b;
        let found = demand(7.0, 0.0, &Setpoint { rotation, ..setpoint }, &rotation, &wanted).k_ddot_desired_b;
        let slower = demand(0.0, 0.0, &Setpoint { rotation, ..still }, &rotation, &Vector3::zeros());
        let law = inertia * setpoint.angular_jerk_b + slower.k_ddot_desired_b;
        assert_within!((found - law).amax(), 1e-12, because "rounding of numbers of order ten");
        // What each gain multiplies.
        let none = demand(0.0, 0.0, &setpoint, &rotation, &k_dot).k_ddot_desired_b;
        let of_c0 = demand(1.0, 0.0, &setpoint, &rotation, &k_dot).k_ddot_desired_b - none;
        let of_c1 = demand(0.0, 1.0, &setpoint, &rotation, &k_dot).k_ddot_desired_b - none;
        let law = -(inverse * (k_dot - wanted + e(0.0)));
        assert_within!((of_c0 - law).amax(), 1e-12, because "rounding of numbers of order ten");
        let law = setpoint.angular_velocity_b - w;
        assert_within!((of_c1 - law).amax(), 1e-12, because "rounding of numbers of order ten");
        // σ = L̈ − R k̈ along a motion with this k̇, no k̈, and ω̇ = I₀⁻¹ k̇.
        let step = 1e-3;
        let momentum = |time: f64| {
            let turned = exp_so3(&(w * time + inverse * k_dot * (0.5 * time * time)));
            rotation * turned * (k + k_dot * time)
        };
        let second = (momentum(step) - 2.0 * momentum(0.0) + momentum(-step)) / (step * step);
        let sigma = demand(1.0, 1.0, &setpoint, &rotation, &k_dot).sigma_i;
        assert_within!((sigma - second).amax(), 1e-3, because "a fourth derivative of up to 1e3 times step squared");
    }
}

#[test]
fn the_limbs_may_carry_what_the_change_of_inertia_leaves_them() {
    for (name, seed) in CASES {
        let (controller, state, _) = run_tick(name, seed);
        let u = random_unknowns(&controller, seed);
        let mut limbs = move_state(&controller, &state, &u, 0.0);
        limbs.velocity.fixed_rows_mut::<6>(0).fill(0.0);
        let (_, dynamics) = place_robot(controller.model(), &limbs);
        let b_from_i = state.base.rotation.transpose();
        let inertia: Matrix3<f64> = b_from_i * dynamics.centroidal_inertia * state.base.rotation;
        let change = inertia - controller.state().inertia_0_b();
        assert!(change.amax() > 1e-3);
        let law = b_from_i * dynamics.momentum.fixed_rows::<3>(3)
            + change * b_from_i * state.base_angular_velocity();
        let found = equations(&controller, "angular momentum", &u);
        assert_within!((found - law).norm(), 1e-12 * (1.0 + law.norm()), "{name}");
    }
}

/// The soles' velocities by differences of their poses.
#[test]
fn the_feet_task_is_the_velocity_of_the_soles() {
    for (name, seed) in &CASES[2..] {
        let (controller, state, _) = run_tick(name, *seed);
        assert!(controller.state().contact().is_active);
        let u = random_unknowns(&controller, *seed);
        let found = equations(&controller, "feet", &u);
        let robot = controller.model();
        let soles = |time: f64| {
            let (kinematics, _) = place_robot(robot, &move_state(&controller, &state, &u, time));
            robot.feet.iter().map(|foot| kinematics.frame_pose(&foot.frame)).collect::<Vec<_>>()
        };
        let (before, after) = (soles(-STEP), soles(STEP));
        for (foot, (before, after)) in before.iter().zip(&after).enumerate() {
            let linear = (after.position - before.position) / (2.0 * STEP);
            let turn = (after.rotation - before.rotation) / (2.0 * STEP)
                * (after.rotation + before.rotation).transpose()
                / 2.0;
            let angular = Vector3::new(
                turn[(2, 1)] - turn[(1, 2)],
                turn[(0, 2)] - turn[(2, 0)],
                turn[(1, 0)] - turn[(0, 1)],
            ) / 2.0;
            for (row, rate) in [(6 * foot, linear), (6 * foot + 3, angular)] {
                let error = (found.fixed_rows::<3>(row) - rate).norm();
                assert_within!(error, 1e-8, because "the error of a quotient of differences", "{name}: foot {foot}");
            }
        }
    }
}

/// Matrix, offset and weights of what is a formula, not a derivative.
#[test]
fn the_simple_tasks_are_their_formulas() {
    let (controller, state, _) = run_tick("test1", 5);
    let (config, robot) = (experiment("test1").controller.law, controller.model());
    let (qp, n) = (&controller.terms().momentum_qp, 27);
    let block =
        |first: usize, count: usize| DMatrix::from_fn(count, n, |i, j| f64::from(u8::from(j == first + i)));
    let posture = qp.task("posture").unwrap();
    assert_eq!(posture.0, block(4, 23));
    for group in &robot.groups {
        for &joint in &group.joints {
            let error = state.joint_position[joint] - controller.state().posture()[joint];
            assert_eq!(posture.1[joint], config.posture_gain[&group.name] * error);
        }
    }
    assert!(posture.1.amax() > 0.01);
    assert!(posture.2.iter().all(|weight| *weight == config.weights.posture));
    for (name, first, count, weight) in [
        ("thrust rate", 0, 4, None),
        ("joint velocity", 4, 23, Some(config.weights.joint_velocity)),
        ("regularisation", 0, 27, Some(config.weights.regularisation)),
    ] {
        let (matrix, offset, weights) = qp.task(name).unwrap();
        assert_eq!((matrix, offset), (block(first, count), DVector::zeros(count)), "{name}");
        for (index, found) in weights.iter().enumerate() {
            assert_eq!(
                *found,
                weight.unwrap_or_else(|| config.weights.thrust_rate[&robot.jets[index].name]),
                "{name}"
            );
        }
    }
    let (matrix, offset, weights) = qp.task("symmetric jets").unwrap();
    for (row, pair) in config.weights.symmetric_jets.iter().enumerate() {
        let [a, b] = pair.clone().map(|name| robot.jets.iter().position(|jet| jet.name == name).unwrap());
        let expected = DVector::from_fn(n, |i, _| f64::from(u8::from(i == a)) - f64::from(u8::from(i == b)));
        assert_eq!(matrix.row(row).transpose(), expected);
        assert_eq!((offset[row], weights[row]), (0.0, config.weights.symmetry));
    }
}

/// Tasks are there when they apply.
#[test]
fn tasks_are_added_where_they_apply() {
    let has = |name: &str, task: &str| run_tick(name, 6).0.terms().momentum_qp.task(task).is_some();
    for task in ["feet", "force rate"] {
        assert!(has("balancing_front", task) && !has("test1", task), "{task}");
    }
    for task in ["thrust rate", "symmetric jets"] {
        assert!(!has("balancing_front", task) && has("test1", task), "{task}");
    }
}

/// Asks some joint to turn at a velocity, once as a diagonal and once as a row.
#[derive(Debug)]
struct KeepVelocity {
    unknown: usize,
    velocity: f64,
    weights: Vec<f64>,
    is_row: bool,
}

impl Task for KeepVelocity {
    fn name(&self) -> &'static str {
        "keep velocity"
    }

    fn layout(&self) -> Layout {
        let weights = self.weights.clone();
        if self.is_row { Layout::Rows(weights) } else { Layout::Diagonal { first: self.unknown, weights } }
    }

    fn update(&self, _: &TaskInputs, equations: &mut Equations) {
        if self.is_row {
            equations.matrix[(self.unknown, 0)] = 1.0;
        }
        equations.offset[0] = -self.velocity;
    }
}

/// `u' = u + H⁻¹ e w (v − e·u) / (1 + w eᵀ H⁻¹ e)` over the unknowns that meet no bound: what one more square changes.
#[test]
fn a_task_of_ones_own_does_what_it_asks() {
    let config = experiment("test2");
    let robot = load_robot(&config.robot).unwrap();
    let start = config.simulator.initial.state();
    let thrust = &config.simulator.initial.thrust;
    let tick = |task: Option<KeepVelocity>| {
        let mut controller = config.controller(robot.clone()).unwrap();
        if let Some(task) = task {
            controller.add_task(Arc::new(task)).unwrap();
        }
        let mut controller = Running::new(controller);
        assert_eq!(controller.tick(&at(0.0, &start, thrust)).rates_qp.status, QpStatus::Solved);
        let command = controller.command();
        let u: Vec<f64> = command.thrust_rate.iter().chain(&command.joint_velocity).copied().collect();
        (DVector::from_vec(u), controller.terms().momentum_qp.problem.clone())
    };
    let (plain, problem) = tick(None);
    let is_free = |i: &usize| problem.lower[*i] < plain[*i] && plain[*i] < problem.upper[*i];
    let free: Vec<usize> = (0..27).filter(is_free).collect();
    let h = DMatrix::from_fn(free.len(), free.len(), |i, j| problem.h[(free[i], free[j])]);
    let place = 10;
    let unknown = free[place];
    assert!(unknown >= 4, "a joint");
    let velocity = plain[unknown] + 0.01;
    for weight in [1.0, 100.0, 1e6] {
        let mut e = DVector::zeros(free.len());
        e[place] = 1.0;
        let response = h.clone().cholesky().unwrap().solve(&e);
        let step = weight * (velocity - plain[unknown]) / (1.0 + weight * response[place]);
        let mut expected = plain.clone();
        for (response, &i) in response.iter().zip(&free) {
            expected[i] += response * step;
        }
        for is_row in [false, true] {
            let weights = vec![weight];
            let (found, _) = tick(Some(KeepVelocity { unknown, velocity, weights, is_row }));
            // Two QPs of condition 1e8, each solved to 1e-15 of its scale.
            assert_within!((&found - &expected).amax(), 1e-7 * (1.0 + expected.amax()), "weight {weight}");
            let left = (found[unknown] - velocity) / (plain[unknown] - velocity);
            assert_within!((left - 1.0 / (1.0 + weight * response[place])).abs(), 1e-6, "weight {weight}");
        }
    }
}

#[test]
fn tasks_that_mean_nothing_are_refused() {
    let config = experiment("test2");
    let mut controller = config.controller(load_robot(&config.robot).unwrap()).unwrap();
    let mut refusal = |unknown, weight, is_row| {
        let task = KeepVelocity { unknown, velocity: 0.0, weights: vec![weight], is_row };
        controller.add_task(Arc::new(task)).map_or_else(|error| error.to_string(), |()| String::new())
    };
    assert!(refusal(27, 1.0, false).contains("at most 27 unknowns"));
    assert!(refusal(3, -1.0, true).contains("weight of task `keep velocity` is -1"));
    assert!(refusal(3, f64::NAN, false).contains("weight of task `keep velocity` is NaN"));
    assert_eq!(refusal(3, 1.0, false), "");
    assert!(refusal(3, 1.0, false).contains("keep velocity"), "twice");
}

/// Refused for its second weight, when the first has been read.
#[test]
fn a_task_that_is_refused_leaves_nothing() {
    let config = experiment("test2");
    let start = config.simulator.initial.state();
    let thrust = &config.simulator.initial.thrust;
    let tick = |is_tried: bool| {
        let mut controller = config.controller(load_robot(&config.robot).unwrap()).unwrap();
        if is_tried {
            let weights = vec![1.0, -1.0];
            let task = KeepVelocity { unknown: 4, velocity: 0.0, weights, is_row: false };
            controller.add_task(Arc::new(task)).unwrap_err();
        }
        let mut controller = Running::new(controller);
        controller.tick(&at(0.0, &start, thrust));
        controller.terms().momentum_qp.problem.h.clone()
    };
    assert_eq!(tick(true), tick(false));
}
