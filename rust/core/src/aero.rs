//! Aerodynamic force on each link, from the velocity of the air relative to it.
//!
//! ```text
//! coefficients, RobotModel ──new──► AeroModel;   LinksInAir ──link_forces──► forces_i
//! ```
//!
//! The simulator's model and the controller's model are two values of [`AeroModel`]: which one is
//! simulated and which one is compensated is configuration. `v_air_i` is everywhere the velocity of
//! the *air* relative to the link (wind − link velocity), the negative of the paper's `v_a`, so drag
//! points along `+v_air_i`. Forces act at the link's aerodynamic centre; no model gives a moment
//! about it.
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
    /// No aerodynamic force: what the baseline controller assumes.
    Off,
    /// Fitted force areas of axisymmetric links.
    Axisymmetric(Axisymmetric),
    /// Literature drag of spheres and finite cylinders.
    SphereCylinder(SphereCylinder),
    /// A neural network of wind and posture.
    Network(Box<Network>),
    /// Another model, its forces stronger or weaker by factors.
    Weighted(Box<AeroModel>, ForceFactors),
}

impl AeroModel {
    /// Whether it has no force at all.
    #[must_use]
    pub fn is_off(&self) -> bool {
        match self {
            Self::Off => true,
            Self::Weighted(model, _) => model.is_off(),
            Self::Axisymmetric(_) | Self::SphereCylinder(_) | Self::Network(_) => false,
        }
    }

    /// This model with factors on its forces; `table` is named in errors.
    ///
    /// # Errors
    /// As [`ForceFactors::new`].
    pub fn weighted(
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
    /// Zero at rest; finite for wind along an axis. Total: slices of different length are served up to the
    /// shortest, and a force without a link is zero. Speeds beyond 1e150 m/s overflow.
    pub fn link_forces(&mut self, links: &LinksInAir, forces_i: &mut [Vector3<f64>]) {
        match self {
            Self::Off => forces_i.fill(Vector3::zeros()),
            Self::Axisymmetric(model) => by_link(links, forces_i, |i, k, v| model.link_force(i, k, v)),
            Self::SphereCylinder(model) => by_link(links, forces_i, |i, k, v| model.link_force(i, k, v)),
            Self::Network(model) => model.link_forces(links, forces_i),
            Self::Weighted(model, factors) => {
                model.link_forces(links, forces_i);
                factors.apply(links.v_air_i, forces_i);
            }
        }
    }
}

/// Evaluates a model of single links: a force from the number, axis and air of each.
fn by_link(
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

/// Angle of attack of a link: between its axis and the *upstream* direction, as cosine and sine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attack {
    /// Speed of the air relative to the link \[m/s\].
    pub speed: f64,
    /// `cos α`; 1 when the air comes from where the axis points.
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
    /// Source: the published controller, `α = acos(k̂·(−v)/(|v| + ε))`. The sine is the same number
    /// written without the cancellation of `1 − cos²`: `(|v| + ε)² − (k̂·v)²` by Lagrange's identity.
    /// The ε that keeps the quotient finite at rest also keeps the root's argument positive, so both
    /// are smooth for wind along the axis; at rest α = 90°.
    #[must_use]
    pub fn new(axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Self {
        let speed = v_air_i.norm();
        let regular = speed + SPEED_EPSILON;
        let across = v_air_i.cross(axis_i).norm_squared() + SPEED_EPSILON * (speed + regular);
        Self {
            speed,
            cos: (-axis_i.dot(v_air_i) / regular).clamp(-1.0, 1.0),
            // Rounding of a unit axis can push either past one by an ulp.
            sin: (across.sqrt() / regular).min(1.0),
        }
    }
}

/// `(v × k̂) × v = |v|² k̂ − (v·k̂) v`: across the wind, towards the axis, of length `|v|² sin α`.
fn normal_direction(axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Vector3<f64> {
    // The double cross product, not the difference: no cancellation when wind and axis align.
    v_air_i.cross(axis_i).cross(v_air_i)
}

/// Refuses what is no density of a fluid \[kg/m³\]; ten times that of water is the most.
fn check_air_density(density: f64) -> Result<f64, BuildError> {
    check("air_density", density, |rho| 0.0 < rho && rho <= 1e4, "a positive density up to 10000 kg/m³")
}
