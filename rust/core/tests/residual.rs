//! Residuals: how one is added, and which cards are refused. `tests/parity/test_jax_policy.py` holds what a policy
//! observes and does to JAX.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::network::{Tensor, digest, file_of};
use crate::common::{Loop, Running, assert_says, assert_within, at, experiment, robot};
use flight_core::control::law::residual::{Policy, Residual};
use flight_core::control::{Given, Modes};
use flight_core::{BuildError, Controller, RobotModel};
use flight_io::{PolicyConfig, load_policy};
use nalgebra::{DVector, Vector3};
use serde_json::{Value, json};
use tempfile::tempdir;

const FEATURES: [&str; 10] = [
    "gravity",
    "rotation",
    "position",
    "velocity",
    "angular_velocity",
    "joint_position",
    "joint_velocity",
    "thrust",
    "force",
    "moment",
];
const HIDDEN: [usize; 2] = [5, 3];
const INPUTS: usize = 71;
const ACTIONS: usize = 27;
const SCALE: [f64; 10] = [0.3, 3.0, 2.0, 0.5, 0.4, 0.7, 0.9, 1.1, 8.0, 7.0];
const THRUST_RATE: f64 = 40.0;
const JOINT_VELOCITY: f64 = 0.7;

fn tensors(draw: &mut impl FnMut() -> f32) -> Vec<Tensor> {
    let shapes: [(&str, &[usize]); 7] = [
        ("hidden.0.weight", &[HIDDEN[0], INPUTS]),
        ("hidden.0.bias", &[HIDDEN[0]]),
        ("hidden.1.weight", &[HIDDEN[1], HIDDEN[0]]),
        ("hidden.1.bias", &[HIDDEN[1]]),
        ("output.weight", &[ACTIONS, HIDDEN[1]]),
        ("output.bias", &[ACTIONS]),
        ("direct.weight", &[ACTIONS, INPUTS]),
    ];
    let fill = |shape: &[usize], draw: &mut dyn FnMut() -> f32| {
        (0..shape.iter().product()).map(|_| draw()).collect()
    };
    shapes.into_iter().map(|(name, shape)| (name.into(), shape.to_vec(), fill(shape, draw))).collect()
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
            "replaces": false,
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

/// A refusal names key, value and expectation; what is not one of policies: `rust/io/tests/files.rs`.
#[test]
fn cards_and_weights_of_others_are_refused() {
    let robot = robot("ironcub_mk1");
    let sound = tensors(&mut || 0.1);
    load(&robot, &sound, &[]).unwrap();
    for (pointer, value, words) in [
        ("/format", json!("flight-aero-network"), &["small.json: `format` is", "expected flight-policy"][..]),
        ("/inputs/features", json!([]), &["`inputs.features` is empty; expected at least one"]),
        ("/inputs/features/1", json!("gravity"), &["`inputs.features` is Gravity twice; expected each once"]),
        (
            "/inputs/features/1",
            json!("wind"),
            &["`inputs.features[1]` is \"wind\"; expected one of gravity, rotation"],
        ),
        ("/inputs/scale", json!([1.0]), &["`inputs.scale` is 1 numbers; expected 10"]),
        ("/output/jets/0", json!("nose"), &["`output.jets`", "nose", "as of"]),
        ("/output/joints", json!([]), &["`output.joints`", "torso"]),
        ("/output/thrust_rate", json!(-1.0), &["`output.thrust_rate` is -1; expected a number ≥ 0"]),
        ("/output/joint_velocity", json!(-2.0), &["`output.joint_velocity` is -2; expected a number ≥ 0"]),
        (
            "/architecture/hidden",
            json!([5, 0]),
            &["`architecture.hidden` is [5, 0]; expected 1 to 8 layers of"],
        ),
        ("/architecture/hidden", json!([]), &["`architecture.hidden` is []; expected 1 to 8 layers of"]),
        ("/architecture/hidden", json!([6, 3]), &["shape of tensor `hidden.0.weight`", "[6, 71]"]),
        ("/architecture", json!({"hidden": [5], "layers": 2}), &["unknown key `architecture.layers`"]),
    ] {
        assert_says(&load(&robot, &sound, &[(pointer, value)]).unwrap_err(), words);
    }
    let mut spoilt = sound.clone();
    spoilt[6].2[7] = f32::NAN;
    assert_says(&load(&robot, &spoilt, &[]).unwrap_err(), &["entry 7 of tensor `direct.weight`", "NaN"]);
    assert_says(
        &load(&robot, &sound[1..], &[]).unwrap_err(),
        &["names `hidden.0.weight`, which does not exist"],
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
            world.controller.tick_with(&sample, &given);
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
