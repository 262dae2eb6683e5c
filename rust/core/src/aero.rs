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
//! Equation M19 of `docs/model`.

pub(crate) mod attack;
pub mod axisymmetric;
pub(crate) mod derivatives;
pub(crate) mod factors;
pub(crate) mod link_forces;
pub(crate) mod links;
pub(crate) mod model;
pub mod network;
pub(crate) mod pchip;
pub(crate) mod sphere_cylinder;

pub use attack::Attack;
pub use axisymmetric::{Axisymmetric, AxisymmetricConfig, axisymmetric_force};
pub(crate) use derivatives::ForceDerivatives;
pub(crate) use factors::ForceFactors;
pub use factors::ForceFactorsConfig;
pub use link_forces::{JacobianOffset, LeverArm, LinkConventions, LinkForces, LinkVelocity};
pub use links::LinksInAir;
pub use model::AeroModel;
pub use network::{Network, Precision};
pub use pchip::Pchip;
pub use sphere_cylinder::{SphereCylinder, SphereCylinderConfig};
