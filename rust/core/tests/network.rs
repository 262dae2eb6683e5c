//! Networks: of any robot, and damaged weights are refused. `tests/parity/test_jax_network.py` holds their forces to JAX.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on fails")]

use crate::common::network::{
    COMPACT, SMALL, Shape, Tensor, card, file_of, n_inputs, paper, random_network, random_tensors,
    random_weights, write,
};
use crate::common::{assert_says, assert_within, random_state, random_vector, rng, robot};
use flight_core::aero::{AeroModel, ForceFactorsConfig, LinkConventions, LinkForces, Precision};
use flight_core::kinematics::Kinematics;
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

// --- laws --------------------------------------------------------------------------------------------------------

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
        ("/output/layout", json!("component"), vec!["output", "frame Link with layout Component"]),
        ("/output/frame", json!("wind"), vec!["output.frame", "wind", "base", "link"]),
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
    let on = |link: &str, factor| BTreeMap::from([(link.to_owned(), factor)]);
    let weighted = of(&ForceFactorsConfig {
        scale: 2.0,
        drag: 0.5,
        normal: 1.5,
        links: on("head", 3.0),
        drag_of: on("chest", 0.2),
        normal_of: on("root_link", 0.7),
    });
    for (link, (force, v)) in plain.forces_i.iter().zip(&plain.v_air_i).enumerate() {
        let along = v * (force.dot(v) / v.norm_squared());
        let (whole, drag, normal) = match robot.aero_links[link].name.as_str() {
            "head" => (6.0, 0.5, 1.5),
            "chest" => (2.0, 0.1, 1.5),
            "root_link" => (2.0, 0.5, 1.05),
            _ => (2.0, 0.5, 1.5),
        };
        let expected = whole * (drag * along + normal * (force - along));
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
