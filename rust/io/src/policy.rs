//! Learned policies: a JSON card that describes the weights, and a safetensors file with the weights.

use crate::network::WeightsFile;
use crate::{read_text, tensors};
use flight_core::control::law::residual::{
    Policy, PolicyArchitecture, PolicyCard, PolicyInputs, PolicyOutput,
};
use flight_core::{BuildError, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

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

/// Content of a JSON card; unknown keys are refused.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CardFile {
    format: String,
    version: u32,
    /// Name in tables and figures; not used here.
    #[serde(rename = "name")]
    _name: String,
    #[serde(rename = "description")]
    _description: String,
    weights: WeightsFile,
    inputs: PolicyInputs,
    output: PolicyOutput,
    architecture: PolicyArchitecture,
    /// Task and record of the training; not used here.
    #[serde(rename = "training")]
    _training: serde_json::Map<String, serde_json::Value>,
}

/// Reads card and weights, and checks them against each other and the robot.
///
/// # Errors
/// [`BuildError`] naming file, key or tensor, the value found and what was expected.
pub fn load_policy(config: &PolicyConfig, robot: &RobotModel) -> Result<Policy, BuildError> {
    let origin = config.card.display().to_string();
    let file: CardFile = serde_json::from_str(&read_text(&config.card)?)
        .map_err(|error| BuildError::malformed(&origin, error))?;
    file.weights.check(&origin, (&file.format, file.version), FORMAT)?;
    let CardFile { weights, inputs, output, architecture, .. } = file;
    let card = PolicyCard { origin, inputs, output, architecture };
    let tensors = || {
        let (path, bytes) = weights.read(&config.card)?;
        tensors::parse(&path, &bytes)
    };
    Policy::new(card, tensors, robot)
}
