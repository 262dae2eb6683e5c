//! Aerodynamics, rigid-body dynamics and momentum-based flight control of a jet-powered humanoid
//! robot, with a closed-loop reference simulator.
//!
//! ```text
//! RobotState, Wind ► Kinematics ► LinkForces ► MomentumModel ► MomentumQp ► Command ► torques
//!      ▲                                                                                  │
//!      └───────────────────── sim::Plant::advance (the only integrator) ◄─────────────────┘
//! ```
//!
//! Each arrow is one plain struct, filled once per tick and passed on. Rooms, from the ground up:
//! [`spatial`] · [`robot`] · [`kinematics`] · [`dynamics`] · [`aero`] · [`jets`] · [`control`] ·
//! [`sim`], and at the door [`config`] and [`error`]. [`linalg`] is the cellar: small dense algebra
//! on slices, for the mass matrix and the QPs; [`noise`] is repeatable chance.
//!
//! SI units and radians; vectors and Jacobians in inertial axes unless a suffix says otherwise.

#![forbid(unsafe_code)]

pub mod aero;
pub mod config;
pub mod control;
pub mod dynamics;
pub mod error;
pub mod jets;
pub mod kinematics;
pub mod linalg;
pub mod noise;
pub mod robot;
pub mod sim;
pub mod spatial;

pub use config::load_flight;
pub use control::{Command, Controller, Measurement};
pub use error::BuildError;
pub use kinematics::RobotState;
pub use robot::RobotModel;
pub use sim::{Flight, FlightConfig, FlightResult};
