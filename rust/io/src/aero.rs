//! Loads an aerodynamic model from a file of `configs/aero/`.

use crate::network::load_network;
use flight_core::aero::{
    AeroModel, Axisymmetric, AxisymmetricConfig, Precision, SphereCylinder, SphereCylinderConfig,
};
use flight_core::{BuildError, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which aerodynamic model, and its numbers: one file of `configs/aero/`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "model", rename_all = "snake_case", deny_unknown_fields)]
pub enum AeroConfig {
    /// No aerodynamic force.
    // Braces, because serde lets unknown keys pass beside a bare name.
    Off {},
    /// Fitted force areas of axisymmetric links.
    Axisymmetric(AxisymmetricConfig),
    /// Literature drag of spheres and finite cylinders.
    SphereCylinder(Box<SphereCylinderConfig>),
    /// A neural network of wind and posture.
    Network(NetworkConfig),
}

/// Which network, and how it is evaluated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// The network's JSON card; the weights lie beside it.
    #[schemars(extend("format" = "path"))]
    pub card: PathBuf,
    /// Precision of the weighted sums.
    #[serde(default)]
    pub precision: Precision,
    /// Density of the air \[kg/m³\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub air_density: f64,
}

/// The model that `config` asks for, for the links of `robot`.
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
