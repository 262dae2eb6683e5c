//! The control law: from the set-point to thrust rates and joint velocities ([`rates`]), and from these to torques
//! ([`torques`]).

pub mod attitude;
pub mod bounds;
pub mod contact;
pub mod minimum_jerk;
pub mod mission;
pub mod momentum;
pub mod momentum_qp;
pub mod mpc;
pub(crate) mod rates;
pub mod recorded;
pub mod residual;
pub mod setpoint;
pub mod tasks;
pub mod torque;
pub(crate) mod torques;
