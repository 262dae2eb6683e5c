//! Networks: their two precisions agree, they follow the laws, and damaged weights are refused. `tests/parity/test_jax_network.py`
//! compares them with JAX.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on fails")]

use crate::common::network::{
    COMPACT, SMALL, Shape, Tensor, card, file_of, n_inputs, paper, random_network, random_tensors,
    random_weights, write,
};
use crate::common::{assert_says, assert_within, random_state, random_vector, rng, robot};
use flight_core::aero::{AeroModel, ForceFactorsConfig, LinkConventions, LinkForces, Precision};
use flight_core::kinematics::Kinematics;
use flight_core::spatial::rotation_from_wxyz;
use flight_core::{BuildError, RobotModel, RobotState};
use flight_io::{AeroConfig, NetworkConfig, load_aero};
use nalgebra::Vector3;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use tempfile::tempdir;

/// The small network of the robot, in double precision.
fn small(robot: &RobotModel) -> AeroModel {
    let folder = tempdir().unwrap();
    load_aero(&random_network(folder.path(), robot, &SMALL, "small", Precision::F64), robot).unwrap()
}

fn config(card: PathBuf, precision: Precision) -> AeroConfig {
    AeroConfig::Network(NetworkConfig { card, precision, air_density: 1.225 })
}

fn forces(robot: &RobotModel, model: &mut AeroModel, state: &RobotState, wind: Vector3<f64>) -> LinkForces {
    let mut kinematics = Kinematics::new(robot);
    kinematics.update(robot, state);
    let mut forces = LinkForces::new(robot);
    forces.update(robot, &kinematics, LinkConventions::default(), model, &wind);
    forces
}

/// Greatest difference over the greatest force.
fn distance(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    let scale = a.iter().map(Vector3::norm).fold(1e-300, f64::max);
    a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max) / scale
}

/// Networks that differ in features, axes, layout, activation, symmetry and number of members.
fn shapes() -> [(&'static str, Shape); 6] {
    let base = paper(&[20, 70]);
    [
        ("paper", paper(&[40; 3])),
        ("linear", paper(&[])),
        ("symmetric", Shape { mirror: true, activation: "tanh", members: 3, ..paper(&[33]) }),
        ("tunnel axes", Shape { frame: "wind", mirror: true, has_baseline: true, ..base }),
        ("compact", COMPACT),
        ("small", SMALL),
    ]
}

// --- laws --------------------------------------------------------------------------------------------------------

/// Single precision is double precision to six digits, whatever the shape.
#[test]
fn precisions_agree() {
    let (robot, mut rng, folder) = (robot("ironcub_mk1"), rng(1), tempdir().unwrap());
    for (name, shape) in shapes() {
        let build = |precision| {
            load_aero(&random_network(folder.path(), &robot, &shape, name, precision), &robot).unwrap()
        };
        let (mut single, mut double) = (build(Precision::F32), build(Precision::F64));
        for _ in 0..20 {
            let (state, wind) = (random_state(&mut rng, &robot), random_vector(&mut rng, 10.0));
            let a = forces(&robot, &mut double, &state, wind).forces_i;
            let worst = distance(&a, &forces(&robot, &mut single, &state, wind).forces_i);
            assert!(worst < 2e-6 && worst > 0.0, "{name}: {worst:e}");
        }
    }
}

/// Outputs in tunnel axes are those of base axes, turned: x along the wind, z normal to it without a side, y right-handed.
#[test]
fn tunnel_axes_turn_with_the_wind() {
    let (robot, mut rng, folder) = (robot("ironcub_mk1"), rng(3), tempdir().unwrap());
    let [mut in_base, mut in_tunnel] = ["base", "wind"].map(|frame| {
        let shape = Shape { frame, ..paper(&[20]) };
        load_aero(&random_network(folder.path(), &robot, &shape, frame, Precision::F64), &robot).unwrap()
    });
    let mut state = RobotState::zero(robot.joints.len()); // base axes are the world's
    for _ in 0..10 {
        state.joint_position = random_state(&mut rng, &robot).joint_position;
        let wind = random_vector(&mut rng, 10.0);
        let x = wind.normalize();
        let z = Vector3::new(-x.z, 0.0, x.x).normalize();
        let axes = nalgebra::Matrix3::from_columns(&[x, z.cross(&x), z]);
        let expected: Vec<_> =
            forces(&robot, &mut in_base, &state, wind).forces_i.iter().map(|force| axes * force).collect();
        let found = forces(&robot, &mut in_tunnel, &state, wind).forces_i;
        assert_within!(distance(&expected, &found), 1e-13, because "a dozen roundings");
    }
}

/// Forces grow with the square of the speed, turn with the world, and vanish in still air.
#[test]
fn forces_follow_wind_and_world() {
    let (robot, mut rng, folder) = (robot("ironcub_mk1"), rng(2), tempdir().unwrap());
    for (name, shape) in shapes() {
        let config = random_network(folder.path(), &robot, &shape, name, Precision::F64);
        let mut model = load_aero(&config, &robot).unwrap();
        for _ in 0..10 {
            let mut state = random_state(&mut rng, &robot);
            state.velocity.fill(0.0);
            let wind = random_vector(&mut rng, 10.0);
            let here = forces(&robot, &mut model, &state, wind).forces_i;
            let thrice: Vec<Vector3<f64>> = here.iter().map(|force| force * 9.0).collect();
            assert_within!(
                distance(&thrice, &forces(&robot, &mut model, &state, wind * 3.0).forces_i),
                1e-12,
                "{name}"
            );

            let turn = rotation_from_wxyz(&[0.4, -0.2, 0.7, 0.5]);
            let turned: Vec<Vector3<f64>> = here.iter().map(|force| turn * force).collect();
            state.base.rotation = turn * state.base.rotation;
            state.base.position += Vector3::new(3.0, -2.0, 5.0);
            let there = forces(&robot, &mut model, &state, turn * wind).forces_i;
            assert_within!(distance(&turned, &there), 1e-11, "{name}: {:e}", distance(&turned, &there));

            let still = forces(&robot, &mut model, &state, Vector3::zeros()).forces_i;
            assert!(still.iter().all(|force| *force == Vector3::zeros()), "{name}");
        }
    }
}

/// Only the velocity of the base origin enters, and it enters as wind: the model's definition.
#[test]
fn the_wind_is_that_of_the_base_origin() {
    let (robot, mut rng) = (robot("ironcub_mk1"), rng(3));
    let mut model = small(&robot);
    let (mut state, wind) = (random_state(&mut rng, &robot), random_vector(&mut rng, 10.0));
    let moving = forces(&robot, &mut model, &state, wind);
    let relative = wind - state.base_linear_velocity();
    state.velocity.fill(0.0);
    let still = forces(&robot, &mut model, &state, relative);
    assert_within!(distance(&moving.forces_i, &still.forces_i), 1e-13);
}

/// A symmetric network's answer to the mirrored question is the mirrored answer; another one's is not.
#[test]
fn a_symmetric_network_is_symmetric() {
    let (robot, mut rng, folder) = (robot("ironcub_mk1"), rng(4), tempdir().unwrap());
    let swapped = |name: &str| -> String {
        let parts = name.split('_').map(|part| match part {
            "l" => "r",
            "r" => "l",
            other => other,
        });
        parts.collect::<Vec<_>>().join("_")
    };
    let reflect = |v: Vector3<f64>| Vector3::new(v.x, -v.y, v.z);
    // Features that come from the links' places see that the robot itself is not quite symmetric.
    let plain = Shape { mirror: true, ..paper(&[40]) };
    // An axis across the robot, as that of its root link, has two ends: a baseline may distinguish them.
    let in_link_axes = Shape { has_baseline: false, ..COMPACT };
    let lopsided = paper(&[40]);
    for (name, shape, tolerance) in [
        ("mirror", &plain, 1e-12),
        ("mirror in link axes", &in_link_axes, 1e-2),
        ("no mirror", &lopsided, f64::INFINITY),
    ] {
        let mut model =
            load_aero(&random_network(folder.path(), &robot, shape, name, Precision::F64), &robot).unwrap();
        for _ in 0..20 {
            let mut state = RobotState::zero(robot.joints.len());
            state.joint_position = random_state(&mut rng, &robot).joint_position * 0.5;
            let wind = random_vector(&mut rng, 10.0);
            let mut image = state.clone();
            for (joint, angle) in robot.joints.iter().zip(state.joint_position.iter()) {
                let sign =
                    if ["torso_roll", "torso_yaw"].contains(&joint.name.as_str()) { -1.0 } else { 1.0 };
                image.joint_position[robot.joint_index(&swapped(&joint.name)).unwrap()] = sign * angle;
            }
            let here = forces(&robot, &mut model, &state, wind).forces_i;
            let there = forces(&robot, &mut model, &image, reflect(wind)).forces_i;
            let expected: Vec<Vector3<f64>> = robot
                .aero_links
                .iter()
                .map(|link| {
                    let image =
                        robot.aero_links.iter().position(|other| other.name == swapped(&link.name)).unwrap();
                    reflect(there[image])
                })
                .collect();
            let worst = distance(&here, &expected);
            assert_within!(worst, tolerance, "{name}: {worst:e}");
            assert!(tolerance.is_finite() || worst > 1e-2, "{name}: {worst:e}");
        }
    }
}

/// Any robot with aerodynamic links may have a network.
#[test]
fn other_robots_have_networks_too() {
    let (robot, mut rng, folder) = (robot("sparrow"), rng(5), tempdir().unwrap());
    let shape = Shape { mirror: false, ..COMPACT };
    let mut model =
        load_aero(&random_network(folder.path(), &robot, &shape, "sparrow", Precision::F32), &robot).unwrap();
    let found = forces(&robot, &mut model, &random_state(&mut rng, &robot), Vector3::new(3.0, 4.0, 5.0));
    assert!(found.forces_i.iter().all(|force| force.norm() > 0.0 && force.norm() < 100.0));
}

// --- refusals ----------------------------------------------------------------------------------------------------

/// What is wrong with a card whose value at `pointer` is `value`.
fn error_of_card(pointer: &str, value: Value) -> BuildError {
    let robot = robot("ironcub_mk1");
    let weights = random_weights(&robot, &SMALL);
    let mut card = card(&robot, &SMALL, "small", &weights);
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    card.pointer_mut(parent).unwrap()[key] = value;
    let folder = tempdir().unwrap();
    let path = write(folder.path(), "small", &card, &weights);
    load_aero(&config(path, Precision::F32), &robot).unwrap_err()
}

/// Every key of a card is looked at, and the error names it, its value and what was expected.
#[test]
fn bad_cards_are_refused() {
    let links = || robot("ironcub_mk1").aero_links.into_iter().map(|link| link.name);
    for (pointer, value, words) in [
        ("/wieghts", json!(1), vec!["wieghts", "unknown"]),
        ("/weights/file", json!("absent.safetensors"), vec!["cannot read", "absent.safetensors"]),
        ("/inputs/features", json!([]), vec!["inputs.features", "empty"]),
        ("/inputs/features", json!(["wind", "wind"]), vec!["Wind twice"]),
        (
            "/inputs/features",
            json!(["wind", "smell"]),
            vec!["small.json: `inputs.features[1]` is \"smell\"; expected"],
        ),
        ("/inputs/features", json!(5), vec!["`inputs.features` is 5; expected a list"]),
        ("/inputs/scaling", json!(1.0), vec!["unknown key `inputs.scaling`"]),
        ("/inputs/features", json!(["wind"]), vec!["member.0.layer.0.weight", "[5, 113]", "[5, 3]"]),
        ("/inputs/joints", json!(["torso_pitch", "tail"]), vec!["inputs.joints", "tail", "known", "l_elbow"]),
        ("/inputs/joints", json!(["l_elbow", "torso_pitch"]), vec!["order", "l_elbow, torso_pitch"]),
        (
            "/inputs/links",
            json!(links().rev().collect::<Vec<_>>()),
            vec!["inputs.links", "r_lower_leg, r_upper"],
        ),
        ("/output/frame", json!("wind"), vec!["output", "frame Wind with layout Link"]),
        ("/output/unit", json!("ft^2"), vec!["output.unit", "ft^2", "m^2"]),
        ("/architecture/hidden", json!([5, 0]), vec!["architecture.hidden", "0", "65536"]),
        ("/architecture/hidden", json!([5, -1]), vec!["`architecture.hidden[1]` is -1; expected an integer"]),
        ("/architecture/hidden", json!([5]), vec!["member.0.layer.1.weight", "shape"]),
        ("/architecture/members", json!(0), vec!["architecture.members", "0"]),
        ("/architecture/members", json!(3), vec!["member.2.layer.0.weight", "does not exist"]),
        ("/architecture/members", json!(1), vec!["member.1.layer.0.bias", "no layer"]),
        ("/architecture/activation", json!("step"), vec!["step", "silu"]),
        ("/architecture/baseline/links", json!({}), vec!["baseline", "without `head`"]),
        (
            "/architecture/baseline/links/head/cda",
            json!([1.0]),
            vec!["links.head.cda` is [1.0]; expected a list of 5"],
        ),
        ("/architecture/baseline/kind", json!("magic"), vec!["`architecture.baseline.kind` is \"magic\""]),
        ("/training", json!("much"), vec!["`training` is \"much\"; expected a table"]),
    ] {
        assert_says(&error_of_card(pointer, value), &words);
    }
}

/// What is wrong with these tensors.
fn error_of_weights(name: &str, change: impl FnOnce(&mut Vec<Tensor>)) -> BuildError {
    let robot = robot("ironcub_mk1");
    let shape = paper(&[4]);
    let mut tensors = random_tensors(n_inputs(&robot, &shape), 39, &shape, 1);
    change(&mut tensors);
    let weights = file_of(&tensors);
    let folder = tempdir().unwrap();
    let path = write(folder.path(), name, &card(&robot, &shape, name, &weights), &weights);
    load_aero(&config(path, Precision::F32), &robot).unwrap_err()
}

/// Names and shapes of other tensors, and numbers that are not finite. Files: `rust/io/tests/files.rs`.
#[test]
fn bad_weights_are_refused() {
    let words = ["member.0.layer.0.bias", "entry 2", "NaN", "nan.safetensors"];
    assert_says(&error_of_weights("nan", |tensors| tensors[1].2[2] = f32::NAN), &words);
    let infinite = error_of_weights("inf", |tensors| tensors[4].2[0] = f32::INFINITY);
    assert_says(&infinite, &["output.scale", "inf"]);
    let transposed = error_of_weights("transposed", |tensors| tensors[0].1.reverse());
    assert_says(&transposed, &["shape", "member.0.layer.0.weight", "[22, 4]", "[4, 22]"]);
    let more = error_of_weights("more", |tensors| tensors.push(("extra".to_owned(), vec![1], vec![0.0])));
    assert_says(&more, &["extra", "no layer"]);
    let fewer = error_of_weights("fewer", |tensors| drop(tensors.pop()));
    assert_says(&fewer, &["output.offset", "does not exist"]);
}

/// Factors split a network's forces like any other model's: along the air that meets the link, and across it.
#[test]
fn factors_apply_to_networks() {
    let (robot, mut rng) = (robot("ironcub_mk1"), rng(9));
    let (state, wind) = (random_state(&mut rng, &robot), random_vector(&mut rng, 10.0));
    let of = |factors: &ForceFactorsConfig| {
        let mut model = small(&robot).weight_forces(factors, &robot, "factors").unwrap();
        forces(&robot, &mut model, &state, wind)
    };
    let plain = of(&ForceFactorsConfig::default());
    let links = BTreeMap::from([("head".to_owned(), 3.0)]);
    let weighted = of(&ForceFactorsConfig { scale: 2.0, drag: 0.5, normal: 1.5, links });
    for (link, (force, v)) in plain.forces_i.iter().zip(&plain.v_air_i).enumerate() {
        let along = v * (force.dot(v) / v.norm_squared());
        let factor = if robot.aero_links[link].name == "head" { 6.0 } else { 2.0 };
        let expected = factor * (0.5 * along + 1.5 * (force - along));
        assert_within!((weighted.forces_i[link] - expected).norm(), 1e-14 * (1.0 + expected.norm()));
    }
}

/// A robot without a mirror image has no symmetric network.
#[test]
fn a_lopsided_robot_is_refused() {
    let (mut robot, folder) = (robot("ironcub_mk1"), tempdir().unwrap());
    robot.aero_links[4].centre_l.x += 0.1;
    let config = random_network(folder.path(), &robot, &COMPACT, "lopsided", Precision::F32);
    assert_says(&load_aero(&config, &robot).unwrap_err(), &["l_upper_arm", "mirrored", "image"]);
}
