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

pub mod attack;
pub mod axisymmetric;
pub mod derivatives;
pub mod factors;
pub mod link_forces;
pub mod links;
pub mod model;
pub mod network;
pub mod pchip;
pub mod sphere_cylinder;

pub use attack::Attack;
pub use axisymmetric::{Axisymmetric, AxisymmetricConfig, axisymmetric_force};
pub use derivatives::ForceDerivatives;
pub use factors::{ForceFactors, ForceFactorsConfig};
pub use link_forces::{JacobianOffset, LeverArm, LinkConventions, LinkForces, LinkVelocity};
pub use links::LinksInAir;
pub use model::AeroModel;
pub use network::{Network, Precision};
pub use pchip::Pchip;
pub use sphere_cylinder::{CylinderTables, SphereCylinder, SphereCylinderConfig, SphereTables};
