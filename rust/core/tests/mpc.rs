//! The predictive law: the horizon against fine steps, the plan against its cost. Its derivatives, and distances:
//! `tests/parity/test_symbolic_mpc.py`.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{Loop, Running, assert_within, at, experiment, random_state, random_vector, rng, robot};
use flight_core::aero::{AeroModel, ForceFactorsConfig};
use flight_core::control::Present;
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::mpc::PredictiveLaw;
use flight_core::control::mpc::clearance::Clearance;
use flight_core::control::mpc::config::Air;
use flight_core::control::mpc::horizon::{Horizon, Target};
use flight_core::control::mpc::model::Linearised;
use flight_core::control::mpc::plan::Plan;
use flight_core::control::{Command, Given, Modes, Preview};
use flight_core::jets::JetDynamics;
use flight_core::qp::{PrimalActiveSet, QpSolver, QpStatus};
use flight_core::spatial::{exp_so3, stack};
use flight_core::{Measurement, RobotModel, RobotState};
use flight_io::{AeroConfig, load_aero, load_robot};
use flight_sim::ScenarioConfig;
use nalgebra::{DVector, Matrix3, Vector3, Vector6};
use rand::RngExt;

/// Step of central differences: their error is about `h²` of the third derivatives, and `1e-16 / h` of the values.
const STEP: f64 = 1e-5;

fn axisymmetric(robot: &RobotModel) -> AeroModel {
    let text = r#"{"model": "axisymmetric", "coefficients": "corrected", "air_density": 1.225}"#;
    let config: AeroConfig = serde_json::from_str(text).unwrap();
    load_aero(&config, robot).unwrap()
}

/// The same with other factors on drag, normal force and single links.
fn weighted(robot: &RobotModel) -> AeroModel {
    let on = |link: usize, factor| [(robot.aero_links[link].name.clone(), factor)].into();
    let factors = ForceFactorsConfig {
        scale: 1.1,
        drag: 0.7,
        normal: 1.6,
        links: on(2, 0.4),
        drag_of: on(3, 0.5),
        normal_of: on(5, 0.3),
    };
    axisymmetric(robot).weight_forces(&factors, robot, "test").unwrap()
}

/// A robot in any posture, attitude and motion, in wind.
struct Case {
    robot: RobotModel,
    state: RobotState,
    thrust: Vec<f64>,
    wind: Vector3<f64>,
}

impl Case {
    fn draw(seed: u64) -> Self {
        let (robot, mut rng) = (robot("ironcub_mk1"), rng(seed));
        let mut state = random_state(&mut rng, &robot);
        let zipped = state.joint_position.iter_mut().zip(&robot.joints);
        for (position, joint) in zipped {
            let (low, high) = joint.limits;
            *position = low + (high - low) * rng.random_range(0.2..0.8);
        }
        let thrust = robot.jets.iter().map(|_| rng.random_range(50.0..150.0)).collect();
        Self { robot, state, thrust, wind: random_vector(&mut rng, 12.0) }
    }

    /// Terms of a controller that measures this robot.
    fn controller(&self, config: &ScenarioConfig) -> Running {
        let robot = load_robot(&config.robot).unwrap();
        let mut controller = Running::new(config.controller(robot).unwrap());
        controller.tick(&Measurement { wind: self.wind, ..at(0.0, &self.state, &self.thrust) });
        controller
    }
}

fn moved_joints(config: &ScenarioConfig, robot: &RobotModel) -> Vec<usize> {
    config.controller.law.mpc.as_ref().unwrap().joints(robot).unwrap()
}

#[test]
fn derivatives_of_link_forces_are_those_of_differences() {
    let mut rng = rng(1);
    let robot = robot("ironcub_mk1");
    for model in [axisymmetric(&robot), weighted(&robot)] {
        assert!(model.has_derivatives());
        for link in 0..robot.aero_links.len() {
            let axis = random_vector(&mut rng, 1.0).normalize();
            let v = random_vector(&mut rng, 15.0);
            let found = model.derivatives(link, &axis, &v);
            let force = |axis: &Vector3<f64>, v: &Vector3<f64>| match &model {
                AeroModel::Axisymmetric(model) => model.link_force(link, axis, v),
                AeroModel::Weighted(model, factors) => {
                    let AeroModel::Axisymmetric(model) = model.as_ref() else { unreachable!() };
                    let mut forces = vec![Vector3::zeros(); link + 1];
                    let mut air = forces.clone();
                    (forces[link], air[link]) = (model.link_force(link, axis, v), *v);
                    factors.apply(&air, &mut forces);
                    forces[link]
                }
                _ => unreachable!(),
            };
            for k in 0..3 {
                let mut step = Vector3::zeros();
                step[k] = STEP;
                let by_velocity = (force(&axis, &(v + step)) - force(&axis, &(v - step))) / (2.0 * STEP);
                let error = (by_velocity - found.by_velocity.column(k)).amax();
                assert_within!(error, 1e-8 * v.norm(), because "h² and rounding / h of a force of 10 N");
                // An axis turns; its length stays.
                let turn = |angle: f64| exp_so3(&(step / STEP * angle)) * axis;
                let by_turn = (force(&turn(STEP), &v) - force(&turn(-STEP), &v)) / (2.0 * STEP);
                let change = found.by_axis * (step / STEP).cross(&axis);
                assert_within!((by_turn - change).amax(), 1e-8 * v.norm_squared(), because "the same");
            }
        }
    }
}

#[test]
fn a_constant_wrench_of_the_air_does_not_turn_with_the_robot() {
    let config = experiment("test2_mpc");
    let case = Case::draw(7);
    let controller = case.controller(&config);
    let joints = moved_joints(&config, &case.robot);
    let mut model = Linearised::new(&case.robot, joints.clone());
    assert!(model.update(&case.robot, &axisymmetric(&case.robot), Air::Constant, present(&controller)));
    let mut without = Linearised::new(&case.robot, joints);
    assert!(without.update(&case.robot, &AeroModel::Off, Air::Linear, present(&controller)));
    assert!(model.rate_v.amax() == 0.0 && model.rate_sigma.amax() == 0.0);
    // Without a model the wrench of the air in the terms turns; it is the difference.
    let (force, moment) = controller.terms().link_forces.wrench_about(&controller.terms().kinematics.com);
    let turned = model.rate_theta - without.rate_theta;
    let expected = |v: Vector3<f64>| Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0);
    let errors = [
        (turned.fixed_rows::<3>(0) - expected(force)).amax(),
        (turned.fixed_rows::<3>(3) - expected(moment)).amax(),
    ];
    assert_within!(errors[0].max(errors[1]), 1e-11, because "rounding of wrenches of 1000 N");
}

#[test]
fn links_on_one_body_are_not_kept_apart() {
    let robot = robot("ironcub_mk1");
    let mpc = experiment("test2_mpc").controller.law.mpc.unwrap();
    let mut config = mpc.clearance.unwrap();
    config.links = vec!["chest_l_jet_turbine".into()];
    config.apart_from = vec!["chest".into(), "root_link".into()];
    // Both chest exhausts and the turbine stand on the chest's body; the arms' exhausts and the root move.
    assert_eq!(Clearance::new(Some(&config), &robot, 1).unwrap().len(), 2 + 5);
    assert!(Clearance::new(None, &robot, 1).unwrap().is_empty());
    config.apart_from = vec!["tail".into()];
    let refused = Clearance::new(Some(&config), &robot, 1).unwrap_err().to_string();
    assert!(refused.contains("controller.mpc.clearance.apart_from"), "{refused}");
}

/// What a plan of a controller begins with.
fn present(controller: &Running) -> Present<'_> {
    Present { estimate: controller.state().estimate(), terms: controller.terms() }
}

/// Continuous dynamics of `(δp, δv, θ, δk, δT, δs, ṡ, e, Ṫ)`, from the model's matrices and the engines' slopes alone, with a
/// change of the wrench.
fn slope(
    model: &Linearised,
    now: Present,
    (kd, kp): (f64, f64),
    engines: &[Option<(f64, f64)>],
    x: &DVector<f64>,
    (u, wrench): (&[f64], &Vector6<f64>),
) -> DVector<f64> {
    let (jets, free) = (model.rate_t.ncols(), model.joints.len());
    let terms = now.terms;
    let mass = terms.kinematics.mass();
    let state = &now.estimate.robot.state;
    let omega = state.base_angular_velocity();
    let (v, theta, k): (Vector3<f64>, Vector3<f64>, Vector3<f64>) =
        (x.fixed_rows::<3>(3).into(), x.fixed_rows::<3>(6).into(), x.fixed_rows::<3>(9).into());
    let t = x.rows(12, jets);
    let s = x.rows(12 + jets, free);
    let sigma = x.rows(12 + jets + free, free);
    let e = x.rows(12 + jets + 2 * free, free);
    let now = DVector::from_fn(free, |place, _| state.joint_velocity()[model.joints[place]]);
    let away = sigma - &now;
    let rate = terms.momentum.rate_estimate
        + wrench
        + model.rate_v * v
        + model.rate_theta * theta
        + model.rate_k * k
        + &model.rate_t * t
        + &model.rate_s * s
        + &model.rate_sigma * &away;
    let turn = omega
        + model.omega_theta * theta
        + model.omega_k * k
        + &model.omega_s * s
        + &model.omega_sigma * &away;
    let mut dx = DVector::zeros(x.len());
    let velocity: Vector3<f64> = terms.dynamics.momentum.fixed_rows::<3>(0) / mass;
    dx.fixed_rows_mut::<3>(0).copy_from(&(velocity + v));
    dx.fixed_rows_mut::<3>(3).copy_from(&(rate.fixed_rows::<3>(0) / mass));
    dx.fixed_rows_mut::<3>(6).copy_from(&(turn + omega.cross(&theta) * 0.5));
    dx.fixed_rows_mut::<3>(9).copy_from(&rate.fixed_rows::<3>(3));
    for jet in 0..jets {
        let rate = 12 + jets + 3 * free + jet;
        match engines[jet] {
            None => dx[12 + jet] = u[jet],
            Some((by_thrust, by_rate)) => {
                dx[12 + jet] = x[rate];
                dx[rate] = by_thrust * x[12 + jet] + by_rate * x[rate] + u[jet];
            }
        }
    }
    for joint in 0..free {
        let command = u[jets + joint];
        dx[12 + jets + joint] = sigma[joint];
        dx[12 + jets + free + joint] = kd * (command - sigma[joint]) - kp * e[joint];
        dx[12 + jets + 2 * free + joint] = sigma[joint] - command;
    }
    dx
}

/// A step `h` of Runge-Kutta's method.
fn move_on(x: &DVector<f64>, h: f64, f: impl Fn(&DVector<f64>) -> DVector<f64>) -> DVector<f64> {
    let k1 = f(x);
    let k2 = f(&(x + &k1 * (h / 2.0)));
    let k3 = f(&(x + &k2 * (h / 2.0)));
    let k4 = f(&(x + &k3 * h));
    x + (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0)
}

/// Outputs (p, v, θ, ω, a, α) from the same matrices.
fn outputs(model: &Linearised, now: Present, x: &DVector<f64>, dx: &DVector<f64>) -> [Vector3<f64>; 6] {
    let terms = now.terms;
    let rows = |x: &DVector<f64>, first: usize| -> Vector3<f64> { x.fixed_rows::<3>(first).into() };
    let (jets, free) = (model.rate_t.ncols(), model.joints.len());
    let state = &now.estimate.robot.state;
    let speed = DVector::from_fn(free, |place, _| state.joint_velocity()[model.joints[place]]);
    let s = x.rows(12 + jets, free).into_owned();
    let sigma = x.rows(12 + jets + free, free).into_owned();
    let omega = state.base_angular_velocity()
        + model.omega_theta * rows(x, 6)
        + model.omega_k * rows(x, 9)
        + &model.omega_s * &s
        + &model.omega_sigma * (&sigma - speed);
    let alpha = model.omega_theta * rows(dx, 6)
        + model.omega_k * rows(dx, 9)
        + &model.omega_s * &sigma
        + &model.omega_sigma * dx.rows(12 + jets + free, free);
    [terms.kinematics.com + rows(x, 0), rows(dx, 0), rows(x, 6), omega, rows(dx, 3), alpha]
}

/// The cost that H and g have is that of the motion in fine steps, up to a constant, with ideal jets and with engines; also
/// where the first knot is long for the gains of the joints.
#[test]
fn the_horizon_is_the_motion_in_fine_steps() {
    fine_steps(JetDynamics::Ideal, None);
    fine_steps(JetDynamics::Throttled, None);
    fine_steps(JetDynamics::Throttled, Some(&[0.08, 0.08, 0.08, 0.08, 0.16, 0.16, 0.16, 0.16]));
}

fn fine_steps(dynamics: JetDynamics, knots: Option<&[f64]>) {
    let config = experiment("test2_mpc");
    let mut mpc = config.controller.law.mpc.clone().unwrap();
    mpc.knots = knots.map_or(mpc.knots, <[f64]>::to_vec);
    let case = Case::draw(3);
    let controller = case.controller(&config);
    let mut estimate = controller.state().estimate().clone();
    estimate.thrust_rate.copy_from_slice(&[20.0, -30.0, 4.0, 0.0]);
    let now = Present { estimate: &estimate, terms: controller.terms() };
    let joints = moved_joints(&config, &case.robot);
    let (jets, free) = (case.thrust.len(), joints.len());
    let jets_of = |dynamics| case.robot.jet_models(dynamics);
    let engines: Vec<Option<(f64, f64)>> = (jets_of(dynamics).iter().zip(&case.thrust))
        .map(|(jet, thrust)| jet.engine.map(|engine| engine.steady_slopes(*thrust, 0.0)))
        .collect();
    let mut model = Linearised::new(&case.robot, joints.clone());
    assert!(model.update(&case.robot, &axisymmetric(&case.robot), Air::Linear, now));
    let gains = (20.0, 100.0);
    let mut horizon = Horizon::new(&mpc, gains, &case.robot, jets_of(dynamics), &joints).unwrap();
    let mut rng = rng(5);
    let targets: Vec<Target> = (0..horizon.knots())
        .map(|_| Target {
            com: [(); 3].map(|()| random_vector(&mut rng, 1.0)),
            rotation: random_vector(&mut rng, 0.3),
            angular: [(); 2].map(|()| random_vector(&mut rng, 1.0)),
        })
        .collect();
    let wrench = |_: &Target| stack(&random_vector(&mut rng, 60.0), &random_vector(&mut rng, 4.0));
    let wrenches: Vec<Vector6<f64>> = targets.iter().map(wrench).collect();
    let n = case.robot.joints.len();
    let posture = DVector::from_fn(n, |_, _| rng.random_range(-0.5..0.5));
    horizon.update(&model, now, &posture, (&targets, &wrenches), false);

    let [posture_weights, _] = mpc.posture_weights(&case.robot, &joints);
    let cost = |inputs: &[f64]| {
        let weights = &mpc.weights;
        let mut x = DVector::zeros(12 + 2 * jets + 3 * free);
        for (jet, engine) in engines.iter().enumerate() {
            x[12 + jets + 3 * free + jet] = engine.map_or(0.0, |_| estimate.thrust_rate[jet]);
        }
        for (place, joint) in joints.iter().enumerate() {
            x[12 + jets + free + place] = case.state.joint_velocity()[*joint];
        }
        let (mut total, mut before) = (0.0, Vector6::zeros());
        for (knot, duration) in mpc.knots.iter().enumerate() {
            let mean = (before + wrenches[knot]) / 2.0;
            before = wrenches[knot];
            let u: Vec<f64> = (0..jets)
                .map(|jet| inputs[horizon.thrust_input(knot, jet)])
                .chain((0..free).map(|joint| inputs[horizon.joint_velocity(knot, joint)]))
                .collect();
            let steps = 40;
            let h = duration / f64::from(steps);
            for _ in 0..steps {
                x = move_on(&x, h, |x| slope(&model, now, gains, &engines, x, (&u, &mean)));
            }
            let dx = slope(&model, now, gains, &engines, &x, (&u, &wrenches[knot]));
            let [p, v, theta, omega, a, alpha] = outputs(&model, now, &x, &dx);
            let target = &targets[knot];
            let (p, v, a) = (p - target.com[0], v - target.com[1], a - target.com[2]);
            let (theta, omega, alpha) =
                (theta - target.rotation, omega - target.angular[0], alpha - target.angular[1]);
            let weigh = |error: &Vector3<f64>, weights: [f64; 3]| -> f64 {
                error.iter().zip(weights).map(|(error, weight)| weight * error * error).sum()
            };
            let mut of_knot = weigh(&p, weights.position)
                + weigh(&v, weights.velocity)
                + weigh(&theta, weights.attitude)
                + weights.angular_velocity * omega.norm_squared()
                + weights.acceleration * a.norm_squared()
                + weights.angular_acceleration * alpha.norm_squared();
            for (place, joint) in joints.iter().enumerate() {
                let position = case.state.joint_position[*joint] + x[12 + jets + place] - posture[*joint];
                let velocity = x[12 + jets + free + place];
                of_knot += posture_weights[place] * position * position
                    + weights.joint_velocity * velocity * velocity
                    + weights.joint_command * u[jets + place] * u[jets + place];
            }
            for (jet, engine) in engines.iter().enumerate() {
                let rate = engine.map_or(u[jet], |_| x[12 + jets + 3 * free + jet]);
                let input = engine.map_or(0.0, |_| 0.03 * u[jet]);
                of_knot += weights.thrust_rate * (rate * rate + input * input);
            }
            total += 0.5 * duration * of_knot;
            if knot + 1 == mpc.knots.len() {
                let d = 3.0;
                total += 0.5 * weights.tail[0] * (a + v * (2.0 * d) + p * (d * d)).norm_squared();
                total += 0.5 * weights.tail[1] * (alpha + omega * (2.0 * d) + theta * (d * d)).norm_squared();
            }
        }
        total
    };
    let size = horizon.problem.len();
    let at_rest = cost(&vec![0.0; size]);
    for _ in 0..5 {
        let u: Vec<f64> = (0..size)
            .map(|unknown| {
                rng.random_range(-1.0..1.0) * if unknown < jets * mpc.knots.len() { 60.0 } else { 0.6 }
            })
            .collect();
        let (found, expected) = (horizon.problem.objective(&u), cost(&u) - at_rest);
        assert_within!(
            (found - expected).abs() / expected.abs().max(at_rest),
            1e-7,
            because "fourth-order steps of 4 ms at K_D = 20 1/s",
            "{found} {expected}"
        );
    }
}

/// The plan is the minimum of its cost with all values beyond their limits, also where many are; of a descent too, where
/// distances weigh less.
#[test]
fn a_plan_minimises_the_cost_with_all_excesses() {
    for is_descending in [false, true] {
        check_excesses(is_descending);
    }
}

fn check_excesses(is_descending: bool) {
    let config = experiment("test2_mpc");
    let mut mpc = config.controller.law.mpc.clone().unwrap();
    let of_descent = 300.0;
    mpc.descent.as_mut().unwrap().clearance = Some(of_descent);
    let mut case = Case::draw(11);
    for (position, joint) in case.state.joint_position.iter_mut().zip(&case.robot.joints) {
        *position = joint.limits.1 - 0.02;
    }
    case.thrust = case.robot.jets.iter().map(|jet| jet.thrust_max - 1.0).collect();
    // One engine is below its least thrust.
    (case.thrust[1], case.robot.jets[1].thrust_min) = (20.0, 40.0);
    let controller = case.controller(&config);
    let now = present(&controller);
    let terms = now.terms;
    let joints = moved_joints(&config, &case.robot);
    let (jets, free) = (case.thrust.len(), joints.len());
    let limits: Vec<(f64, f64)> = case.robot.joints.iter().map(|joint| joint.limits).collect();
    let mut model = Linearised::new(&case.robot, joints.clone());
    assert!(model.update(&case.robot, &axisymmetric(&case.robot), Air::Linear, now));
    let ideal = case.robot.jet_models(JetDynamics::Ideal);
    let mut horizon = Horizon::new(&mpc, (20.0, 100.0), &case.robot, ideal, &joints).unwrap();
    let zeros = DVector::zeros(case.robot.joints.len());
    let targets = vec![
        Target {
            com: [terms.kinematics.com + Vector3::z(), Vector3::z(), Vector3::zeros()],
            ..Target::default()
        };
        horizon.knots()
    ];
    let calm = vec![Vector6::zeros(); horizon.knots()];
    horizon.update(&model, now, &zeros, (&targets, &calm), is_descending);
    let base = horizon.problem.clone();
    for knot in 0..horizon.knots() {
        for jet in 0..jets {
            let unknown = horizon.thrust_input(knot, jet);
            (horizon.problem.lower[unknown], horizon.problem.upper[unknown]) = (-100.0, 100.0);
        }
        for joint in 0..free {
            let unknown = horizon.joint_velocity(knot, joint);
            (horizon.problem.lower[unknown], horizon.problem.upper[unknown]) = (-0.8, 0.8);
        }
    }
    let search = |of_another_plan: f64| {
        let (mut horizon, mut inputs) = (horizon.clone(), vec![of_another_plan; base.len()]);
        let (mut solver, mut plan) = (PrimalActiveSet::new(base.len()), Plan::none(base.len(), 0));
        let Horizon { problem, .. } = &horizon;
        assert_eq!(solver.solve(problem).status, QpStatus::Solved);
        let first = solver.x().to_vec();
        let (solver, inputs) = (&mut solver, inputs.as_mut_slice());
        assert!(PredictiveLaw::search(&mut horizon, solver, &model, now, &limits, inputs, &mut plan));
        (plan, first, solver.x().to_vec())
    };
    let (plan, first, inputs) = search(0.0);
    assert_ne!(first, inputs, "no value was beyond its limit");
    assert_eq!(search(f64::NAN), (plan.clone(), first, inputs.clone()), "another plan counts");
    assert!(case.thrust[1] + mpc.knots[0] * inputs[horizon.thrust_input(0, 1)] < 40.0);

    // The factorisations of all QPs count together; where they do not suffice, the last plan stays.
    let needed = plan.answer().unwrap().iterations;
    for limit in [1, needed - 1, needed] {
        let (mut horizon, mut inputs) = (horizon.clone(), vec![0.0; base.len()]);
        let mut solver = PrimalActiveSet::new(base.len()).with_iteration_limit(limit);
        let mut plan = Plan::none(base.len(), 0);
        let is_found =
            PredictiveLaw::search(&mut horizon, &mut solver, &model, now, &limits, &mut inputs, &mut plan);
        let answer = plan.answer().unwrap();
        assert!(answer.iterations <= limit);
        let expected = if limit < needed { QpStatus::IterationLimit } else { QpStatus::Solved };
        assert_eq!((is_found, answer.status), (limit >= needed, expected));
    }

    let (least_distance, weight) = (0.03, if is_descending { of_descent } else { 5e3 });
    assert!(horizon.clearance.distance.iter().any(|distance| *distance < least_distance));
    // Thrusts, joint positions and distances at the knots, written anew; joints in fine steps.
    let cost = |u: &[f64]| {
        let mut total = base.objective(u);
        for jet in 0..jets {
            let mut thrust = case.thrust[jet];
            for (knot, duration) in mpc.knots.iter().enumerate() {
                thrust += duration * u[horizon.thrust_input(knot, jet)];
                let (low, high) = (case.robot.jets[jet].thrust_min, case.robot.jets[jet].thrust_max);
                let over = thrust - thrust.clamp(low, high);
                total += 0.5 * mpc.thrust_excess * over * over;
            }
        }
        let mut moved = vec![vec![0.0; free]; mpc.knots.len()];
        for (place, joint) in joints.iter().enumerate() {
            let (position, velocity) =
                (case.state.joint_position[*joint], case.state.joint_velocity()[*joint]);
            let mut x = DVector::from_vec(vec![position, velocity, 0.0]);
            for (knot, duration) in mpc.knots.iter().enumerate() {
                let command = u[horizon.joint_velocity(knot, place)];
                let h = duration / 40.0;
                for _ in 0..40 {
                    x = move_on(&x, h, |x| {
                        DVector::from_vec(vec![x[1], 20.0 * (command - x[1]) - 100.0 * x[2], x[1] - command])
                    });
                }
                let (low, high) = limits[*joint];
                let over = x[0] - x[0].clamp(low, high);
                total += 0.5 * 1e3 * over * over;
                moved[knot][place] = x[0] - case.state.joint_position[*joint];
            }
        }
        let clearance = &horizon.clearance;
        for moved in &moved {
            for (pair, distance) in clearance.distance.iter().enumerate() {
                let change: f64 =
                    clearance.by_joint.column(pair).iter().zip(moved).map(|(by, moved)| by * moved).sum();
                let under = (least_distance - distance - change).max(0.0);
                total += 0.5 * weight * under * under;
            }
        }
        total
    };
    let least = cost(&inputs);
    let mut rng = rng(2);
    for _ in 0..200 {
        let size = 10.0_f64.powf(rng.random_range(-3.0..0.0));
        let other: Vec<f64> = (inputs.iter().enumerate())
            .map(|(unknown, input)| {
                let (low, high) = (horizon.problem.lower[unknown], horizon.problem.upper[unknown]);
                (input + size * rng.random_range(-1.0..1.0) * high).clamp(low, high)
            })
            .collect();
        let change = cost(&other) - least;
        assert!(change >= -1e-9 * least.abs(), "a better plan: {change:e} of {least}");
    }
}

/// The law without a plan is the momentum law; with one it follows it, also between two plans.
#[test]
fn the_law_plans_every_period() {
    let mut config = experiment("test2_mpc");
    config.controller.law.mpc.as_mut().unwrap().period = 0.03;
    let robot = load_robot(&config.robot).unwrap();
    let case = Case { state: Loop::new(&config).plant.state().clone(), ..Case::draw(0) };
    let mut controller = Running::new(config.controller(robot).unwrap());
    let thrust = Loop::new(&config).plant.jets().thrust().to_vec();
    let mut answers = Vec::new();
    for tick in 0..7 {
        let wind = Vector3::new(0.0, -5.0, 0.1 * f64::from(tick));
        let sample = Measurement { wind, ..at(0.01 * f64::from(tick), &case.state, &thrust) };
        let command = controller.tick(&sample);
        assert!(!command.modes.intersects(Modes::OF_SOLVERS));
        answers.push(command.rates_qp.kkt);
    }
    assert!(answers[0] == answers[1] && answers[1] == answers[2] && answers[2] != answers[3]);
    assert!(answers[3] == answers[5] && answers[5] != answers[6]);
}

/// Set-points of a mission that are given from outside, with those that follow, give the commands of the mission; without
/// the latter, or with a part that is not valid, others.
#[test]
fn a_given_future_is_followed_as_that_of_the_mission() {
    let config = experiment("test2_mpc");
    let mut world = Loop::new(&config);
    let wind = Vector3::new(0.0, -3.0, 0.0);
    world.plant.observe(&wind);
    let [mut informed, mut uninformed, mut misled] = [(); 3].map(|()| {
        let robot = load_robot(&config.robot).unwrap();
        Running::new(config.controller(robot).unwrap())
    });
    // The forward command begins 0.1 s after the start.
    let time = |tick: usize| 19.9 + 0.01 * tick as f64;
    let generator = informed.setpoint_generator().clone();
    let mut state = generator.start(world.plant.kinematics().com, &world.plant.state().base.rotation);
    let setpoints: Vec<Setpoint> = (0..100).map(|tick| generator.update(&mut state, time(tick))).collect();
    let (mut error, mut difference) = (0.0_f64, 0.0_f64);
    for tick in 0..20 {
        world.plant.observe(&wind);
        let (seen, thrust) = (world.plant.state(), world.plant.jets().thrust_feedback());
        let measurement = Measurement { wind, ..at(time(tick), seen, thrust) };
        let rates = |command: &Command| command.thrust_rate.clone();
        let expected = rates(world.controller.tick(&measurement));
        let next: Vec<(f64, Setpoint)> =
            (1..80).map(|after| (0.01 * after as f64, setpoints[tick + after])).collect();
        let mut unordered = next.clone();
        unordered.swap(3, 4);
        let setpoint = setpoints[tick];
        let ticked = |controller: &mut Running, setpoints: &[(f64, Setpoint)]| {
            let preview = Preview { setpoints, ..Preview::default() };
            let given = Given { setpoint: Some(&setpoint), preview, ..Given::default() };
            let command = controller.tick_with(&measurement, &given);
            (rates(command), command.modes)
        };
        let (found, modes) = ticked(&mut informed, &next);
        assert_eq!(modes, Modes::default());
        error = error.max((found - &expected).amax());
        let (without, modes) = ticked(&mut uninformed, &[]);
        assert_eq!(modes, Modes::default());
        assert_eq!(ticked(&mut misled, &unordered), (without.clone(), Modes::PREVIEW_IGNORED));
        difference = difference.max((without - &expected).amax());
        world.advance(&wind);
    }
    assert_within!(error, 1e-7, because "rounding of set-points, through a QP of condition 1e8");
    assert!(difference > 1.0, "the future made no difference: {difference} N/s");
}

/// A plan towards set-points that turn is the same, seen from the robot, whatever its heading is.
#[test]
fn a_plan_turns_with_the_heading() {
    let config = experiment("test2_mpc");
    let robot = load_robot(&config.robot).unwrap();
    let start = config.simulator.initial.state();
    let plan = |heading: f64, acceleration: f64| {
        let turn = exp_so3(&(Vector3::z() * heading));
        let mut state = start.clone();
        state.base.rotation = turn * start.base.rotation;
        state.base.position = turn * start.base.position;
        let mut controller = Running::new(config.controller(robot.clone()).unwrap());
        let sample = at(0.0, &state, &config.simulator.initial.thrust);
        controller.controller.start(&sample).unwrap();
        let com = controller.terms().kinematics.com;
        let now = Setpoint::at_rest(com, state.base.rotation);
        let angular = Setpoint { angular_acceleration_b: Vector3::new(0.3, 0.5, 0.2) * acceleration, ..now };
        let setpoints: Vec<_> = (1..80).map(|after| (0.01 * f64::from(after), angular)).collect();
        let preview = Preview { setpoints: &setpoints, ..Preview::default() };
        let given = Given { setpoint: Some(&now), preview, ..Given::default() };
        let command = controller.tick_with(&sample, &given);
        assert_eq!(command.modes, Modes::default());
        (command.thrust_rate.clone(), command.joint_velocity.clone())
    };
    let apart = |one: &(DVector<f64>, DVector<f64>), other: &(DVector<f64>, DVector<f64>)| {
        (&one.0 - &other.0).amax() + (&one.1 - &other.1).amax()
    };
    let expected = plan(0.0, 1.0);
    assert!(apart(&plan(0.0, 0.0), &expected) > 0.1);
    // Weights are by axes of the world, alike at half a turn.
    let error = apart(&plan(std::f64::consts::PI, 1.0), &expected);
    assert_within!(error, 1e-6, because "rounding of the robot's rotation, through a QP of condition 1e8");
}

/// A plan has the change of the wind from the present one, as the forces in it; what is not valid it does not have.
#[test]
fn a_plan_expects_the_wind_ahead() {
    let config = experiment("test2_mpc");
    let world = Loop::new(&config);
    let plan = |wind: &[(f64, Vector3<f64>)]| {
        let robot = load_robot(&config.robot).unwrap();
        let mut controller = Running::new(config.controller(robot).unwrap());
        let (state, thrust) = (world.plant.state(), world.plant.jets().thrust_feedback());
        let preview = Preview { wind, ..Preview::default() };
        let command = controller.tick_with(&at(0.0, state, thrust), &Given { preview, ..Given::default() });
        (command.modes, command.thrust_rate.clone())
    };
    let side = Vector3::new(0.0, -8.0, 0.0);
    let without = plan(&[]);
    assert_eq!(plan(&[(0.0, side)]), without, "a wind that lasts is no change");
    let (modes, rates) = plan(&[(0.0, Vector3::zeros()), (0.3, Vector3::zeros()), (0.5, side)]);
    assert_eq!(modes, Modes::default());
    assert!((&rates - &without.1).amax() > 1.0, "{rates} {}", without.1);
    for bad in
        [[(0.0, side), (0.0, side)], [(-0.1, side), (0.1, side)], [(0.0, side), (0.1, side * f64::NAN)]]
    {
        assert_eq!(plan(&bad), (Modes::PREVIEW_IGNORED, without.1.clone()));
    }
}
