//! The guard of the law: which measurements are used, what replaces the others, and what is known of disturbances,
//! engines and sensors. It consists of the channels of the measurement and the stages that are configured, each in a file beside its detection.
//!
//! ```text
//!                 measure                       judge                                  predict
//! channels        missing values predicted                                             acceleration (M101)
//! wind_observer   its wind, for the measured                                           the next wind
//! feet                                          whether they carry load, M114
//! observer                                      unmodelled wrench of the momentum
//! engines                                       limits of thrusts, wrong sensors
//! joints          length of their ways          which do not follow their torques      commanded displacements
//! latency         measured joints and thrusts   whether commands are late
//! supervisor                                    whether the flight strays
//! estimator       its state, for the measured   without what wrong sensors measured    stores the command
//! ```

pub mod channels;
pub mod engines;
pub mod estimator;
pub mod feet;
pub mod joints;
pub mod latency;
pub mod observer;
pub mod stage;
pub mod supervisor;
pub mod wind_observer;
