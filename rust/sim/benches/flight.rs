//! One complete flight of 50 s on one core.

mod common;

use criterion::{BatchSize, Criterion};
use flight_core::BuildError;
use flight_sim::Scenario;
use std::ops::ControlFlow;
use std::time::Duration;

fn main() -> Result<(), BuildError> {
    let mut criterion =
        Criterion::default().sample_size(20).measurement_time(Duration::from_secs(5)).configure_from_args();
    let mut group = criterion.benchmark_group("flight");
    for name in ["test2", "test2_published"] {
        let config = common::configuration(name)?;
        // Any refusal of the configuration occurs here.
        Scenario::new(&config)?;
        group.bench_function(format!("{name}, 50 s"), |b| {
            b.iter_batched(
                || Scenario::new(&config),
                |flight| flight.map(|flight| flight.run(|_, _| ControlFlow::Continue(()))),
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
    criterion.final_summary();
    Ok(())
}
