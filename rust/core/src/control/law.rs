//! The equations of the control law: each file is a kernel that does not depend on the tick.

pub mod attitude;
pub mod bounds;
pub mod contact;
pub mod minimum_jerk;
pub mod mission;
pub mod momentum;
pub mod momentum_qp;
pub mod recorded;
pub mod residual;
pub mod setpoint;
pub mod tasks;
pub mod torque;
