//! Residuals: what a policy observes and how it acts, how a residual is added, and which cards are refused.
//! `tests/parity/test_jax_policy.py` compares policies with JAX.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::network::{Tensor, digest, file_of};
use crate::common::{
    Loop, Running, TIME_STEP, assert_says, assert_within, at, experiment, random_state, random_vector, rng,
    robot,
};
use flight_core::control::law::residual::{Policy, Residual};
use flight_core::control::{Given, Modes};
use flight_core::spatial::{exp_so3, log_so3};
use flight_core::{BuildError, Controller, RobotModel, RobotState};
use flight_io::{PolicyConfig, load_policy};
use nalgebra::{DMatrix, DVector, Vector3, Vector6};
use rand::RngExt;
use serde_json::{Value, json};
use tempfile::tempdir;

const FEATURES: [&str; 7] =
    ["gravity", "rotation", "position", "velocity", "angular_velocity", "force", "moment"];
const HIDDEN: usize = 5;
const INPUTS: usize = 21;
const ACTIONS: usize = 27;
const SCALE: [f64; 7] = [0.3, 3.0, 2.0, 0.5, 0.4, 8.0, 7.0];
const THRUST_RATE: f64 = 40.0;
const JOINT_VELOCITY: f64 = 0.7;

/// `W₁, b₁, W₂, W₃, b₂`, by row.
type Weights = [Vec<f32>; 5];

fn weights(draw: &mut impl FnMut() -> f32) -> Weights {
    [HIDDEN * INPUTS, HIDDEN, ACTIONS * HIDDEN, ACTIONS * INPUTS, ACTIONS]
        .map(|count| (0..count).map(|_| draw()).collect())
}

fn tensors([hidden, hidden_bias, output, direct, output_bias]: Weights) -> Vec<Tensor> {
    vec![
        ("hidden.weight".into(), vec![HIDDEN, INPUTS], hidden),
        ("hidden.bias".into(), vec![HIDDEN], hidden_bias),
        ("output.weight".into(), vec![ACTIONS, HIDDEN], output),
        ("direct.weight".into(), vec![ACTIONS, INPUTS], direct),
        ("output.bias".into(), vec![ACTIONS], output_bias),
    ]
}

/// Loads a policy with this card, changed at these places.
fn load(robot: &RobotModel, tensors: &[Tensor], changes: &[(&str, Value)]) -> Result<Policy, BuildError> {
    let (folder, weights) = (tempdir().unwrap(), file_of(tensors));
    let names = |of: Vec<&str>| of.into_iter().map(str::to_owned).collect::<Vec<_>>();
    let mut card = json!({
        "format": "flight-policy",
        "version": 1,
        "name": "small",
        "description": "Drawn weights.",
        "weights": {"file": "small.safetensors", "sha256": digest(&weights)},
        "inputs": {"features": FEATURES, "scale": SCALE},
        "output": {
            "jets": names(robot.jet_names().collect()),
            "joints": names(robot.joints.iter().map(|joint| joint.name.as_str()).collect()),
            "thrust_rate": THRUST_RATE,
            "joint_velocity": JOINT_VELOCITY,
        },
        "architecture": {"hidden": HIDDEN},
        "training": {},
    });
    for (pointer, value) in changes {
        *card.pointer_mut(pointer).unwrap() = value.clone();
    }
    let path = folder.path().join("small.json");
    std::fs::write(&path, card.to_string()).unwrap();
    std::fs::write(folder.path().join("small.safetensors"), weights).unwrap();
    load_policy(&PolicyConfig { card: path }, robot)
}

/// TEST1's controller, in wide bounds.
fn controller() -> Controller {
    experiment("test1").controller(robot("ironcub_mk1")).unwrap()
}

/// A robot in a posture within its limits that turns and moves, and its thrusts.
fn sample(robot: &RobotModel, seed: u64) -> (RobotState, Vec<f64>) {
    let mut rng = rng(seed);
    let mut state = random_state(&mut rng, robot);
    for (position, joint) in state.joint_position.iter_mut().zip(&robot.joints) {
        *position = 0.5 * (joint.limits.0 + joint.limits.1);
    }
    (state, vec![100.0; robot.jets.len()])
}

/// A first tick, then one of another state, as if it had been pushed there: set-point and wrench are then not zero.
fn two_ticks(controller: Controller) -> (Running, [Vector6<f64>; 2], RobotState) {
    let robot = robot("ironcub_mk1");
    let (mut state, thrust) = sample(&robot, 1);
    state.velocity.fill(0.0);
    let mut running = Running::new(controller);
    running.tick(&at(0.0, &state, &thrust));
    let first = running.controller.terms();
    let (momentum, rate) = (first.dynamics.momentum, first.momentum.rate_estimate);
    let mut rng = rng(2);
    state.base.position += random_vector(&mut rng, 0.02);
    state.base.rotation *= exp_so3(&random_vector(&mut rng, 0.03));
    for (index, velocity) in state.velocity.as_mut_slice()[..6].iter_mut().enumerate() {
        *velocity = 0.02 * (index as f64 - 2.3);
    }
    running.tick(&at(TIME_STEP, &state, &thrust));
    // M84 with a gain of 3 s⁻¹, not limited.
    let moved = running.controller.terms().dynamics.momentum;
    let wrench = (1.0 - (-3.0 * TIME_STEP).exp()) * ((moved - momentum) / TIME_STEP - rate);
    let third = running.controller.terms().momentum.rate_estimate;
    running.tick(&at(2.0 * TIME_STEP, &state, &thrust));
    let again = running.controller.terms().dynamics.momentum;
    let next = wrench + (1.0 - (-3.0 * TIME_STEP).exp()) * ((again - moved) / TIME_STEP - third - wrench);
    (running, [wrench, next], state)
}

/// What is observed, by other formulas than those of the crate; the wrench is that of the tick before.
fn expected_features(running: &Running, state: &RobotState, wrench: &Vector6<f64>) -> DVector<f64> {
    let (terms, model) = (running.controller.terms(), running.controller.model());
    let (base, due) = (state.base.rotation, terms.due);
    let b_from_i = base.try_inverse().unwrap();
    let turn = log_so3(&(due.rotation.transpose() * base));
    let rotation = if turn.norm() > 0.0 { turn.normalize() * turn.norm().sin() } else { turn };
    let velocity = &state.velocity;
    let thrusts: f64 = model.jets.iter().map(|jet| jet.thrust_max).sum();
    let parts = [
        b_from_i * Vector3::new(0.0, 0.0, -1.0),
        rotation,
        b_from_i * (terms.kinematics.com - due.com_position),
        b_from_i * (Vector3::new(velocity[0], velocity[1], velocity[2]) - due.com_velocity),
        b_from_i * Vector3::new(velocity[3], velocity[4], velocity[5])
            - b_from_i * due.rotation * due.angular_velocity_b,
        b_from_i * Vector3::new(wrench[0], wrench[1], wrench[2]) / (0.1 * thrusts),
        b_from_i * Vector3::new(wrench[3], wrench[4], wrench[5]) / (0.01 * thrusts),
    ];
    DVector::from_iterator(
        INPUTS,
        parts.iter().zip(SCALE).flat_map(|(part, scale)| [scale * part.x, scale * part.y, scale * part.z]),
    )
}

/// Every feature with its own sign, factor and axis, seen through a policy that shows one input in each action.
#[test]
fn what_is_observed_is_the_law_of_the_model() {
    let robot = robot("ironcub_mk1");
    let mut shown = weights(&mut || 0.0);
    for index in 0..INPUTS {
        shown[3][index * INPUTS + index] = 0.25;
    }
    let mut controller = controller();
    controller.set_policy(load(&robot, &tensors(shown), &[]).unwrap());
    let (running, [wrench, next], state) = two_ticks(controller);
    let expected = expected_features(&running, &state, &wrench);
    assert!(expected.iter().all(|x| x.abs() > 1e-4), "{expected}");
    let residual = &running.controller.terms().residual;
    for index in 0..INPUTS {
        let scale = if index < 4 { THRUST_RATE } else { JOINT_VELOCITY };
        let found = (residual[index] / scale).atanh() / 0.25;
        assert_within!((found - expected[index]).abs() / (1.0 + expected[index].powi(2)), 1e-11, "{index}");
    }
    // Momenta of 100 N s over a step round by 1e-12 N.
    assert_within!((running.state().residual_wrench() - next).amax(), 1e-9);
}

/// `a = tanh(W₂ tanh(W₁ x + b₁) + W₃ x + b₂)`, in sums of nalgebra.
#[test]
fn the_action_is_that_of_the_weights() {
    let robot = robot("ironcub_mk1");
    let mut rng = rng(3);
    let drawn = weights(&mut || rng.random_range(-0.4..0.4_f32));
    let mut controller = controller();
    controller.set_policy(load(&robot, &tensors(drawn.clone()), &[]).unwrap());
    let (running, [wrench, _], state) = two_ticks(controller);
    let x = expected_features(&running, &state, &wrench);
    let matrix = |numbers: &[f32], columns: usize| {
        DMatrix::from_row_iterator(numbers.len() / columns, columns, numbers.iter().map(|x| f64::from(*x)))
    };
    let [w1, b1, w2, w3, b2] = [&drawn[0], &drawn[1], &drawn[2], &drawn[3], &drawn[4]];
    let units = (matrix(w1, INPUTS) * &x + matrix(b1, 1)).map(f64::tanh);
    let action = (matrix(w2, HIDDEN) * units + matrix(w3, INPUTS) * &x + matrix(b2, 1)).map(f64::tanh);
    for (index, found) in running.controller.terms().residual.iter().enumerate() {
        let scale = if index < 4 { THRUST_RATE } else { JOINT_VELOCITY };
        assert_within!((found - scale * action[index]).abs(), 1e-11 * scale, "{index}");
    }
}

fn tick(controller: Controller, residual: Option<&Residual>) -> Running {
    let initial = experiment("test1").simulator.initial;
    let (state, thrust) = (initial.state(), initial.thrust);
    let mut running = Running::new(controller);
    running.tick_with(&at(0.0, &state, &thrust), &Given { residual, ..Given::default() });
    running
}

/// Added or in place of the answer, between the bounds; joints accelerate towards the sum by `K_D`.
#[test]
fn a_residual_is_added_within_the_bounds() {
    let own = tick(controller(), None);
    let (rates, velocities) =
        ([30.0, -20.0, 1e4, -1e4], DVector::from_fn(23, |joint, _| 0.3 - 0.02 * joint as f64));
    let own_command = own.controller.command();
    for replaces in [false, true] {
        let residual = Residual { thrust_rate: &rates, joint_velocity: velocities.as_slice(), replaces };
        let steered = tick(controller(), Some(&residual));
        let (command, terms) = (steered.controller.command(), steered.controller.terms());
        let problem = &terms.momentum_qp.problem;
        let kept = f64::from(u8::from(!replaces));
        for (jet, rate) in rates.iter().enumerate() {
            let wanted = kept * own_command.thrust_rate[jet] + rate;
            assert_eq!(
                command.thrust_rate[jet],
                wanted.clamp(problem.lower[jet], problem.upper[jet]),
                "{jet}"
            );
        }
        assert!(command.thrust_rate[0].abs() < problem.upper[0], "one within, one at each bound");
        let kd = experiment("test1").controller.law.torque.kd;
        for joint in 0..23 {
            let wanted = kept * own_command.joint_velocity[joint] + velocities[joint];
            let unknown = 4 + joint;
            let wanted = wanted.clamp(problem.lower[unknown], problem.upper[unknown]);
            assert_eq!(command.joint_velocity[joint], wanted, "{joint}");
            assert_within!((terms.torque_qp.acceleration_desired[joint] - kd * wanted).abs(), 1e-9);
        }
        assert_eq!(command.modes, Modes::default());
    }
}

/// One that is not finite, or of another robot, is named and changes nothing else.
#[test]
fn a_residual_that_is_no_number_is_not_used() {
    let own = tick(controller(), None);
    let (good, bad) = ([0.0; 23], [f64::NAN; 23]);
    for (what, thrust_rate, joint_velocity) in [
        ("NaN", &[0.0; 4][..], &bad),
        ("infinite", &[f64::INFINITY, 0.0, 0.0, 0.0], &good),
        ("three jets", &[0.0; 3], &good),
    ] {
        let residual = Residual { thrust_rate, joint_velocity, replaces: true };
        let steered = tick(controller(), Some(&residual));
        let (command, before) = (steered.controller.command(), own.controller.command());
        assert_eq!(command.modes, Modes::RESIDUAL_IGNORED, "{what}");
        assert_eq!(command.thrust_rate, before.thrust_rate, "{what}");
        assert_eq!(command.joint_torque, before.joint_torque, "{what}");
    }
    assert!(own.controller.command().modes.is_empty());
}

/// A refusal names key, value and expectation.
#[test]
fn cards_and_weights_of_others_are_refused() {
    let robot = robot("ironcub_mk1");
    let sound = tensors(weights(&mut || 0.1));
    load(&robot, &sound, &[]).unwrap();
    for (pointer, value, words) in [
        ("/format", json!("flight-aero-network"), &["small.json: `format` is", "expected flight-policy"][..]),
        ("/version", json!(2), &["`version` is 2; expected 1"]),
        ("/weights/sha256", json!("00"), &["`weights.sha256` is 00; expected", "the hash of"]),
        ("/weights/file", json!("../small.safetensors"), &["`weights.file`", "beside the card"]),
        ("/inputs/features", json!([]), &["`inputs.features` is empty; expected at least one"]),
        ("/inputs/features/1", json!("gravity"), &["`inputs.features` is Gravity twice; expected each once"]),
        (
            "/inputs/features/1",
            json!("wind"),
            &["`inputs.features[1]` is \"wind\"; expected one of gravity, rotation"],
        ),
        ("/inputs/scale", json!([1.0]), &["`inputs.scale` is 1 numbers; expected 7"]),
        ("/output/jets/0", json!("nose"), &["`output.jets`", "nose", "as of"]),
        ("/output/joints", json!([]), &["`output.joints`", "torso"]),
        ("/output/thrust_rate", json!(-1.0), &["`output.thrust_rate` is -1; expected a number ≥ 0"]),
        ("/output/joint_velocity", json!(-2.0), &["`output.joint_velocity` is -2; expected a number ≥ 0"]),
        ("/architecture/hidden", json!(0), &["`architecture.hidden` is 0; expected 1 to 4096 units"]),
        ("/architecture/hidden", json!(6), &["shape of tensor `hidden.weight`", "[6, 21]"]),
        ("/architecture", json!({"hidden": 5, "layers": 2}), &["unknown key `architecture.layers`"]),
    ] {
        assert_says(&load(&robot, &sound, &[(pointer, value)]).unwrap_err(), words);
    }
    let mut spoilt = sound.clone();
    spoilt[3].2[7] = f32::NAN;
    assert_says(&load(&robot, &spoilt, &[]).unwrap_err(), &["entry 7 of tensor `direct.weight`", "NaN"]);
    assert_says(
        &load(&robot, &sound[1..], &[]).unwrap_err(),
        &["names `hidden.weight`, which does not exist"],
    );
    let mut more = sound;
    more.push(("more".into(), vec![1], vec![0.0]));
    assert_says(&load(&robot, &more, &[]).unwrap_err(), &["tensor `more` belongs to no layer"]);
}

/// A residual that is given in every tenth tick only, or a base that is measured in every second one, shows the wrench that
/// is observed in every tick.
#[test]
fn the_wrench_does_not_depend_on_when_residuals_are_given_or_the_base_is_measured() {
    let wind = Vector3::new(0.0, -6.0, 0.0);
    let wrench = |is_given: fn(usize) -> bool, is_measured: fn(usize) -> bool| {
        let mut world = Loop::new(&experiment("test1"));
        let sizes = (world.controller.n_jets(), world.plant.robot().joints.len());
        let (thrust_rate, joint_velocity) = (&vec![0.0; sizes.0][..], &vec![0.0; sizes.1][..]);
        let zero = Residual { thrust_rate, joint_velocity, replaces: false };
        for tick in 0..=200 {
            world.plant.observe(&wind);
            let mut sample = world.sample(wind);
            if !is_measured(tick) {
                sample.state.velocity.rows_mut(0, 6).fill(f64::NAN);
            }
            let given = Given { residual: is_given(tick).then_some(&zero), ..Given::default() };
            world.controller.tick_with(&sample.measurement(), &given);
            world.advance(&wind);
        }
        world.controller.state().residual_wrench()
    };
    let always = wrench(|_| true, |_| true);
    assert!(always.norm() > 4.0, "{always}");
    assert_eq!(wrench(|tick| tick % 10 == 0, |_| true), always);
    let slowly = wrench(|_| true, |tick| tick % 2 == 0);
    assert!((slowly - always).norm() < 0.05 * always.norm(), "{slowly} {always}");
}
