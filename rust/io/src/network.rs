//! Networks: a JSON card that describes the weights, and a safetensors file with the weights.

use crate::{read_bytes, read_text, tensors};
use flight_core::aero::Precision;
use flight_core::aero::network::{Architecture, Card, Inputs, Network, Output};
use flight_core::{BuildError, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
/// Supported value of `version`.
const VERSION: u32 = 1;

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
    inputs: Inputs,
    output: Output,
    architecture: Architecture,
    /// Record of the training; not used here.
    #[serde(rename = "training")]
    _training: serde_json::Map<String, serde_json::Value>,
}

/// File of the weights.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct WeightsFile {
    /// Name of the safetensors file, in the folder of the card.
    file: PathBuf,
    /// SHA-256 of that file in hexadecimal digits.
    sha256: String,
}

/// Reads card and weights, and checks them against each other and the robot.
///
/// # Errors
/// [`BuildError`] naming file, key or tensor, the value found and what was expected.
pub fn load_network(config: &NetworkConfig, robot: &RobotModel) -> Result<Network, BuildError> {
    let origin = config.card.display().to_string();
    let file: CardFile = serde_json::from_str(&read_text(&config.card)?)
        .map_err(|error| BuildError::malformed(&origin, error))?;
    file.weights.check(&origin, (&file.format, file.version), FORMAT)?;
    let CardFile { weights, inputs, output, architecture, .. } = file;
    let card = Card { origin, inputs, output, architecture };
    let tensors = || {
        let (path, bytes) = weights.read(&config.card)?;
        tensors::parse(&path, &bytes)
    };
    Network::new(card, tensors, config.precision, config.air_density, robot)
}

impl WeightsFile {
    /// Checks format and version of the card, and that it names a file beside it.
    pub(crate) fn check(
        &self,
        origin: &str,
        (format, version): (&str, u32),
        expected: &str,
    ) -> Result<(), BuildError> {
        let refuse = |key: &str, value: String, expected: &str| {
            Err(BuildError::bad_value(format!("`{key}` in {origin}"), value, expected))
        };
        if format != expected {
            return refuse("format", format.to_owned(), expected);
        }
        if version != VERSION {
            return refuse("version", version.to_string(), &VERSION.to_string());
        }
        if self.file.components().count() != 1 || self.file.file_name().is_none() {
            return refuse("weights.file", self.file.display().to_string(), "a name beside the card");
        }
        Ok(())
    }

    /// Reads the weights file in the folder of `card` and checks its hash; returns its path and its
    /// bytes.
    pub(crate) fn read(&self, card: &Path) -> Result<(PathBuf, Arc<[u8]>), BuildError> {
        let file = card.with_file_name(&self.file);
        let bytes = read_bytes(&file)?;
        let digest =
            Sha256::digest(&bytes).iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"));
        if digest != self.sha256.to_lowercase() {
            return Err(BuildError::bad_value(
                format!("SHA-256 of {}", file.display()),
                digest,
                format!("{}, as on the card {}", self.sha256, card.display()),
            ));
        }
        Ok((file, bytes))
    }
}
