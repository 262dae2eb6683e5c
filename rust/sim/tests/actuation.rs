//! Commands on their way: late by what is configured, held where one is lost.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "commands arrive with the same bits")]

use crate::common::{assert_says, assert_within, experiment};
use flight_core::control::estimate::estimator::{EstimatorConfig, LatencyConfig};
use flight_sim::{Actuation, ActuationConfig, FlightResult, Outcome, Scenario, ScenarioConfig};
use std::ops::ControlFlow;

const STEP: f64 = 0.001;

/// What acts in every sub-step of every tick, where tick k commands k and −k.
fn acting(config: &ActuationConfig, substeps: u32, ticks: u32) -> (Vec<f64>, Vec<f64>) {
    let mut way = Actuation::new(config, STEP, substeps, 1, 1, 1).unwrap();
    let (mut torques, mut rates) = (Vec::new(), Vec::new());
    for tick in 0..ticks {
        way.send(&[f64::from(tick)], &[-f64::from(tick)]);
        torques.extend((0..substeps).map(|substep| way.torque(substep)[0]));
        rates.push(way.thrust_rate()[0]);
    }
    (torques, rates)
}

fn fly(config: &ScenarioConfig) -> FlightResult {
    Scenario::new(config).unwrap().run(|_, _| ControlFlow::Continue(())).unwrap()
}

#[test]
fn a_delay_of_some_steps_shifts_commands_by_them() {
    for (delay, substeps) in [(0, 1), (1, 1), (7, 1), (0, 4), (3, 4), (4, 4), (9, 4)] {
        let seconds = f64::from(delay) * STEP;
        let config = ActuationConfig { torque_delay: seconds, thrust_delay: seconds, ..Default::default() };
        let (torques, rates) = acting(&config, substeps, 12);
        // Before the first command arrives it acts, too.
        let expected = |step: u32| f64::from(step.saturating_sub(delay) / substeps);
        for (step, torque) in (0..).zip(&torques) {
            assert_eq!(*torque, expected(step), "{delay} of {substeps} in step {step}");
        }
        for (tick, rate) in (0..).zip(rates) {
            let mean =
                (0..substeps).map(|step| expected(tick * substeps + step)).sum::<f64>() / f64::from(substeps);
            assert_eq!(rate, -mean, "{delay} of {substeps} in tick {tick}");
        }
    }
}

#[test]
fn a_lost_command_is_replaced_by_the_last_one() {
    let config = ActuationConfig { drop: 0.3, seed: 4, ..Default::default() };
    let ticks = 4000;
    let (torques, rates) = acting(&config, 1, ticks);
    let (mut lost, mut before) = (0, 0.0);
    for (tick, (torque, rate)) in (0..).zip(torques.iter().zip(&rates)) {
        assert_eq!(*torque, -rate, "both are lost together");
        let is_lost = *torque != f64::from(tick);
        assert!(!is_lost || *torque == before);
        lost += u32::from(is_lost);
        before = *torque;
    }
    let share = f64::from(lost) / f64::from(ticks);
    assert!((share - 0.3).abs() < 0.03, "{share}: four standard deviations of 4000 draws");
    assert_eq!(acting(&config, 1, 100), acting(&config, 1, 100));
    assert_ne!(acting(&config, 1, 100), acting(&ActuationConfig { seed: 5, ..config.clone() }, 1, 100));
    let nothing_arrives = ActuationConfig { drop: 1.0, ..config };
    assert_eq!(acting(&nothing_arrives, 2, 3).0, [0.0; 6], "the first command acts");
}

#[test]
fn jitter_is_drawn_per_tick_up_to_its_size() {
    let config = ActuationConfig { torque_delay: 0.002, jitter: 0.003, seed: 1, ..Default::default() };
    let (torques, _) = acting(&config, 2, 2000);
    let mut seen = [0; 6];
    for pair in torques.windows(2) {
        assert!(pair[1] >= pair[0], "a command that arrives after a later one does not act");
    }
    for (step, torque) in
        (0u32..).zip(&torques).filter(|(step, torque)| *step > 10 && **torque != torques[*step as usize - 1])
    {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "ticks")]
        let lag = step - 2 * *torque as u32;
        assert!((2..=5).contains(&lag), "{lag}");
        seen[lag as usize] += 1;
    }
    assert!(seen[2..].iter().all(|count| *count > 100), "{seen:?}");
}

/// Torques that are late by a tick of 10 ms: too late for the observer, not for the predictive law, and not for the
/// observer with ticks of 5 ms. Lost commands are not felt.
#[test]
fn late_torques_need_shorter_ticks_or_a_plan() {
    let fly = |name: &str, time_step: f64, actuation: ActuationConfig| {
        let mut config = experiment(name);
        config.simulator.duration = 20.0;
        config.controller.law.time_step = time_step;
        config.simulator.actuation = Some(actuation);
        fly(&config)
    };
    let late = |torque_delay| ActuationConfig { torque_delay, ..Default::default() };
    assert_eq!(fly("test2_observer", 0.01, late(0.01)).outcome, Outcome::Fell);
    for (name, time_step, actuation) in [
        ("test2_mpc", 0.01, late(0.01)),
        ("test2_observer", 0.005, late(0.005)),
        ("test2_observer", 0.01, ActuationConfig { thrust_delay: 0.05, ..Default::default() }),
        ("test2_observer", 0.01, ActuationConfig { drop: 0.1, ..Default::default() }),
    ] {
        let flight = fly(name, time_step, actuation);
        assert_eq!(flight.outcome, Outcome::Completed, "{name}: {:?}", flight.loss);
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, 5.0, because "margin of the flight", "{name}: {rotation} deg");
    }
}

/// With a latency that the controller compensates, all commands may be 30 ms late, and thrust rates 100 ms.
#[test]
fn a_known_latency_is_compensated() {
    let fly = |name: &str, torque: f64, thrust: f64, is_known: bool| {
        let mut config = experiment(name);
        config.simulator.duration = 4.0;
        let late = ActuationConfig { torque_delay: torque, thrust_delay: thrust, ..Default::default() };
        config.simulator.actuation = Some(late);
        if is_known {
            let latency = LatencyConfig { torque, thrust };
            config.controller.law.estimator = Some(EstimatorConfig { latency, ..Default::default() });
        }
        fly(&config)
    };
    for (torque, thrust) in [(0.03, 0.03), (0.0, 0.1)] {
        let [known, unknown] = [true, false].map(|is_known| fly("test2_observer", torque, thrust, is_known));
        assert_eq!(known.outcome, Outcome::Completed);
        let [least, most] = [known, unknown].map(|flight| flight.summary.max_rotation_error);
        assert!(3.0 * least < most, "{torque} s, {thrust} s: {least}, {most} rad");
    }
    for name in ["test2_observer", "test2_mpc"] {
        let flight = fly(name, 0.02, 0.1, true);
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, 3.0, because "margin of the flight", "{name}: {rotation} deg");
    }
}

/// Torques that are later than configured in the controller: with an estimator it uses the latency that it measures.
#[test]
fn a_measured_latency_is_used() {
    let fly = |name: &str, torque_delay: f64, is_used: bool| {
        let mut config = experiment(name);
        config.simulator.duration = 20.0;
        let actuation = config.simulator.actuation.unwrap_or_default();
        config.simulator.actuation = Some(ActuationConfig { torque_delay, ..actuation });
        let law = &mut config.controller.law;
        law.estimator.get_or_insert_default();
        if let Some(monitor) = law.fault_detection.latency.as_mut() {
            monitor.torque_max = if is_used { 0.007 } else { 1.0 };
        }
        fly(&config)
    };
    // The observer's law with exact measurements and with sensors, and the predictive law in the realistic simulation.
    for (name, torque_delay, greatest) in
        [("test2_observer", 0.01, 5.0), ("test2_sensors", 0.01, 8.0), ("robot", 0.024, 20.0)]
    {
        assert_ne!(fly(name, torque_delay, false).outcome, Outcome::Completed, "{name}");
        let flight = fly(name, torque_delay, true);
        assert_eq!(flight.outcome, Outcome::Completed, "{name}: {:?}", flight.loss);
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert_within!(rotation, greatest, because "margin of the flight", "{name}: {rotation} deg");
    }
}

#[test]
fn bad_actuation_is_refused_by_name() {
    type Change = fn(&mut ActuationConfig);
    let refusals: [(&str, Change); 3] = [
        ("torque_delay is 0.0005; expected a multiple of 0.001 s", |c| c.torque_delay = 0.0005),
        ("jitter is 0.0015; expected a multiple of 0.001 s", |c| c.jitter = 0.0015),
        ("drop` is not finite", |c| c.drop = f64::NAN),
    ];
    for (expected, change) in refusals {
        let mut config = ActuationConfig::default();
        change(&mut config);
        let refusal = Actuation::new(&config, STEP, 1, 1, 1, 1).unwrap_err();
        assert_says(&refusal, &[&format!("simulator.actuation.{expected}")]);
    }
    let mut config = experiment("test2");
    config.simulator.actuation = Some(ActuationConfig { torque_delay: 0.003, ..Default::default() });
    assert_says(
        &Scenario::new(&config).unwrap_err(),
        &["simulator.actuation.torque_delay is 0.003", "0.01 s"],
    );
    config.simulator.substeps = 10;
    assert!(Scenario::new(&config).is_ok());
}
