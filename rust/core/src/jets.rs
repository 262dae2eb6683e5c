//! Jet engines: their identified model, the loop that makes them follow a thrust rate, the estimate of
//! their thrust.

pub mod ekf;
pub mod engine;

pub use ekf::{EkfConfig, ThrustEkf};
pub use engine::{EngineDynamics, EngineModel, ThrustRateController};

use nalgebra::{Vector3, Vector6};

/// Force of a jet on the robot \[N\], inertial axes, at the jet's origin: `f = T a`.
#[must_use]
pub fn thrust_force(axis_i: &Vector3<f64>, thrust: f64) -> Vector3<f64> {
    axis_i * thrust
}

/// Wrench of a jet about a point, inertial axes: force \[N\], then moment \[N m\].
///
/// `w = [a; r × a] T`, with `arm_i` from the point to the jet; a thrust of 1 N gives the jet's column
/// of the paper's `A_T`.
#[must_use]
pub fn thrust_wrench(axis_i: &Vector3<f64>, arm_i: &Vector3<f64>, thrust: f64) -> Vector6<f64> {
    let force = thrust_force(axis_i, thrust);
    let moment = arm_i.cross(&force);
    Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z)
}
