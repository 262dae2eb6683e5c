//! Loads an aerodynamic model from a file of `configs/aero/`.

use crate::network::load_network;
use flight_core::aero::{
    AeroModel, Axisymmetric, AxisymmetricConfig, Precision, SphereCylinder, SphereCylinderConfig,
};
use flight_core::{BuildError, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Selection and parameters of an aerodynamic model: one file of `configs/aero/`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "model", rename_all = "snake_case", deny_unknown_fields)]
pub enum AeroConfig {
    /// No aerodynamic force.
    // With braces, because serde accepts unknown keys after a unit variant.
    Off {},
    /// Axisymmetric links with fitted force areas.
    Axisymmetric(AxisymmetricConfig),
    /// Spheres and finite cylinders with drag coefficients from the literature.
    SphereCylinder(Box<SphereCylinderConfig>),
    /// A neural network whose inputs are wind and posture.
    Network(NetworkConfig),
}

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

/// Builds the configured model for the links of `robot`.
///
/// # Errors
/// [`BuildError`] naming the link, table or file, the value, and what was expected.
pub fn load_aero(config: &AeroConfig, robot: &RobotModel) -> Result<AeroModel, BuildError> {
    let links = &robot.aero_links;
    Ok(match config {
        AeroConfig::Off {} => AeroModel::Off,
        AeroConfig::Axisymmetric(config) => AeroModel::Axisymmetric(Axisymmetric::new(config, links)?),
        AeroConfig::SphereCylinder(config) => AeroModel::SphereCylinder(SphereCylinder::new(config, links)?),
        AeroConfig::Network(config) => AeroModel::Network(Box::new(load_network(config, robot)?)),
    })
}
