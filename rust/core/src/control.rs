//! The flight controller: one tick, from a measurement to thrust rates and joint torques.
//!
//! ```text
//! measure     the measurement, and what replaces its missing and implausible parts     guard
//! model       kinematics, dynamics, aerodynamic forces, momentum                       terms
//! guard       what measurement and model together tell of sensors, engines and ground  guard
//! law         momentum QP: thrust rates and joint velocities                           law
//! torques     torque QP: joint torques, limited in their rates                         law
//! predict     what the command lets expect, for the next tick                          guard
//! ```
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

pub mod between;
pub mod command;
pub mod config;
pub mod greatest;
pub mod guard;
pub mod law;
pub mod limits;
pub mod measurement;
pub mod modes;
pub mod preview;
pub mod state;
pub mod terms;
pub mod tick;

pub use command::{BadCommand, Command};
pub use config::check_time_step;
pub use measurement::{BadStart, Measurement, OwnedMeasurement, Reading, UsedMeasurement};
pub use modes::Modes;
pub use preview::Preview;
pub use state::ControllerState;
pub use terms::{Estimates, Terms};
pub use tick::{Controller, Given};
