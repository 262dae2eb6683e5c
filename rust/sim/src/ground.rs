//! The ground of simulations with a standing robot.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The ground, plane z = 0. Only engines that simulate contact can fly a configuration with ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GroundConfig {
    /// Coulomb friction coefficient of soles on the ground.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub friction: f64,
    /// State measurement of the standing robot by its legs; without it the true state is measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leg_odometry: Option<LegOdometryConfig>,
}

/// State measurement by the legs: pose of the base from the first of the controller's feet, velocity from all of them,
/// assuming that the feet rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LegOdometryConfig {
    /// Time constant of the first-order low pass of the joint velocities for the controller \[s\].
    #[schemars(range(min = 0))]
    pub velocity_time_constant: f64,
}
