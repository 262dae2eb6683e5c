//! The complete controller tick, timed individually along recorded flights, and a step of the plant.
//!
//! `cargo test` runs it too, with few ticks, so that it stays consistent with the configurations.

mod common;

use common::{StandingTick, Tick};
use flight_core::BuildError;
use flight_core::control::Terms;
use flight_core::control::law::residual::Sight;
use flight_core::qp::{ClarabelSolver, DualActiveSet, QpSolver};
use flight_io::{load_policy, load_robot};
use flight_sim::{Plant, Scenario, ScenarioConfig, Wind};
use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Instant;

/// Times of the same items \[µs\], one list for each replay.
type Replays = Vec<Vec<f64>>;

/// Time in which the plans of a flight are timed \[s\].
const PLANS_SPAN: f64 = 20.0;

/// Least number of ticks timed per flight, and of replays of a flight.
fn least_counts() -> (usize, usize) {
    if std::env::args().any(|argument| argument == "--bench") { (20_000, 7) } else { (1, 1) }
}

fn main() -> Result<(), BuildError> {
    println!("| timed one by one | count | p50 | p99 | p99.9 | max | p99.9 of the medians |");
    println!("|---|---|---|---|---|---|---|");
    report("the clock itself", &[(0..least_counts().0).map(|_| microseconds(|| ())).collect()]);
    for (title, name) in [
        ("tick, TEST2", "test2"),
        ("tick, TEST2, published arms", "test2_published"),
        ("tick, hover with a learned policy", "test1_policy"),
        ("tick, TEST1, published arms, until the fall", "test1_published"),
    ] {
        report(title, &tick_times(&common::configuration(name)?)?);
    }
    report("the policy alone", &policy_times()?);
    let nonlinear = common::without_engine(common::configuration("robot")?);
    let nonlinear = ("engine lost, nonlinear plan", nonlinear, 18.0);
    for (title, config, from) in common::planned_flights()?.into_iter().chain([nonlinear]) {
        report(&format!("tick that plans, {title}"), &plan_times(&config, from)?);
    }
    let mut config = common::configuration("test2")?;
    let mut contact = common::configuration("take_off")?.controller.law.contact;
    if let Some(transfer) = contact.as_mut().and_then(|contact| contact.load_transfer.as_mut()) {
        transfer.unmodelled_force_max = None; // TEST2 has no observer
    }
    config.controller.law.contact = contact;
    report("tick, TEST2, by a controller that can stand", &tick_times(&config)?);
    report("tick on the ground, side wind to 15 m/s", &standing_tick_times()?);
    let (ours, clarabel) = standing_qp_times()?;
    report("its torque QP alone", &ours);
    report("its torque QP by Clarabel", &clarabel);
    report("plant, one tick (observe and advance), TEST2", &plant_times()?);
    Ok(())
}

/// Replays the measurements of a flight and times the ticks after `from` \[s\] that make a plan, in processor time.
fn plan_times(config: &ScenarioConfig, from: f64) -> Result<Replays, BuildError> {
    let ticks = common::record(config, &(0.0..=from + PLANS_SPAN))?;
    replay(ticks.len(), |times| {
        let mut controller = common::controller(config)?;
        let mut state = None;
        for tick in &ticks {
            let measurement = tick.measurement.clone();
            let Some(state) = common::begin_flight(&mut controller, &mut state, &measurement) else { break };
            let begin = common::processor_time();
            black_box(controller.tick(state, black_box(&measurement)).modes);
            let taken = common::processor_time() - begin;
            if tick.measurement.time >= from && common::makes_plan(config, tick.measurement.time) {
                times.push(1e6 * taken);
            }
        }
        Ok(())
    })
}

/// Replays the measurements of a flight. Each is copied just before its tick, as a driver would write it: read from the
/// recording, which is larger than the cache, it would add 2 to 4 % to the tick.
fn tick_times(config: &ScenarioConfig) -> Result<Replays, BuildError> {
    let end =
        Scenario::new(config)?.run(|_, _| ControlFlow::Continue(())).ok().and_then(|result| result.loss);
    let ticks = common::record(config, &(0.0..=end.map_or(f64::INFINITY, |fall| fall.time)))?;
    replay(ticks.len(), |times| {
        let mut controller = common::controller(config)?;
        let mut state = None;
        for Tick { measurement, .. } in &ticks {
            let measurement = measurement.clone();
            let Some(state) = common::begin_flight(&mut controller, &mut state, &measurement) else { break };
            times.push(microseconds(|| controller.tick(state, black_box(&measurement)).modes));
        }
        Ok(())
    })
}

/// Replays the measurements of a flight with a policy, and times the policy after each tick.
fn policy_times() -> Result<Replays, BuildError> {
    let config = common::configuration("test1_policy")?;
    let robot = load_robot(&config.robot)?;
    let ticks = common::record(&config, &(0.0..=20.0))?;
    replay(ticks.len(), |times| {
        let mut controller = common::controller(&config)?;
        let Some(selected) = &config.controller.policy else { return Ok(()) };
        let mut policy = load_policy(selected, &robot)?;
        let mut state = None;
        for tick in &ticks {
            let measurement = &tick.measurement;
            let Some(state) = common::begin_flight(&mut controller, &mut state, measurement) else { break };
            controller.tick(state, measurement);
            let (Terms { kinematics, due, residual, .. }, wrench) =
                (&mut controller.terms().clone(), state.residual_wrench());
            let now = &state.estimate().robot;
            let (robot, thrust, posture) = (&now.state, now.thrust.as_slice(), state.posture());
            let seen = Sight { robot, thrust, kinematics, due, posture, wrench: &wrench };
            times.push(microseconds(|| policy.act(black_box(&seen), residual)));
        }
        Ok(())
    })
}

/// Replays the measurements of a standing robot, copied as in [`tick_times`].
fn standing_tick_times() -> Result<Replays, BuildError> {
    let config = common::configuration("balancing_lateral")?;
    let ticks = common::standing_ticks()?;
    replay(ticks.len(), |times| {
        let mut controller = common::controller(&config)?;
        let mut state = None;
        for StandingTick { measurement, .. } in &ticks {
            let measurement = measurement.clone();
            let Some(state) = common::begin_flight(&mut controller, &mut state, &measurement) else { break };
            times.push(microseconds(|| controller.tick(state, black_box(&measurement)).modes));
        }
        Ok(())
    })
}

/// Solves the torque QPs of a standing robot with our solver and with Clarabel.
fn standing_qp_times() -> Result<(Replays, Replays), BuildError> {
    let ticks = common::standing_ticks()?;
    let Some(first) = ticks.first() else { return Ok(Default::default()) };
    let (n, rows) = (first.torque_qp.len(), first.torque_qp.rows());
    let ours = replay(ticks.len(), |times| {
        let mut solver = DualActiveSet::new(n, rows);
        times.extend(ticks.iter().map(|tick| microseconds(|| solver.solve(black_box(&tick.torque_qp)).kkt)));
        Ok(())
    })?;
    let mut clarabel = ClarabelSolver::new(n, rows).without_polish();
    let once = ticks.iter().map(|tick| microseconds(|| clarabel.solve(black_box(&tick.torque_qp)).kkt));
    Ok((ours, vec![once.collect()]))
}

/// Observes and advances a plant with zero torque and constant thrust for 50 ticks.
fn plant_times() -> Result<Replays, BuildError> {
    let config = common::configuration("test2")?;
    let robot = load_robot(&config.robot)?;
    let wind = Wind::new(&config.wind)?.velocity(config.simulator.duration);
    let (torque, thrust_rate) = (vec![0.0; robot.joints.len()], vec![0.0; robot.jets.len()]);
    replay(50, |times| {
        let mut plant =
            Plant::new(robot.clone(), &config.simulator, &config.disturbances, &config.controller.law)?;
        times.extend((0..50).map(|_| {
            microseconds(|| {
                plant.observe(black_box(&wind));
                plant.advance(&torque, &thrust_rate, &wind, config.controller.law.time_step);
            })
        }));
        Ok(())
    })
}

/// Calls `times_of_all`, which times `items` constant items, at least as often as [`least`] states.
fn replay(
    items: usize,
    mut times_of_all: impl FnMut(&mut Vec<f64>) -> Result<(), BuildError>,
) -> Result<Replays, BuildError> {
    let (ticks, replays) = least_counts();
    let count = replays.max(ticks.div_ceil(items.max(1)));
    (0..count)
        .map(|_| {
            let mut times = Vec::with_capacity(items);
            times_of_all(&mut times).map(|()| times)
        })
        .collect()
}

fn microseconds<T>(work: impl FnOnce() -> T) -> f64 {
    let begin = Instant::now();
    black_box(work());
    1e6 * begin.elapsed().as_secs_f64()
}

/// Prints quantiles over all times, which include interruptions of the program, and over the median time of each
/// item, which do not: an interruption rarely occurs at the same tick of every replay.
fn report(what: &str, replays: &[Vec<f64>]) {
    let mut times = replays.concat();
    let mut medians: Vec<f64> = (0..replays.first().map_or(0, Vec::len))
        .map(|item| {
            let mut of_item: Vec<f64> = replays.iter().filter_map(|times| times.get(item).copied()).collect();
            of_item.sort_unstable_by(f64::total_cmp);
            common::quantile(&of_item, 0.5)
        })
        .collect();
    times.sort_unstable_by(f64::total_cmp);
    medians.sort_unstable_by(f64::total_cmp);
    let [p50, p99, p999, max] = [0.5, 0.99, 0.999, 1.0].map(|p| common::quantile(&times, p));
    let own = common::quantile(&medians, 0.999);
    let count = times.len();
    println!("| {what} | {count} | {p50:.2} µs | {p99:.2} µs | {p999:.2} µs | {max:.1} µs | {own:.2} µs |");
}
