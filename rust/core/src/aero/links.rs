//! What every aerodynamic model is given.

use crate::error::{BuildError, check};
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use nalgebra::Vector3;

/// Inputs of an aerodynamic model: the robot's links and the air around them, inertial axes.
#[derive(Debug, Clone, Copy)]
pub struct LinksInAir<'a> {
    /// The robot.
    pub robot: &'a RobotModel,
    /// Its kinematics.
    pub kinematics: &'a Kinematics,
    /// Unit vectors of the symmetry axes, in the order of the links.
    pub axes_i: &'a [Vector3<f64>],
    /// Velocity of the air relative to each link \[m/s\].
    pub v_air_i: &'a [Vector3<f64>],
    /// Velocity of the air \[m/s\].
    pub wind_i: &'a Vector3<f64>,
}

/// Checks the density of the fluid \[kg/m³\]: positive, at most ten times that of water.
pub(super) fn check_air_density(density: f64) -> Result<f64, BuildError> {
    check("air_density", density, |rho| 0.0 < rho && rho <= 1e4, "a positive density up to 10000 kg/m³")
}
