//! Aerodynamic force on each link, from the velocity of the air relative to it.
//!
//! ```text
//! coefficients, RobotModel ──new──► AeroModel;   LinksInAir ──link_forces──► forces_i
//! ```
//!
//! The simulator's and the controller's model are two values of [`AeroModel`]; the configuration selects
//! each. `v_air_i` is always the velocity of the *air* relative to the link (wind − link velocity), the
//! negative of the paper's `v_a`, so drag points along `+v_air_i`. Forces act at the link's aerodynamic
//! centre; no model gives a moment about it.
//!
//! Equation M19 of `docs/model.md`.

pub mod axisymmetric;
pub mod factors;
pub mod link_forces;
pub mod network;
pub mod pchip;
pub mod sphere_cylinder;

pub use axisymmetric::{Axisymmetric, AxisymmetricConfig, axisymmetric_force};
pub use factors::{ForceFactors, ForceFactorsConfig};
pub use link_forces::{JacobianOffset, LeverArm, LinkConventions, LinkForces, LinkVelocity, LinksInAir};
pub use network::{Network, Precision};
pub use pchip::Pchip;
pub use sphere_cylinder::{CylinderTables, SphereCylinder, SphereCylinderConfig, SphereTables};

use crate::error::{BuildError, check};
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

/// Added to the speed in the cosine of the angle of attack \[m/s\]; the published value.
const SPEED_EPSILON: f64 = 1e-9;

/// Angle of attack of a link, between its axis and the *upstream* direction, as cosine and sine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attack {
    /// Speed of the air relative to the link \[m/s\].
    pub speed: f64,
    /// `cos α`; 1 when the air comes from the direction of the axis.
    pub cos: f64,
    /// `sin α ≥ 0`.
    pub sin: f64,
}

impl Attack {
    /// Cosine and sine of the angle of attack, without `acos`.
    ///
    /// ```text
    /// cos α = −k̂·v / (|v| + ε),   sin α = √(|v × k̂|² + ε (2|v| + ε)) / (|v| + ε),   ε = 1e-9 m/s
    /// ```
    ///
    /// Source: the published controller, `α = acos(k̂·(−v)/(|v| + ε))`. The sine is that of the same angle
    /// without the cancellation of `1 − cos²`: by Lagrange's identity the root is `√((|v| + ε)² − (k̂·v)²)`.
    /// ε keeps the quotient finite at rest and the argument of the root positive, so both are smooth for wind
    /// along the axis; at rest α = 90°.
    #[must_use]
    pub fn new(axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Self {
        let speed = v_air_i.norm();
        let regular = speed + SPEED_EPSILON;
        let across = v_air_i.cross(axis_i).norm_squared() + SPEED_EPSILON * (speed + regular);
        Self {
            speed,
            cos: (-axis_i.dot(v_air_i) / regular).clamp(-1.0, 1.0),
            // The axis has unit length up to rounding, so either value can exceed one by an ulp.
            sin: (across.sqrt() / regular).min(1.0),
        }
    }
}

/// `(v × k̂) × v = |v|² k̂ − (v·k̂) v`: perpendicular to the wind, towards the axis, of length `|v|² sin α`.
fn normal_direction(axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Vector3<f64> {
    // Unlike the difference, the double cross product has no cancellation when wind and axis are parallel.
    v_air_i.cross(axis_i).cross(v_air_i)
}

/// Checks the density of the fluid \[kg/m³\]: positive, at most ten times that of water.
fn check_air_density(density: f64) -> Result<f64, BuildError> {
    check("air_density", density, |rho| 0.0 < rho && rho <= 1e4, "a positive density up to 10000 kg/m³")
}
