//! Disturbances of robot and controller: errors of the controller's inputs and faults of its actuators. None of them is
//! part of the controller.

pub mod jet_faults;
pub mod model_error;
pub mod outages;
pub mod wind_estimate;

pub use jet_faults::{FailureKind, JetFailure, JetFaults, JetFaultsConfig, MeasurementNoise};
pub use model_error::ModelError;
pub use outages::{Outage, OutageChannel, OutageKind, Outages, Sample};
pub use wind_estimate::{WindEstimateConfig, WindEstimator};

use crate::wind::WindConfig;
use flight_core::aero::ForceFactorsConfig;
use flight_core::{BuildError, RobotModel};
use serde::{Deserialize, Serialize};

/// Disturbances of a flight; none by default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Disturbances {
    /// Errors of the wind that the controller is given; without them it is the true one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wind_estimate: Option<WindEstimateConfig>,
    /// A wind that the controller is given in place of the one that blows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller_wind: Option<WindConfig>,
    /// How the controller's robot differs from the one that flies.
    pub model_error: ModelError,
    /// Factors on the simulated aerodynamic forces: coefficients that are not what they are thought to be.
    pub aero: ForceFactorsConfig,
    /// Factors on the forces that the controller estimates: information that is wrong or left out.
    pub aero_estimate: ForceFactorsConfig,
    /// What is wrong with the jets.
    pub jets: JetFaultsConfig,
    /// Measurements that fail to reach the controller, or reach it wrong.
    pub outages: Vec<Outage>,
}

impl Disturbances {
    /// The controller's model of `robot`: with errors, and with the limits of weak jets where they are
    /// known.
    ///
    /// # Errors
    /// As [`ModelError::check`] and [`JetFaultsConfig::check`].
    pub fn controller_robot(&self, mut robot: RobotModel) -> Result<RobotModel, BuildError> {
        self.model_error.check()?;
        self.jets.check(&robot.jets)?;
        self.jets.apply_known_limits(&mut robot.jets);
        Ok(self.model_error.apply(robot))
    }
}
