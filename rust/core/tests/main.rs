//! Every test of the crate in one binary: what they share is compiled once.

#[path = "../../sim/tests/common/mod.rs"]
mod common;

mod aero;
mod certificate;
mod channels;
mod contact;
mod control;
mod dynamics;
mod engines;
mod estimator;
mod jets;
mod joints;
mod latency;
mod linalg;
mod link_forces;
mod momentum;
mod mpc;
mod network;
mod nonlinear;
mod observer;
mod qp;
mod qp_rows;
mod recorded;
mod residual;
mod robot;
mod setpoint;
mod shaft;
mod spatial;
mod tasks;
mod timing;
mod tracking_error;
mod unmeasured_engines;
mod wind_observer;
