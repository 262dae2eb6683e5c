//! The choice among the aerodynamic models.

use super::{Axisymmetric, ForceFactors, ForceFactorsConfig, LinksInAir, Network, SphereCylinder};
use crate::error::BuildError;
use crate::robot::RobotModel;
use nalgebra::Vector3;

/// A checked aerodynamic model of one robot.
#[derive(Debug, Clone)]
pub enum AeroModel {
    /// No aerodynamic force, as the baseline controller assumes.
    Off,
    /// Axisymmetric links with fitted force areas.
    Axisymmetric(Axisymmetric),
    /// Spheres and finite cylinders with drag coefficients from the literature.
    SphereCylinder(SphereCylinder),
    /// A neural network whose inputs are wind and posture.
    Network(Box<Network>),
    /// Another model whose forces are multiplied by factors.
    Weighted(Box<AeroModel>, ForceFactors),
}

impl AeroModel {
    /// Whether the model gives no force at all.
    #[must_use]
    pub fn is_off(&self) -> bool {
        match self {
            Self::Off => true,
            Self::Weighted(model, _) => model.is_off(),
            Self::Axisymmetric(_) | Self::SphereCylinder(_) | Self::Network(_) => false,
        }
    }

    /// Returns this model with factors on its forces; `table` is named in errors.
    ///
    /// # Errors
    /// As [`ForceFactors::new`].
    pub fn weight_forces(
        self,
        factors: &ForceFactorsConfig,
        robot: &RobotModel,
        table: &str,
    ) -> Result<Self, BuildError> {
        if factors.is_default() {
            return Ok(self);
        }
        Ok(Self::Weighted(Box::new(self), ForceFactors::new(factors, &robot.aero_links, table)?))
    }

    /// Writes the force on each link \[N\], inertial axes, acting at its aerodynamic centre.
    ///
    /// Zero at zero relative wind, and finite for wind along an axis. Slices of different length do not
    /// panic: links up to the shortest are evaluated, the other forces are zero. Speeds above 1e150 m/s
    /// overflow.
    pub fn link_forces(&mut self, links: &LinksInAir, forces_i: &mut [Vector3<f64>]) {
        match self {
            Self::Off => forces_i.fill(Vector3::zeros()),
            Self::Axisymmetric(model) => fill_forces(links, forces_i, |i, k, v| model.link_force(i, k, v)),
            Self::SphereCylinder(model) => fill_forces(links, forces_i, |i, k, v| model.link_force(i, k, v)),
            Self::Network(model) => model.link_forces(links, forces_i),
            Self::Weighted(model, factors) => {
                model.link_forces(links, forces_i);
                factors.apply(links.v_air_i, forces_i);
            }
        }
    }
}

/// Evaluates a model that treats each link alone: `force` receives a link's index, axis and relative air
/// velocity.
fn fill_forces(
    links: &LinksInAir,
    forces_i: &mut [Vector3<f64>],
    force: impl Fn(usize, &Vector3<f64>, &Vector3<f64>) -> Vector3<f64>,
) {
    forces_i.fill(Vector3::zeros());
    let samples = links.axes_i.iter().zip(links.v_air_i).zip(forces_i);
    for (link, ((axis_i, v_air_i), force_i)) in samples.enumerate() {
        *force_i = force(link, axis_i, v_air_i);
    }
}
