//! Loads a controller from a file of `configs/control/`.

use crate::{AeroConfig, MissionConfig, load_aero, load_mission};
use flight_core::control::config::ControllerConfig;
use flight_core::{BuildError, Controller, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One file of `configs/control/`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControllerSection {
    /// The controller's own aerodynamic model; `off` is the baseline controller.
    pub aero: AeroConfig,
    /// The control law; its keys are at the same level as `aero`.
    #[serde(flatten)]
    pub law: ControllerConfig,
}

/// Builds a controller of `robot` with the tick `time_step` \[s\].
///
/// # Errors
/// [`BuildError`] naming the file, or the item that does not match the robot.
pub fn load_controller(
    robot: RobotModel,
    controller: &ControllerSection,
    mission: &MissionConfig,
    time_step: f64,
) -> Result<Controller, BuildError> {
    let aero = |robot: &RobotModel| load_aero(&controller.aero, robot);
    Controller::new(robot, aero, load_mission(mission)?, &controller.law, time_step)
}
