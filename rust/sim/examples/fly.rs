//! Flies configuration files and prints the outcome of each flight.
//!
//! ```text
//! cargo run --release --example fly -- configs/experiments/test1.toml configs/experiments/test2.toml
//! ```

use flight_sim::{Scenario, load_scenario};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for path in std::env::args().skip(1) {
        let config = load_scenario(Path::new(&path))?;
        let flight = Scenario::new(&config)?;
        let begin = Instant::now();
        let Ok(result) = flight.run(|_, _| ControlFlow::Continue(())) else { continue };
        let summary = &result.summary;
        let outcome = match result.loss {
            None => result.outcome.name().to_owned(),
            Some(loss) => format!("{} at {:.2} s: {}", result.outcome.name(), loss.time, loss.reason),
        };
        println!("{}: {outcome}, computed in {:.2} s", config.title, begin.elapsed().as_secs_f64());
        println!(
            "  rotation error {:.2} deg, CoM error {:.4} m, thrust {:.1} to {:.1} N, torque {:.1} N m",
            summary.max_rotation_error.to_degrees(),
            summary.max_com_error,
            summary.thrust_min,
            summary.thrust_max,
            summary.max_torque,
        );
        println!(
            "  lowest CoM {:.5} m, rearmost {:.5} m while settling; KKT {:.1e}, {} QP iterations at most, {} ticks without a solution",
            summary.min_com_height,
            summary.min_com_x_settling,
            summary.max_kkt,
            summary.max_qp_iterations,
            summary.ticks_without_solution,
        );
    }
    Ok(())
}
