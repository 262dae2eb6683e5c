//! The flight controller: one tick, from a measurement to thrust rates and joint torques.
//!
//! ```text
//! measure     the measurement, and what replaces its missing and implausible parts     measure, estimate
//! model       kinematics, dynamics, aerodynamic forces, momentum                       terms
//! detect      feet on the ground, the unmodelled wrench, faults                        estimate, detect
//! decide      thrust rates and joint velocities, by the momentum QP or a plan          law, mpc
//! act         joint torques, by the torque QP, limited in their rates                  law
//! predict     what the command lets expect, for the next tick                          acting, estimate
//! ```
//!
//! The stages are the files of [`tick`]; what they call stands in the folders on the right, and does not depend on it.
//!
//! [`Controller::tick`] follows this order. Each step fills one plain struct that the next reads; after a tick
//! [`Controller::terms`] gives access to all of them.
//!
//! [`Controller::start`] returns the [`ControllerState`], the only value that is changed by a tick and needed by the
//! next. A clone of it that is restored later continues with the same bits.
//!
//! A tick does not allocate, does not panic and ends after a bounded number of iterations. (Clarabel allocates, if the
//! configuration selects it.)
//!
//! Equations: `docs/model`. Unknowns `u = (Ṫ, ṡ)`: thrust rates and joint velocities. With `contact` in its
//! configuration the same controller also stands on its feet: `u = (Ṫ, ḟ_c, ṡ)`, and torques and foot wrenches are
//! determined together.

pub mod acting;
pub(crate) mod command;
pub mod config;
pub mod detect;
pub mod engine_condition;
pub mod estimate;
pub mod law;
pub mod limits;
pub mod measure;
pub mod modes;
pub mod mpc;
pub mod preview;
pub(crate) mod state;
pub(crate) mod terms;
pub(crate) mod tick;

pub use command::{BadCommand, Command};
pub use estimate::joint_tracker::JointMeasurement;
pub use measure::measurement::{BadStart, Estimate, Measurement};
pub use modes::Modes;
pub use preview::Preview;
pub use state::ControllerState;
pub use terms::{Present, Terms};
pub use tick::{Controller, Given};
