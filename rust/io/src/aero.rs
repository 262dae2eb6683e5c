//! Loads an aerodynamic model from a file of `configs/aero/`.

use crate::network::{NetworkConfig, load_network};
use flight_core::aero::{AeroModel, Axisymmetric, AxisymmetricConfig, SphereCylinder, SphereCylinderConfig};
use flight_core::{BuildError, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
