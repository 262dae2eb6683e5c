//! Networks with random weights, for tests and benchmarks that need one of a certain shape.

#![allow(dead_code, reason = "not every binary needs everything")]
#![allow(clippy::unwrap_used, reason = "what cannot be written cannot be tested")]

use flight_core::RobotModel;
use flight_core::aero::Precision;
use flight_io::{AeroConfig, NetworkConfig};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// What a card can ask for.
pub struct Shape {
    pub features: &'static [&'static str],
    pub hidden: &'static [usize],
    pub activation: &'static str,
    pub members: usize,
    pub mirror: bool,
    pub frame: &'static str,
    pub layout: &'static str,
    pub has_baseline: bool,
}

/// Symmetric, correcting the axisymmetric model in link axes.
pub const COMPACT: Shape = Shape {
    features: &["link_wind", "link_position", "link_shadow"],
    hidden: &[128; 4],
    activation: "silu",
    members: 1,
    mirror: true,
    frame: "link",
    layout: "link",
    has_baseline: true,
};

/// Few weights, with every feature and option.
pub const SMALL: Shape = Shape {
    features: &["link_shadow", "wind", "joints", "link_position", "link_wind"],
    hidden: &[5, 9],
    members: 2,
    ..COMPACT
};

/// The paper's, with hidden layers of this width.
pub const fn paper(hidden: &'static [usize]) -> Shape {
    Shape {
        features: &["wind", "joints"],
        hidden,
        activation: "relu",
        members: 1,
        mirror: false,
        frame: "base",
        layout: "component",
        has_baseline: false,
    }
}

/// A named tensor: shape and numbers.
pub type Tensor = (String, Vec<usize>, Vec<f32>);

/// Weights within ±1/√inputs; outputs of about 0.01 m².
pub fn random_tensors(inputs: usize, outputs: usize, shape: &Shape, seed: u64) -> Vec<Tensor> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let widths: Vec<usize> = [inputs].iter().chain(shape.hidden).chain([&outputs]).copied().collect();
    let mut tensors = Vec::new();
    for member in 0..shape.members {
        for (index, width) in widths.windows(2).enumerate() {
            let bound = 1.0 / (width[0] as f32).sqrt();
            let mut draw = |count: usize| (0..count).map(|_| rng.random_range(-bound..bound)).collect();
            let name = format!("member.{member}.layer.{index}");
            tensors.push((format!("{name}.weight"), vec![width[1], width[0]], draw(width[0] * width[1])));
            tensors.push((format!("{name}.bias"), vec![width[1]], draw(width[1])));
        }
    }
    tensors.push(("output.scale".to_owned(), vec![outputs], vec![0.02; outputs]));
    tensors.push(("output.offset".to_owned(), vec![outputs], vec![0.001; outputs]));
    tensors
}

/// A safetensors file.
pub fn file_of(tensors: &[Tensor]) -> Vec<u8> {
    let (mut table, mut data) = (serde_json::Map::new(), Vec::new());
    for (name, shape, numbers) in tensors {
        let first = data.len();
        data.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
        table.insert(
            name.clone(),
            json!({"dtype": "F32", "shape": shape, "data_offsets": [first, data.len()]}),
        );
    }
    let table = Value::Object(table).to_string();
    let length = (table.len() as u64).to_le_bytes();
    [&length, table.as_bytes(), &data].concat()
}

/// SHA-256 of the weights, as it is on the card.
pub fn digest(weights: &[u8]) -> String {
    Sha256::digest(weights).iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"))
}

/// A card for `weights`, to be saved beside them as `NAME.json`.
pub fn card(robot: &RobotModel, shape: &Shape, name: &str, weights: &[u8]) -> Value {
    let joints: Vec<&str> =
        robot.joints.iter().map(|joint| joint.name.as_str()).filter(|name| !name.contains("ankle")).collect();
    let links: Vec<&str> = robot.aero_links.iter().map(|link| link.name.as_str()).collect();
    let numbers = json!({"cda": [0.01, 0.002, 0.003, 0.0, -0.001], "cna": 0.004});
    let by_link: serde_json::Map<String, Value> =
        links.iter().map(|link| ((*link).to_owned(), numbers.clone())).collect();
    let baseline = shape.has_baseline.then(|| json!({"kind": "axisymmetric", "links": by_link}));
    json!({
        "format": "flight-aero-network",
        "version": 1,
        "name": name,
        "description": "Random weights.",
        "weights": {"file": format!("{name}.safetensors"), "sha256": digest(weights)},
        "inputs": {"features": shape.features, "joints": joints, "links": links},
        "output": {"frame": shape.frame, "layout": shape.layout, "unit": "m^2"},
        "architecture": {
            "hidden": shape.hidden, "activation": shape.activation, "members": shape.members,
            "mirror": shape.mirror, "baseline": baseline,
        },
        "training": {},
    })
}

/// Length of the input vector.
pub fn n_inputs(robot: &RobotModel, shape: &Shape) -> usize {
    let joints = robot.joints.iter().filter(|joint| !joint.name.contains("ankle")).count();
    let links = robot.aero_links.len();
    let features = shape.features.iter();
    features
        .map(|feature| match *feature {
            "wind" => 3,
            "joints" => joints,
            "link_shadow" => links,
            _ => 3 * links,
        })
        .sum()
}

/// The file of random weights for a robot.
pub fn random_weights(robot: &RobotModel, shape: &Shape) -> Vec<u8> {
    file_of(&random_tensors(n_inputs(robot, shape), 3 * robot.aero_links.len(), shape, 7))
}

/// Writes card and weights; the path of the card.
pub fn write(folder: &Path, name: &str, card: &Value, weights: &[u8]) -> PathBuf {
    std::fs::write(folder.join(name).with_extension("safetensors"), weights).unwrap();
    let path = folder.join(name).with_extension("json");
    std::fs::write(&path, card.to_string()).unwrap();
    path
}

/// A configuration of a network of this shape with random weights, whose files are in `folder`.
pub fn random_network(
    folder: &Path,
    robot: &RobotModel,
    shape: &Shape,
    name: &str,
    precision: Precision,
) -> AeroConfig {
    let weights = random_weights(robot, shape);
    let card = write(folder, name, &card(robot, shape, name, &weights), &weights);
    AeroConfig::Network(NetworkConfig { card, precision, air_density: 1.225 })
}
