//! Both QPs on consecutive ticks of a calm and of a failing flight, with our solvers and Clarabel.
//!
//! Times are for a sequence of 201 ticks: divide by 201.

mod common;

use criterion::{Criterion, Throughput};
use flight_core::BuildError;
use flight_core::qp::{ClarabelSolver, PrimalActiveSet, QpProblem, QpSolver};
use std::hint::black_box;
use std::time::Duration;

fn main() -> Result<(), BuildError> {
    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2))
        .sample_size(20)
        .configure_from_args();
    let mut group = criterion.benchmark_group("qp");
    for (case, ticks) in [("calm", common::calm_ticks()?), ("saturated", common::saturated_ticks()?)] {
        let momentum: Vec<&QpProblem> = ticks.iter().map(|tick| &tick.momentum_qp).collect();
        let torque: Vec<&QpProblem> = ticks.iter().map(|tick| &tick.torque_qp).collect();
        for (name, problems) in [("momentum", momentum), ("torque", torque)] {
            let n = problems[0].len();
            group.throughput(Throughput::Elements(problems.len() as u64));
            let mut solver = PrimalActiveSet::new(n);
            group.bench_function(format!("{name}, {case}, active set, warm"), |b| {
                b.iter(|| problems.iter().map(|qp| solver.solve(black_box(qp)).iterations).sum::<u32>());
            });
            group.bench_function(format!("{name}, {case}, active set, cold"), |b| {
                b.iter(|| {
                    for qp in &problems {
                        solver.reset();
                        solver.solve(black_box(qp));
                    }
                });
            });
            let mut clarabel = ClarabelSolver::new(n, 0);
            group.bench_function(format!("{name}, {case}, Clarabel at 1e-12"), |b| {
                b.iter(|| problems.iter().map(|qp| clarabel.solve(black_box(qp)).iterations).sum::<u32>());
            });
        }
    }
    group.finish();
    criterion.final_summary();
    Ok(())
}
