//! The ground and the motors of a simulation in which the robot stands.

use flight_core::error::{BuildError, Table, place_of};
use flight_core::robot::RobotModel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The plane z = 0 under the robot's feet. Only engines that simulate contact fly a world that has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GroundConfig {
    /// Coulomb friction of soles on the ground.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub friction: f64,
    /// Time in which a touching corner comes to rest \[s\]: softer with a longer one.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub contact_time: f64,
    /// How long stiff joints hold the initial posture before the controller takes over at time zero \[s\].
    #[schemars(range(min = 0))]
    pub settling: f64,
    /// How the robot measures its own state while it stands; without it the state is measured as it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leg_odometry: Option<LegOdometryConfig>,
}

/// The state of a standing robot as its legs measure it: the pose of the base from the first of the controller's feet,
/// its velocity from all of them, as if they stayed where they are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LegOdometryConfig {
    /// Time constant of the first-order low pass of the joint velocities that the controller gets \[s\].
    #[schemars(range(min = 0))]
    pub velocity_time_constant: f64,
}

/// What stands between a motor's torque and its joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotorsConfig {
    /// Dry friction of every joint \[N m\].
    #[schemars(range(min = 0))]
    pub friction: f64,
    /// Dry friction of joints that have another, by name \[N m\].
    #[serde(default)]
    pub friction_of: BTreeMap<String, f64>,
    /// Viscous friction of every joint \[N m s\].
    #[schemars(range(min = 0))]
    pub damping: f64,
    /// Stiffness with which every drive holds the posture that the robot starts in \[N m/rad\].
    #[serde(default)]
    #[schemars(range(min = 0))]
    pub stiffness: f64,
    /// Rotor inertia seen at every joint \[kg m²\].
    #[schemars(range(min = 0))]
    pub inertia: f64,
}

impl GroundConfig {
    /// Refuses numbers that are no ground.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let table = Table("simulator.ground");
        table.positive("friction", self.friction)?;
        table.check("contact_time", self.contact_time, |x| x > 0.0, "a positive time in s")?;
        table.check("settling", self.settling, |x| x >= 0.0, "a time ≥ 0 in s")?;
        self.leg_odometry.as_ref().map_or(Ok(()), |LegOdometryConfig { velocity_time_constant }| {
            let key = "leg_odometry.velocity_time_constant";
            table.check(key, *velocity_time_constant, |x| x >= 0.0, "a time ≥ 0 in s")
        })
    }
}

impl MotorsConfig {
    /// Refuses numbers that are no motors, and joints that `robot` does not have.
    ///
    /// # Errors
    /// [`BuildError`] naming the key.
    pub fn check(&self, robot: &RobotModel) -> Result<(), BuildError> {
        let table = Table("simulator.motors");
        table.non_negative("friction", self.friction)?;
        table.non_negative("damping", self.damping)?;
        table.non_negative("stiffness", self.stiffness)?;
        table.non_negative("inertia", self.inertia)?;
        for (joint, friction) in &self.friction_of {
            place_of("simulator.motors.friction_of", joint, robot.joints.iter().map(|joint| &joint.name))?;
            table.non_negative(&format!("friction_of.{joint}"), *friction)?;
        }
        Ok(())
    }
}
