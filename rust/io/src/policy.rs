//! Learned policies: a JSON card that describes the weights, and a safetensors file with the weights.

use crate::card::CardFile;
use flight_core::aero::network::Tensors;
use flight_core::control::law::residual::{
    Policy, PolicyArchitecture, PolicyCard, PolicyInputs, PolicyOutput, PolicyWeights,
};
use flight_core::{BuildError, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Selection of a policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// The policy's JSON card; the weights are in the same folder.
    #[schemars(extend("format" = "path"))]
    pub card: PathBuf,
}

/// Value of `format` in every card.
const FORMAT: &str = "flight-policy";

/// Reads card and weights, and checks them against each other and the robot.
///
/// # Errors
/// [`BuildError`] naming file, key or tensor, the value found and what was expected.
pub fn load_policy(config: &PolicyConfig, robot: &RobotModel) -> Result<Policy, BuildError> {
    let (card, tensors) = read(&config.card)?;
    Policy::new(card, tensors, robot)
}

/// Card and weights, checked against each other and the robot's `jets` and `joints`.
///
/// # Errors
/// As [`load_policy`].
pub fn read_policy(
    path: &Path,
    jets: &[&str],
    joints: &[&str],
) -> Result<(PolicyCard, PolicyWeights), BuildError> {
    let (card, tensors) = read(path)?;
    let weights = card.weights(tensors, jets, joints)?;
    Ok((card, weights))
}

/// A card, and a function that reads its weights.
fn read(path: &Path) -> Result<(PolicyCard, impl FnOnce() -> Result<Tensors, BuildError>), BuildError> {
    let file = CardFile::<PolicyInputs, PolicyOutput, PolicyArchitecture>::read(path, FORMAT)?;
    let CardFile { inputs, output, architecture, weights, .. } = file;
    let card = PolicyCard { origin: path.display().to_string(), inputs, output, architecture };
    Ok((card, move || weights.tensors(path)))
}
