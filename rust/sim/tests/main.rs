//! Every test of the crate in one binary: what they share is compiled once.

mod common;

mod ablation;
mod absurd;
mod actuation;
mod config;
mod disturbances;
mod examples;
mod flight;
mod fuel;
mod fuzz;
mod jets;
mod joint_faults;
mod motors;
mod pushes;
mod rates;
mod recorded;
mod replay;
mod restored;
mod sensors;
