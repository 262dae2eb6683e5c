//! The guard of the law: which measurements are used, what replaces the others, and what is known of disturbances,
//! engines and sensors.

pub mod channels;
pub mod engines;
pub mod estimator;
pub mod joints;
pub mod latency;
pub mod observer;
pub mod stages;
pub mod supervisor;
pub mod wind_observer;
