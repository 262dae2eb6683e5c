//! The whole controller tick, timed one by one along recorded flights, and a step of the plant.

mod common;

use flight_core::qp::{ClarabelSolver, DualActiveSet, QpSolver};
use flight_core::{BuildError, Measurement};
use flight_io::load_robot;
use flight_sim::{Plant, Scenario, Wind};
use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Instant;

/// Ticks timed per flight, at least.
const TICKS: usize = 20_000;

fn main() -> Result<(), BuildError> {
    println!("| timed one by one | count | p50 | p99 | p99.9 | max |");
    println!("|---|---|---|---|---|---|");
    let mut clock: Vec<f64> = (0..TICKS).map(|_| microseconds(|| ())).collect();
    report("the clock itself", &mut clock);
    for (title, name) in [
        ("tick, TEST2", "test2"),
        ("tick, TEST2, published arms", "test2_published"),
        ("tick, TEST1, published arms, until the fall", "test1_published"),
    ] {
        report(title, &mut tick_times(name)?);
    }
    report("tick on the ground, side wind to 15 m/s", &mut standing_tick_times()?);
    let (mut ours, mut clarabel) = standing_qp_times()?;
    report("its torque QP alone", &mut ours);
    report("its torque QP by Clarabel", &mut clarabel);
    report("plant, one tick (observe and advance), TEST2", &mut plant_times()?);
    Ok(())
}

/// Replays the measurements of a flight until there are enough ticks.
fn tick_times(name: &str) -> Result<Vec<f64>, BuildError> {
    let config = common::configuration(name)?;
    let end =
        Scenario::new(&config)?.run(|_, _| ControlFlow::Continue(())).ok().and_then(|result| result.loss);
    let ticks = common::record(&config, &(0.0..=end.map_or(f64::INFINITY, |fall| fall.time)))?;
    let mut times = Vec::with_capacity(TICKS + ticks.len());
    while times.len() < TICKS {
        let mut controller = common::controller(&config)?;
        let mut state = None;
        for tick in &ticks {
            let measurement = tick.measurement();
            let Some(state) = common::started(&mut controller, &mut state, &measurement) else { break };
            times.push(microseconds(|| controller.tick(state, black_box(&measurement)).status));
        }
    }
    Ok(times)
}

/// Replays a robot that stands.
fn standing_tick_times() -> Result<Vec<f64>, BuildError> {
    let config = common::configuration("balancing_lateral")?;
    let ticks = common::standing()?;
    let thrust = vec![0.0; load_robot(&config.robot)?.jets.len()];
    let mut times = Vec::with_capacity(TICKS + ticks.len());
    while times.len() < TICKS {
        let mut controller = common::controller(&config)?;
        let mut state = None;
        for (index, tick) in ticks.iter().enumerate() {
            let time = index as f64 * config.simulator.time_step;
            let measurement = Measurement {
                time,
                state: &tick.state,
                thrust: &thrust,
                wind: tick.wind,
                foot_wrenches: &tick.feet,
            };
            let Some(state) = common::started(&mut controller, &mut state, &measurement) else { break };
            times.push(microseconds(|| controller.tick(state, black_box(&measurement)).status));
        }
    }
    Ok(times)
}

/// The torque QPs of a robot that stands, by our solver and by Clarabel.
fn standing_qp_times() -> Result<(Vec<f64>, Vec<f64>), BuildError> {
    let ticks = common::standing()?;
    let Some(first) = ticks.first() else { return Ok(Default::default()) };
    let (n, rows) = (first.torque_qp.len(), first.torque_qp.rows());
    let mut ours = DualActiveSet::new(n, rows);
    let mut clarabel = ClarabelSolver::new(n, rows).without_polish();
    let mut times = (Vec::new(), Vec::new());
    for _ in 0..TICKS / ticks.len() {
        times.0.extend(ticks.iter().map(|tick| microseconds(|| ours.solve(black_box(&tick.torque_qp)).kkt)));
    }
    times.1.extend(ticks.iter().map(|tick| microseconds(|| clarabel.solve(black_box(&tick.torque_qp)).kkt)));
    Ok(times)
}

/// Observes and advances a plant under zero torque and held thrust, started anew every 50 ticks.
fn plant_times() -> Result<Vec<f64>, BuildError> {
    let config = common::configuration("test2")?;
    let robot = load_robot(&config.robot)?;
    let wind = Wind::new(&config.wind)?.velocity(config.simulator.duration);
    let (torque, thrust_rate) = (vec![0.0; robot.joints.len()], vec![0.0; robot.jets.len()]);
    let mut times = Vec::with_capacity(TICKS);
    while times.len() < TICKS {
        let mut plant = Plant::new(robot.clone(), &config.simulator, &config.disturbances)?;
        for _ in 0..50 {
            times.push(microseconds(|| {
                plant.observe(black_box(&wind));
                plant.advance(&torque, &thrust_rate, &wind, config.simulator.time_step);
            }));
        }
    }
    Ok(times)
}

fn microseconds<T>(work: impl FnOnce() -> T) -> f64 {
    let begin = Instant::now();
    black_box(work());
    1e6 * begin.elapsed().as_secs_f64()
}

fn report(what: &str, times: &mut [f64]) {
    times.sort_unstable_by(f64::total_cmp);
    let [p50, p99, p999, max] = [0.5, 0.99, 0.999, 1.0].map(|p| common::quantile(times, p));
    println!("| {what} | {} | {p50:.2} µs | {p99:.2} µs | {p999:.2} µs | {max:.1} µs |", times.len());
}
