//! The ground of simulations with a standing robot.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The ground, plane z = 0 unless it has a slope or a step. Only engines that simulate contact can fly a configuration with
/// ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GroundConfig {
    /// Coulomb friction coefficient of soles on the ground.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub friction: f64,
    /// Angles by which the ground is turned about the origin, first about x, then about y of the inertial axes \[deg\], and with
    /// it the initial pose of the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<[Tilt; 2]>")]
    pub slope_deg: Option<[f64; 2]>,
    /// A step of the ground across the direction x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<StepConfig>,
    /// State measurement of the standing robot by its legs; without it the true state is measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leg_odometry: Option<LegOdometryConfig>,
}

/// An angle of the ground \[deg\].
#[derive(JsonSchema)]
#[schemars(inline)]
struct Tilt(
    #[schemars(range(min = -20, max = 20))]
    #[allow(dead_code)]
    f64,
); // for the schema

/// Ground that is higher, or lower, from one place on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StepConfig {
    /// Coordinate x of the edge, along the ground \[m\]; the robot starts before it.
    #[schemars(range(min = 0.5))]
    pub start: f64,
    /// Height of the ground beyond it above that before it \[m\].
    #[schemars(range(min = -0.5, max = 0.5))]
    pub height: f64,
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
