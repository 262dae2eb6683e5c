//! Which measurements are accepted.

use serde::{Deserialize, Serialize};

/// Which measurements are accepted, and what replaces the others.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelsConfig {
    /// Whether differences from the prediction beyond `Jumps::GREATEST` are refused. Without it all differences are
    /// accepted, no value counts as frozen and no time step as wrong.
    pub jump: bool,
}
