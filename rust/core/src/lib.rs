//! Aerodynamics, rigid-body dynamics and momentum-based flight control of a jet-powered humanoid robot: one
//! tick of the controller with all that it needs. No files, threads, clocks or logs.
//!
//! ```text
//! RobotState, wind ► Kinematics ► LinkForces ► MomentumModel ► MomentumQp ► Command ► torques
//! ```
//!
//! Each arrow is one plain struct, computed once per tick and passed on. Modules, each using only those
//! before it: [`error`] · [`schema`] · [`spatial`] · [`linalg`] · [`robot`] · [`kinematics`] · [`subtree`] · [`dynamics`]
//! · [`aero`] · [`jets`] · [`qp`] · [`timing`] · [`control`].
//!
//! SI units and radians; vectors and Jacobians are in inertial axes unless a suffix states otherwise.

#![forbid(unsafe_code)]
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::disallowed_methods))]

pub mod aero;
pub mod control;
pub mod dynamics;
pub mod error;
mod exponential;
pub(crate) mod float;
pub mod jets;
pub mod kinematics;
pub mod linalg;
pub mod qp;
pub mod robot;
pub mod schema;
pub mod spatial;
pub mod subtree;
pub mod timing;

pub use nalgebra;

pub use control::guard::estimator::Estimator;
pub use control::guard::wind_observer::WindObserver;
pub use control::{Command, Controller, Measurement, Reading};
pub use error::BuildError;
pub use kinematics::RobotState;
pub use robot::RobotModel;
