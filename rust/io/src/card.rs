//! Cards: JSON files that describe weights, which lie beside them in a safetensors file.

use crate::{from_value, read_bytes, read_text, tensors};
use flight_core::BuildError;
use flight_core::aero::network::Tensors;
use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Supported value of `version`.
const VERSION: u32 = 1;

/// Content of a card; unknown keys are refused.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct CardFile<I, O, A> {
    format: String,
    version: u32,
    /// Name in tables and figures; not used here.
    #[serde(rename = "name")]
    _name: String,
    #[serde(rename = "description")]
    _description: String,
    pub weights: WeightsFile,
    pub inputs: I,
    pub output: O,
    pub architecture: A,
    /// Record of the training; not used here.
    #[serde(rename = "training")]
    _training: Map<String, Value>,
}

/// File of the weights.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct WeightsFile {
    /// Name of the safetensors file, in the folder of the card.
    file: PathBuf,
    /// SHA-256 of that file in hexadecimal digits.
    sha256: String,
}

impl<I, O, A> CardFile<I, O, A>
where
    Self: DeserializeOwned + JsonSchema,
{
    /// Reads a card of this format.
    pub(crate) fn read(path: &Path, format: &str) -> Result<Self, BuildError> {
        let origin = path.display().to_string();
        let value =
            serde_json::from_str(&read_text(path)?).map_err(|error| BuildError::malformed(&origin, error))?;
        let card: Self = from_value(value, &origin)?;
        let weights = &card.weights.file;
        let wrong = if card.format != format {
            ("format", card.format.clone(), format.to_owned())
        } else if card.version != VERSION {
            ("version", card.version.to_string(), VERSION.to_string())
        } else if weights.components().count() != 1 || weights.file_name().is_none() {
            ("weights.file", weights.display().to_string(), "a name beside the card".to_owned())
        } else {
            return Ok(card);
        };
        Err(BuildError::bad_entry(wrong.0, wrong.1, wrong.2).in_file(origin))
    }
}

impl WeightsFile {
    /// Reads the weights of the card at `path`, and checks their hash.
    pub(crate) fn tensors(self, path: &Path) -> Result<Tensors, BuildError> {
        let Self { file, sha256 } = self;
        let file = path.with_file_name(file);
        let bytes = read_bytes(&file)?;
        let digest =
            Sha256::digest(&bytes).iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"));
        if digest != sha256.to_lowercase() {
            let expected = format!("{digest}, the hash of {}", file.display());
            return Err(BuildError::bad_entry("weights.sha256", sha256, expected).in_file(path.display()));
        }
        tensors::parse(&file, &bytes)
    }
}
