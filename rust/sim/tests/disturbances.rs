//! Errors of the measured wind and of the robot's model, and jets that do not follow their commands.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "the same computation gives the same bits")]

use crate::common::{assert_within, experiment, fly, outage, robot};
use flight_core::robot::RobotModel;
use flight_core::spatial::exp_so3;
use flight_sim::disturbances::{
    Disturbances, FailureKind, JetFailure, JetFaults, JetFaultsConfig, MeasurementNoise, ModelError, Outage,
    OutageChannel, OutageKind, WindEstimateConfig, WindEstimator,
};
use flight_sim::jets::{Jets, JetsConfig, ThrottledConfig};
use flight_sim::noise::Noise;
use flight_sim::{FlightResult, Plant, Scenario, ScenarioConfig, Wind, WindConfig};
use nalgebra::Vector3;

const STEP: f64 = 0.01;
const THRUST: [f64; 4] = [98.0, 98.0, 113.0, 113.0];

fn estimate(config: &WindEstimateConfig, winds: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mean = Vector3::new(1.0, 2.0, 3.0);
    let mut estimator = WindEstimator::new(config, STEP, mean).unwrap();
    winds.iter().map(|wind| estimator.update(wind)).collect()
}

fn step_up(before: usize, after: usize) -> Vec<Vector3<f64>> {
    let up = Vector3::new(0.0, -10.0, 0.0);
    (0..before + after).map(|tick| if tick < before { Vector3::zeros() } else { up }).collect()
}

/// The first words of the generator's published demonstration, seed 42 and stream 54.
#[test]
fn noise_is_that_of_the_published_generator() {
    let mut noise = Noise::new(42, 54);
    for word in [0xa15c_02b7_u32, 0x7b47_f409, 0xba1d_3330, 0x83d2_f293, 0xbfa4_784b, 0xcbed_606e] {
        assert_eq!(noise.uniform(), (f64::from(word) + 0.5) / 4_294_967_296.0);
    }
}

#[test]
fn noise_is_repeatable_and_normal() {
    let draw = |seed, stream| {
        let mut noise = Noise::new(seed, stream);
        (0..20_000).map(|_| noise.normal()).collect::<Vec<f64>>()
    };
    let samples = draw(7, 0);
    assert_eq!(samples, draw(7, 0));
    assert_ne!(samples, draw(8, 0));
    assert_ne!(samples, draw(7, 1));
    let mean = samples.iter().sum::<f64>() / 2e4;
    let variance = samples.iter().map(|x| x * x).sum::<f64>() / 2e4;
    assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "mean {mean}, variance {variance}");
    let neighbours = samples.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 2e4;
    assert_within!(neighbours.abs(), 0.03, because "one seed: the spread of an estimate from that many samples", "neighbours correlate: {neighbours}");
    let beyond_two = samples.iter().filter(|x| x.abs() > 2.0).count() as f64 / 2e4;
    assert_within!((beyond_two - 0.0455).abs(), 0.006, because "one seed: the spread of an estimate from that many samples", "{beyond_two} of 0.0455 beyond two sigma");
}

/// So does a clone, also while the delay line fills.
#[test]
fn a_delayed_estimate_is_the_wind_of_then() {
    let config = WindEstimateConfig { delay: 0.3, ..WindEstimateConfig::default() };
    let winds: Vec<Vector3<f64>> = (0..100).map(|tick| Vector3::new(f64::from(tick), 0.0, 0.0)).collect();
    for cloned_at in [0, 10, 50] {
        let mut estimator = WindEstimator::new(&config, STEP, Vector3::zeros()).unwrap();
        for (tick, wind) in winds.iter().enumerate() {
            if tick == cloned_at {
                estimator = estimator.clone();
            }
            assert_eq!(estimator.update(wind), winds[tick.saturating_sub(30)], "tick {tick}");
        }
    }
}

#[test]
fn a_low_pass_has_gone_63_percent_after_its_time_constant() {
    let config = WindEstimateConfig { time_constant: 0.5, ..WindEstimateConfig::default() };
    let estimates = estimate(&config, &step_up(10, 200));
    assert_within!((estimates[9].y).abs(), 1e-12);
    let reached = estimates[9 + 50].y / -10.0;
    assert_within!((reached - (1.0 - (-1.0_f64).exp())).abs(), 1e-9, "{reached}");
}

#[test]
fn bias_mean_and_noise_are_what_they_say() {
    let winds = step_up(0, 5000);
    let bias = WindEstimateConfig { bias: [1.0, 0.0, -2.0], ..WindEstimateConfig::default() };
    assert_eq!(estimate(&bias, &winds)[3], Vector3::new(1.0, -10.0, -2.0));
    let mean = WindEstimateConfig { mean_only: true, ..WindEstimateConfig::default() };
    assert_eq!(estimate(&mean, &winds)[3], Vector3::new(1.0, 2.0, 3.0));
    let noisy = WindEstimateConfig { noise_std: 2.0, seed: 3, ..WindEstimateConfig::default() };
    let estimates = estimate(&noisy, &winds);
    assert_eq!(estimates, estimate(&noisy, &winds));
    let spread = estimates.iter().map(|wind| (wind.y + 10.0).powi(2)).sum::<f64>() / 5000.0;
    assert_within!((spread.sqrt() - 2.0).abs(), 0.1, "{spread}");
}

/// The mean is that of all ticks of the flight, the first and the last included, and of the wind that the controller is
/// given.
#[test]
fn the_mean_is_that_of_every_tick() {
    let mut config = experiment("test2");
    config.simulator.duration = 0.04;
    let given = vec![[0.0, 1.0, 0.0, 0.0], [0.04, 5.0, 0.0, 0.0]];
    config.disturbances.controller_wind = Some(WindConfig::Samples { samples: given });
    config.disturbances.wind_estimate =
        Some(WindEstimateConfig { mean_only: true, ..WindEstimateConfig::default() });
    let result = &fly(&[config])[0];
    let measured = result.log.series("measured_wind").unwrap();
    for tick in 0..5 {
        assert_within!((measured.row(tick)[0] - 3.0).abs(), 1e-14, because "a sum of five numbers");
    }
}

#[test]
fn only_the_controller_gets_wrong_values() {
    let mut biased = experiment("test2");
    biased.simulator.duration = 12.0;
    biased.disturbances.wind_estimate =
        Some(WindEstimateConfig { bias: [0.0, 10.0, 0.0], ..WindEstimateConfig::default() });
    let result = &fly(&[biased])[0];
    // The bias cancels the wind: what is estimated is the robot's own motion.
    assert_eq!(result.log.series("wind").unwrap().row(1100)[1], -10.0);
    let total = |name: &str| -> f64 {
        result.log.series(name).unwrap().row(1100).chunks_exact(3).map(|force| force[1]).sum()
    };
    assert!(total("aero_force_sim") < -5.0, "{}", total("aero_force_sim"));
    assert_within!(total("aero_force_control").abs(), 1.0, "{}", total("aero_force_control"));
}

#[test]
fn a_controller_can_have_the_model_of_another_robot() {
    let mut heavy = experiment("no_wind");
    heavy.simulator.duration = 8.0;
    let mut sound = heavy.clone();
    sound.disturbances.model_error = ModelError::default();
    heavy.disturbances.model_error.mass_scale = 1.03;
    let results = fly(&[sound, heavy]);
    // Thrust for weight that is not there: the robot hovers too high, held by the position task alone.
    let height = |flight: usize| results[flight].log.series("com_position").unwrap().row(800)[2];
    assert!(height(1) > height(0) + 0.05, "{} against {}", height(1), height(0));
}

fn jets(config: &JetsConfig, faults: &JetFaultsConfig) -> Jets {
    let robot = robot("ironcub_mk1");
    Jets::new(config, &robot.jets, &robot.engines, &THRUST).unwrap().with_faults(faults, &robot.jets).unwrap()
}

fn failure(kind: FailureKind, decay: f64) -> JetFaultsConfig {
    let failure = JetFailure { jet: "r_arm_jet".to_owned(), time: 0.5, kind, decay };
    JetFaultsConfig { failure: Some(failure), ..JetFaultsConfig::default() }
}

/// Thrusts every step, under the same command all the time.
fn run(mut jets: Jets, rate: f64, steps: usize) -> Vec<Vec<f64>> {
    let mut record = vec![jets.thrust().to_vec()];
    for _ in 0..steps {
        jets.advance(&[rate; 4], STEP);
        record.push(jets.thrust().to_vec());
    }
    record
}

#[test]
fn an_engine_that_is_off_gives_nothing_and_the_others_go_on() {
    for config in [JetsConfig::Ideal {}, JetsConfig::Throttled(ThrottledConfig::default())] {
        let sound = run(jets(&config, &JetFaultsConfig::default()), 10.0, 100);
        let record = run(jets(&config, &failure(FailureKind::Off, 0.0)), 10.0, 100);
        assert_eq!(record[50], sound[50], "nothing before its time");
        assert_eq!(record[51][1], 0.0);
        assert_eq!(record[100][1], 0.0);
        assert_eq!(record[100][0], sound[100][0]);
        assert_eq!(record[100][2..], sound[100][2..]);
    }
}

#[test]
fn a_stuck_engine_keeps_its_thrust_and_a_dying_one_loses_it_slowly() {
    let stuck = run(jets(&JetsConfig::Ideal {}, &failure(FailureKind::Stuck, 0.0)), 10.0, 100);
    assert_within!((stuck[100][1] - stuck[51][1]).abs(), 1e-12);
    assert_within!((stuck[51][1] - 103.1).abs(), 1e-9, "{}", stuck[51][1]);
    let dying = run(jets(&JetsConfig::Ideal {}, &failure(FailureKind::Off, 0.2)), 10.0, 100);
    let expected = dying[71][1] / dying[51][1];
    assert_within!((expected - (-1.0_f64).exp()).abs(), 1e-9, "{expected}");
}

/// The rate of a thrust that is none of the command is that of the thrust itself.
#[test]
fn a_fault_changes_the_rate_with_the_thrust() {
    let robot = robot("ironcub_mk1");
    let after = |faults: &JetFaultsConfig| {
        let mut faults = JetFaults::new(faults, &robot.jets).unwrap();
        let mut last = (0.0, 0.0);
        for _ in 0..70 {
            last = faults.limit_thrust(1, 100.0, 30.0, STEP);
        }
        last
    };
    assert_eq!(after(&JetFaultsConfig::default()), (100.0, 30.0));
    assert_eq!(after(&failure(FailureKind::Stuck, 0.0)), (100.0, 0.0));
    assert_eq!(after(&failure(FailureKind::Off, 0.0)), (0.0, 0.0));
    let (thrust, rate) = after(&failure(FailureKind::Off, 0.2));
    assert_within!((thrust - 100.0 * (-1.0_f64).exp()).abs(), 1e-12, because "70 steps of 10 ms, 0.2 s after the failure");
    assert_eq!(rate, -thrust / 0.2);
    let weak = JetFaultsConfig { thrust_limit_scale: Some(0.5), ..JetFaultsConfig::default() };
    let mut weak = JetFaults::new(&weak, &robot.jets).unwrap();
    let limit = 0.5 * robot.jets[1].thrust_max;
    assert_eq!(weak.limit_thrust(1, limit + 1.0, 30.0, STEP), (limit, 0.0));
    assert_eq!(weak.limit_thrust(1, limit + 1.0, -30.0, STEP), (limit, -30.0));
    assert_eq!(weak.limit_thrust(1, limit, 30.0, STEP), (limit, 30.0));
}

#[test]
fn limits_hold_and_what_lies_beyond_is_not_remembered() {
    let faults = JetFaultsConfig { thrust_limit_scale: Some(0.7), ..JetFaultsConfig::default() };
    let mut jets = jets(&JetsConfig::Ideal {}, &faults);
    for _ in 0..300 {
        jets.advance(&[100.0; 4], STEP);
    }
    assert_eq!(jets.thrust(), [112.0, 112.0, 154.0, 154.0]);
    jets.advance(&[-100.0; 4], STEP);
    assert_within!((jets.thrust()[0] - 111.0).abs(), 1e-12, "no wind-up");
    for _ in 0..300 {
        jets.advance(&[-100.0; 4], STEP);
    }
    assert_eq!(jets.thrust(), [0.0; 4]);
}

/// A jet that exerts less than its thrust accelerates the robot less, by exactly that force at that jet.
#[test]
fn a_jet_exerts_another_force_than_its_thrust() {
    let velocity = |scale: Option<(&str, f64)>, thrust: [f64; 4]| {
        let mut config = experiment("no_wind");
        config.simulator.initial.free_fall_tick = false;
        config.simulator.initial.thrust = thrust.to_vec();
        config.disturbances.jets.force_scale =
            scale.into_iter().map(|(jet, scale)| (jet.to_owned(), scale)).collect();
        let mut plant =
            Plant::new(robot("ironcub_mk1"), &config.simulator, &config.disturbances, &config.controller.law)
                .unwrap();
        plant.observe(&Vector3::zeros());
        plant.advance(&[0.0; 23], &[0.0; 4], &Vector3::zeros(), STEP);
        assert_eq!(plant.jets().thrust(), thrust, "what is measured stays");
        plant.state().velocity.clone()
    };
    let [a, b, c, d] = THRUST;
    let weak = velocity(Some(("r_arm_jet", 0.9)), THRUST);
    assert_within!((weak.clone() - velocity(None, [a, 0.9 * b, c, d])).amax(), 1e-12);
    assert!((weak - velocity(None, THRUST)).amax() > 1e-3);
    let refusal = |jet: &str, scale: f64| {
        let faults = JetFaultsConfig { force_scale: [(jet.to_owned(), scale)].into(), ..Default::default() };
        faults.check(&robot("ironcub_mk1").jets).unwrap_err().to_string()
    };
    assert!(refusal("arm", 0.9).contains("disturbances.jets.force_scale"));
    assert!(refusal("r_arm_jet", -0.1).contains("disturbances.jets.force_scale.r_arm_jet` is -0.1"));
}

#[test]
fn a_lag_delays_the_thrust_by_its_time_constant() {
    let lagged = JetFaultsConfig { lag: 0.2, ..JetFaultsConfig::default() };
    let late = run(jets(&JetsConfig::Ideal {}, &lagged), 10.0, 300);
    let sound = run(jets(&JetsConfig::Ideal {}, &JetFaultsConfig::default()), 10.0, 300);
    let behind = sound[300][0] - late[300][0];
    // ∫ of the first-order response: late by τ, and half a step as each step acts at its beginning.
    assert_within!((behind - 10.0 * (0.2 - 0.5 * STEP)).abs(), 0.02, "{behind}");
}

#[test]
fn measurement_noise_enters_the_estimate_alone() {
    let noisy = |seed| JetFaultsConfig {
        measurement_noise: Some(MeasurementNoise { std: 2.0, seed }),
        ..JetFaultsConfig::default()
    };
    let estimated = JetsConfig::Throttled(ThrottledConfig {
        feedback: flight_sim::jets::ThrustFeedback::Estimated,
        ..ThrottledConfig::default()
    });
    let feedback = |seed| {
        let mut jets = jets(&estimated, &noisy(seed));
        for _ in 0..100 {
            jets.advance(&[0.0; 4], STEP);
        }
        jets.thrust_feedback().to_vec()
    };
    assert_eq!(feedback(1), feedback(1));
    assert_ne!(feedback(1), feedback(2));

    let robot = robot("ironcub_mk1");
    let ideal = Jets::new(&JetsConfig::Ideal {}, &robot.jets, &robot.engines, &THRUST).unwrap();
    let message = ideal.with_faults(&noisy(1), &robot.jets).unwrap_err().to_string();
    assert!(message.contains("measurement_noise") && message.contains("ideal"), "{message}");
}

#[test]
fn turbulence_has_its_standard_deviation_and_rises_with_the_ramp() {
    let wind = |seed| {
        Wind::new(&WindConfig::Turbulent {
            velocity: [0.0, -10.0, 0.0],
            ramp_start: 5.0,
            ramp_end: 10.0,
            std: [1.0, 2.0, 0.5],
            time_scale: 2.0,
            seed,
        })
        .unwrap()
    };
    assert_eq!(wind(1).velocity(4.0), Vector3::zeros());
    assert_eq!(wind(1).velocity(20.0), wind(1).velocity(20.0));
    assert_ne!(wind(1).velocity(20.0), wind(2).velocity(20.0));
    let (mut mean, mut square) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
    for seed in 0..200 {
        let wind = wind(seed);
        for sample in 0..50 {
            let gust = wind.velocity(10.0 + 3.7 * f64::from(sample)) - Vector3::new(0.0, -10.0, 0.0);
            mean += gust / 1e4;
            square += gust.component_mul(&gust) / 1e4;
        }
    }
    for (axis, std) in [1.0, 2.0, 0.5].into_iter().enumerate() {
        assert_within!(mean[axis].abs(), 0.06 * std, because "one seed: the spread of an estimate from that many samples", "axis {axis}: mean {}", mean[axis]);
        assert_within!((square[axis].sqrt() / std - 1.0).abs(), 0.05, because "one seed: the spread of an estimate from that many samples", "axis {axis}: {}", square[axis].sqrt());
    }
}

/// Masses and inertias of every body have their factors, the base's centre of mass alone the offset, every jet its turn.
#[test]
fn a_model_error_scales_masses_and_inertias() {
    let right = robot("ironcub_mk1");
    let offset = Vector3::new(0.01, -0.02, 0.03);
    let turns = vec![[0.0, 0.02, 0.0]; right.jets.len()];
    let mut error = ModelError {
        mass_scale: 1.25,
        inertia_scale: 0.9,
        com_offset: offset.into(),
        thrust_axes: turns,
        of_plant: None,
    };
    let wrong = error.apply(right.clone());
    for (right, wrong) in right.jets.iter().zip(&wrong.jets) {
        let expected = exp_so3(&Vector3::new(0.0, 0.02, 0.0)) * right.axis_f.into_inner();
        assert_within!((wrong.axis_f.into_inner() - expected).norm(), 1e-15, because "rounding");
    }
    for (index, (right, wrong)) in right.bodies.iter().zip(&wrong.bodies).enumerate() {
        assert_eq!(wrong.mass, 1.25 * right.mass);
        assert_eq!(wrong.inertia_b, 1.25 * 0.9 * right.inertia_b);
        assert_eq!(wrong.com_b, if index == 0 { right.com_b + offset } else { right.com_b });
    }
    for of_plant in [false, true] {
        error.of_plant = Some(of_plant);
        let disturbances = Disturbances { model_error: error.clone(), ..Disturbances::default() };
        let simulated = disturbances.simulated_robot(right.clone()).unwrap();
        let controlled = disturbances.controller_robot(right.clone()).unwrap();
        let is_wrong = |robot: &RobotModel| robot.bodies[0].mass == wrong.bodies[0].mass;
        assert_eq!((is_wrong(&simulated), is_wrong(&controlled)), (of_plant, !of_plant));
    }
}

fn fly_one(change: impl Fn(&mut ScenarioConfig)) -> FlightResult {
    let mut config = experiment("test2");
    config.simulator.duration = 20.0;
    change(&mut config);
    fly(&[config]).remove(0)
}

#[test]
fn known_limits_reach_the_controller() {
    let limited = |known| {
        fly_one(move |config| {
            config.disturbances.jets.thrust_limit_scale = Some(0.55);
            config.disturbances.jets.limit_is_known = known;
        })
    };
    let (secret, known) = (limited(false), limited(true));
    assert_within!(secret.summary.thrust_max, 0.55 * 220.0 + 1e-9, because "an inequality: the left side may come as near as it likes");
    assert_ne!(secret.log, known.log);
}

#[test]
fn what_makes_no_sense_is_refused_by_name() {
    let message = |change: &dyn Fn(&mut ScenarioConfig)| {
        let mut config = experiment("test2");
        change(&mut config);
        Scenario::new(&config).unwrap_err().to_string()
    };
    let below = message(&|config| {
        *config = experiment("mk3_hover");
        config.disturbances.jets.thrust_limit_scale = Some(0.04);
    });
    assert!(below.contains("leaves jet `l_arm_jet` more than 11 N"), "{below}");
    let jet = message(&|config| {
        config.disturbances.jets = failure(FailureKind::Off, 0.0);
        config.disturbances.jets.failure.as_mut().unwrap().jet = "tail".to_owned();
    });
    assert!(jet.contains("failure.jet") && jet.contains("`tail`") && jet.contains("r_arm_jet"), "{jet}");
    let decay = message(&|config| config.disturbances.jets = failure(FailureKind::Stuck, 0.5));
    assert!(
        decay.contains("disturbances.jets.failure.decay is 0.5; expected 0: a jet that is stuck"),
        "{decay}"
    );
    let known = message(&|config| config.disturbances.jets.limit_is_known = true);
    assert!(known.contains("disturbances.jets.limit_is_known is true; expected false without"), "{known}");
    for kind in [OutageKind::Missing, OutageKind::Nan, OutageKind::Frozen] {
        let error = message(&|config| {
            let lost = outage(OutageChannel::Wind, kind, 1.0, None);
            config.disturbances.outages = vec![Outage { error: 0.5, ..lost }];
        });
        assert!(
            error.contains("disturbances.outages[0].error is 0.5; expected none, but for the kind wrong"),
            "{error}"
        );
    }
}
