//! Observers and the state estimator: what is not measured, from what is.

pub mod disturbance_observer;
pub mod estimator;
pub mod joint_tracker;
pub mod wind_observer;
