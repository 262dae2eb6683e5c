//! What is measured, and which of it is accepted.

pub mod channels;
pub mod greatest;
pub mod measurement;
