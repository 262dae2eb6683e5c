//! What the documentation shows as a program, runs.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[path = "../examples/tutorial.rs"]
mod tutorial;

#[test]
fn the_tutorial_runs() {
    tutorial::main().unwrap();
}
