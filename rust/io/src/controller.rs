//! Loads a controller from a file of `configs/control/`, and what runs on board from one of `configs/onboard/`.

use crate::{AeroConfig, MissionConfig, PolicyConfig, load_aero, load_mission, load_policy};
use flight_core::aero::AeroModel;
use flight_core::control::config::ControllerConfig;
use flight_core::control::law::residual::Policy;
use flight_core::{BuildError, Controller, RobotModel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One file of `configs/control/`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControllerSection {
    /// The controller's own aerodynamic model; `off` is the baseline controller.
    pub aero: AeroConfig,
    /// Learned policy whose action is added to the answer of the law, or replaces it; without it nothing is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<PolicyConfig>,
    /// The control law; its keys are at the same level as `aero`.
    #[serde(flatten)]
    pub law: ControllerConfig,
}

impl ControllerSection {
    /// Builds the controller of `robot` with this aerodynamic model.
    ///
    /// # Errors
    /// [`BuildError`] naming the file, or the item that does not match the robot.
    pub fn build(
        &self,
        robot: RobotModel,
        aero: impl FnOnce(&RobotModel) -> Result<AeroModel, BuildError>,
        mission: &MissionConfig,
    ) -> Result<Controller, BuildError> {
        let Self { policy, law, .. } = self;
        let policy = policy.as_ref().map(|policy| self.load_policy(policy, &robot)).transpose()?;
        let mut controller = Controller::new(robot, aero, load_mission(mission)?, law)?;
        if let Some(policy) = policy {
            controller.set_policy(policy);
        }
        Ok(controller)
    }

    fn load_policy(&self, policy: &PolicyConfig, robot: &RobotModel) -> Result<Policy, BuildError> {
        for (is_refused, expected) in [
            (self.law.contact.is_some(), "none with controller.contact: policies learn in flight"),
            (!self.law.use_jets, "none without controller.use_jets: policies act on jets"),
        ] {
            if is_refused {
                return Err(BuildError::bad_value("controller.policy.card", policy.card.display(), expected));
            }
        }
        load_policy(policy, robot)
    }
}

/// What runs on board: a robot, its controller and its mission. An experiment has these keys too, and those of a simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OnboardConfig {
    /// The robot's TOML file.
    #[schemars(extend("format" = "path"))]
    pub robot: PathBuf,
    /// The controller.
    pub controller: ControllerSection,
    /// Commands of the autopilot, or a recorded reference.
    pub mission: MissionConfig,
}

/// Builds a controller of `robot`.
///
/// # Errors
/// [`BuildError`] naming the file, or the item that does not match the robot.
pub fn load_controller(
    robot: RobotModel,
    controller: &ControllerSection,
    mission: &MissionConfig,
) -> Result<Controller, BuildError> {
    let aero = |robot: &RobotModel| load_aero(&controller.aero, robot);
    controller.build(robot, aero, mission)
}
