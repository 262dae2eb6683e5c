//! Networks: a JSON card that describes the weights, and a safetensors file with the weights.

use crate::card::CardFile;
use flight_core::aero::Precision;
use flight_core::aero::network::{Architecture, Card, Inputs, Network, Output, Tensors, Weights};
use flight_core::{BuildError, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Selection of a network and its evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// The network's JSON card; the weights are in the same folder.
    #[schemars(extend("format" = "path"))]
    pub card: PathBuf,
    /// Precision of the weighted sums.
    #[serde(default)]
    pub precision: Precision,
    /// Density of the air \[kg/m³\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub air_density: f64,
}

/// Value of `format` in every card.
const FORMAT: &str = "flight-aero-network";

/// Reads card and weights, and checks them against each other and the robot.
///
/// # Errors
/// [`BuildError`] naming file, key or tensor, the value found and what was expected.
pub fn load_network(config: &NetworkConfig, robot: &RobotModel) -> Result<Network, BuildError> {
    let (card, tensors) = read(&config.card)?;
    Network::new(card, tensors, config.precision, config.air_density, robot)
}

/// Card and weights, checked against each other and the robot's `joints` and `links`.
///
/// # Errors
/// As [`load_network`].
pub fn read_network(path: &Path, joints: &[&str], links: &[&str]) -> Result<(Card, Weights), BuildError> {
    let (card, tensors) = read(path)?;
    let weights = card.weights(tensors, joints, links)?;
    Ok((card, weights))
}

/// A card, and a function that reads its weights.
fn read(path: &Path) -> Result<(Card, impl FnOnce() -> Result<Tensors, BuildError>), BuildError> {
    let file = CardFile::<Inputs, Output, Architecture>::read(path, FORMAT)?;
    let CardFile { inputs, output, architecture, weights, .. } = file;
    let card = Card { origin: path.display().to_string(), inputs, output, architecture };
    Ok((card, move || weights.tensors(path)))
}
