//! Disturbances: errors of the controller's inputs and model, faults of its actuators, and pushes. None is part of the
//! controller.

mod jet_faults;
mod joint_faults;
mod model_error;
mod outages;
mod pushes;
mod wind_estimate;

pub use jet_faults::{FailureKind, JetFailure, JetFaults, JetFaultsConfig, MeasurementNoise};
pub use joint_faults::{JointFault, JointFaultKind, JointFaults};
pub use model_error::ModelError;
pub use outages::{Outage, OutageChannel, OutageKind, Outages};
pub use pushes::{Push, Pushes};
pub use wind_estimate::{WindEstimateConfig, WindEstimator};

use crate::wind::WindConfig;
use flight_core::aero::ForceFactorsConfig;
use flight_core::{BuildError, RobotModel};
use serde::{Deserialize, Serialize};

/// Disturbances of a flight; none by default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Disturbances {
    /// Errors of the controller's measured wind; without them it is the true wind.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wind_estimate: Option<WindEstimateConfig>,
    /// A wind that the controller receives in place of the simulated one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller_wind: Option<WindConfig>,
    /// Differences between the controller's robot and the simulated one.
    pub model_error: ModelError,
    /// Factors on the simulated aerodynamic forces, for errors of the coefficients.
    pub aero: ForceFactorsConfig,
    /// Factors on the forces that the controller estimates, for parts that are wrong or omitted.
    pub aero_estimate: ForceFactorsConfig,
    /// Faults of the jets.
    pub jets: JetFaultsConfig,
    /// Faults of joints, at most one for each.
    pub joints: Vec<JointFault>,
    /// Measurements that are lost or corrupted on the way to the controller.
    pub outages: Vec<Outage>,
    /// Forces and moments on bodies of the simulated robot.
    pub pushes: Vec<Push>,
}

impl Disturbances {
    /// Returns the controller's model of `robot`: with model errors, and with the limits of weak jets if these
    /// are known.
    ///
    /// # Errors
    /// As [`ModelError::check`] and [`JetFaultsConfig::check`].
    pub fn controller_robot(&self, mut robot: RobotModel) -> Result<RobotModel, BuildError> {
        self.model_error.check(robot.jets.len())?;
        self.jets.check(&robot.jets)?;
        self.jets.apply_known_limits(&mut robot.jets);
        Ok(if self.model_error.of_plant == Some(true) { robot } else { self.model_error.apply(robot) })
    }

    /// Returns the simulated robot: the one of the file, or with the errors that the plant has.
    ///
    /// # Errors
    /// As [`ModelError::check`].
    pub fn simulated_robot(&self, robot: RobotModel) -> Result<RobotModel, BuildError> {
        self.model_error.check(robot.jets.len())?;
        Ok(if self.model_error.of_plant == Some(true) { self.model_error.apply(robot) } else { robot })
    }
}
