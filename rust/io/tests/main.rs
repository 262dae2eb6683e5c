//! Every test of the crate in one binary: what they share is compiled once.

#[path = "../../sim/tests/common/mod.rs"]
mod common;

mod files;
mod mission;
mod robot;
mod schema;
