//! Claims about the simulated jets: how they follow commands, what the controller is given, and what is refused.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::engines::{engines, model};
use crate::common::{assert_says, assert_within, experiment, relative, robot};
use flight_core::jets::{Shaft, ShaftConfig};
use flight_core::robot::{Frame, Jet};
use flight_core::spatial::Pose;
use flight_sim::disturbances::{JetFaultsConfig, Outage, OutageChannel, OutageKind};
use flight_sim::jets::{Jets, JetsConfig, ThrottledConfig, ThrustFeedback};
use flight_sim::measuring::Measuring;
use flight_sim::turbine::TurbineConfig;
use flight_sim::{Scenario, Wind};
use nalgebra::Vector3;

const DT: f64 = 0.01;

fn jets() -> Vec<Jet> {
    [
        ("l_arm", 160.0, "P160"),
        ("r_arm", 160.0, "P160"),
        ("chest_l", 220.0, "P220"),
        ("chest_r", 220.0, "P220"),
    ]
    .map(|(name, thrust_max, engine)| Jet {
        name: name.to_owned(),
        frame: Frame { name: name.to_owned(), body: 0, body_from_frame: Pose::identity() },
        axis_f: -Vector3::z_axis(),
        torque_to_thrust: 0.0,
        thrust_min: 0.0,
        thrust_max,
        engine: model(engine).into(),
        engine_name: engine.to_owned(),
    })
    .to_vec()
}

const HOVER: [f64; 4] = [98.0, 98.0, 113.0, 113.0];

fn second_order(change: impl FnOnce(&mut ThrottledConfig)) -> JetsConfig {
    let mut config = ThrottledConfig::default();
    change(&mut config);
    JetsConfig::Throttled(config)
}

fn build(config: &JetsConfig) -> Jets {
    Jets::new(config, &jets(), &engines(), &HOVER).unwrap()
}

/// From hover, up at 10 N/s for 2 s, down at 10 N/s for 2 s, with the published gains and tick. A
/// reversal saturates the throttle for a tenth of a second, and what thrust is missed meanwhile stays
/// missed: the loop feeds back the rate alone.
#[test]
fn second_order_jets_track_a_thrust_ramp() {
    let mut jets = build(&second_order(|_| {}));
    let mut expected = HOVER;
    for tick in 0..400 {
        let rate = if tick < 200 { 10.0 } else { -10.0 };
        jets.advance(&[rate; 4], DT);
        for (i, expected) in expected.iter_mut().enumerate() {
            *expected += rate * DT;
            assert_within!(
                (jets.thrust()[i] - *expected).abs(),
                1.5, because "what a tracking law still misses after that time",
                "jet {i}, tick {tick}: {}",
                jets.thrust()[i]
            );
            if !(0..30).contains(&(tick % 200)) {
                assert_within!((jets.thrust_rate()[i] - rate).abs(), 0.2, because "what a tracking law still misses after that time", "jet {i}, tick {tick}");
            }
            assert!((0.0..=120.0).contains(&jets.throttle()[i]));
        }
    }
}

#[test]
fn second_order_jets_hold_their_thrust_at_zero_command() {
    let mut jets = build(&second_order(|_| {}));
    let throttle = jets.throttle();
    for _ in 0..500 {
        jets.advance(&[0.0; 4], DT);
    }
    for i in 0..4 {
        assert_within!((jets.thrust()[i] - HOVER[i]).abs(), 1e-6);
        assert_within!((jets.throttle()[i] - throttle[i]).abs(), 1e-6);
    }
}

/// A map of `(T_s(u) − T) / τ`, which linear interpolation has exactly: every rate between those of the least and the
/// greatest throttle is followed, others as far as these go, and beyond the map its edge counts.
#[test]
fn a_turbine_follows_the_rates_of_its_map() {
    const TIME: f64 = 0.3;
    let steady = |throttle: f64| 20.0 + 2.0 * throttle;
    let (thrust, throttle) = (vec![10.0, 50.0, 100.0, 200.0], vec![0.0, 30.0, 100.0]);
    let rate = |u: &f64| thrust.iter().map(|t| (steady(*u) - t) / TIME).collect();
    let map = TurbineConfig { rate: throttle.iter().map(rate).collect(), thrust: thrust.clone(), throttle };
    let close = |found: (f64, f64), expected: (f64, f64)| {
        assert_within!((found.0 - expected.0).abs() / 100.0, 1e-13, because "rounding", "{found:?}");
        assert_within!((found.1 - expected.1).abs() / 1000.0, 1e-13, because "rounding", "{found:?}");
    };
    for (thrust, command) in [(10.0, 40.0), (72.0, -100.0), (137.0, 20.0), (200.0, 0.0)] {
        close(map.nearest(thrust, command), ((TIME * command + thrust - 20.0) / 2.0, command));
    }
    close(map.nearest(72.0, 1e4), (100.0, (steady(100.0) - 72.0) / TIME));
    close(map.nearest(72.0, -1e4), (0.0, (steady(0.0) - 72.0) / TIME));
    close(map.nearest(250.0, 0.0), map.nearest(200.0, 0.0));
    // The jets of a flight: explicit Euler at the rate of the map.
    let mut jets = Jets::new(&JetsConfig::Measured(map.clone()), &jets(), &engines(), &[60.0; 4]).unwrap();
    jets.advance(&[50.0, 1e4, -1e4, 0.0], DT);
    let rates = [50.0, (steady(100.0) - 60.0) / TIME, (steady(0.0) - 60.0) / TIME, 0.0];
    for (jet, rate) in rates.into_iter().enumerate() {
        assert_within!((jets.thrust()[jet] - (60.0 + DT * rate)).abs() / 60.0, 1e-13, because "rounding");
        assert_within!((jets.thrust_rate()[jet] - rate).abs() / 1000.0, 1e-13, because "rounding");
    }
    close((jets.throttle()[3], 0.0), (20.0, 0.0));
    for (spoilt, expected) in [
        (
            TurbineConfig { thrust: vec![1.0], ..map.clone() },
            "simulator.jets.thrust is [1.0]; expected two ascending",
        ),
        (TurbineConfig { throttle: vec![1.0, 1.0], ..map.clone() }, "simulator.jets.throttle is [1.0, 1.0]"),
        (
            TurbineConfig { rate: vec![vec![0.0; 3]; 3], ..map },
            "simulator.jets.rate is 3 rows; expected 3 rows",
        ),
    ] {
        let refusal = spoilt.check().unwrap_err();
        assert!(refusal.to_string().contains(expected), "{refusal}");
    }
}

/// A jet that runs has its least thrust, at which its thrust rate is not negative.
#[test]
fn thrust_is_never_below_its_least() {
    let running = || jets().into_iter().map(|jet| Jet { thrust_min: 40.0, ..jet }).collect::<Vec<_>>();
    for config in [JetsConfig::Ideal {}, JetsConfig::Throttled(ThrottledConfig::default())] {
        let mut jets = Jets::new(&config, &running(), &engines(), &[60.0; 4]).unwrap();
        let mut least = f64::INFINITY;
        for _ in 0..100 {
            jets.advance(&[-90.0; 4], DT);
            least = jets.thrust().iter().copied().fold(least, f64::min);
            let mut at_least =
                jets.thrust().iter().zip(jets.thrust_rate()).filter(|(thrust, _)| **thrust == 40.0);
            assert!(at_least.all(|(_, rate)| *rate >= 0.0), "{config:?}");
        }
        assert_eq!(least, 40.0, "{config:?}");
    }
    // A failed engine gives less.
    let failed: JetFaultsConfig =
        toml::from_str("failure = { jet = 'chest_l', kind = 'off', time = 0.1, decay = 0.1 }").unwrap();
    let jets = Jets::new(&JetsConfig::Ideal {}, &running(), &engines(), &[60.0; 4]).unwrap();
    let mut jets = jets.with_faults(&failed, &running()).unwrap();
    for _ in 0..200 {
        jets.advance(&[0.0; 4], DT);
    }
    assert_eq!(jets.thrust()[0], 60.0);
    assert_within!(relative(jets.thrust()[2], 60.0 * (-19.0_f64).exp()), 1e-12);
}

/// A jet without thrust does not pull, and its thrust rate is not negative; a NaN stays one.
#[test]
fn thrust_is_never_negative() {
    for config in [JetsConfig::Ideal {}, JetsConfig::Throttled(ThrottledConfig::default())] {
        let mut jets = Jets::new(&config, &jets(), &engines(), &[0.5; 4]).unwrap();
        for _ in 0..100 {
            jets.advance(&[-90.0; 4], DT);
            assert!(jets.thrust().iter().all(|thrust| *thrust >= 0.0), "{:?}", jets.thrust());
        }
    }
    let mut jets = Jets::new(&JetsConfig::Ideal {}, &jets(), &engines(), &[0.5, 0.5, 2.0, 0.0]).unwrap();
    jets.advance(&[-100.0, f64::NAN, -100.0, 50.0], DT);
    assert_eq!(jets.thrust()[0], 0.0);
    assert!(jets.thrust()[1].is_nan());
    assert_eq!(jets.thrust()[2..], [1.0, 0.5]);
    assert_eq!((jets.thrust_rate()[0], jets.thrust_rate()[2]), (0.0, -100.0));
}

#[test]
fn ideal_thrust_is_the_integral_of_the_command() {
    let mut jets = build(&toml::from_str("dynamics = 'ideal'").unwrap());
    for _ in 0..100 {
        jets.advance(&[1.0, -50.0, 0.0, 50.0], DT);
    }
    for (thrust, expected) in jets.thrust().iter().zip([99.0, 48.0, 113.0, 163.0]) {
        assert_within!(relative(*thrust, expected), 1e-12);
    }
    assert_eq!(jets.thrust_feedback(), jets.thrust());
    assert_eq!(jets.thrust_rate(), [1.0, -50.0, 0.0, 50.0]);
    assert!(jets.throttle().is_empty());
}

#[test]
fn feedback_is_what_was_asked_for() {
    for (feedback, is_true) in [(ThrustFeedback::Measured, true), (ThrustFeedback::Estimated, false)] {
        let mut jets = build(&second_order(|c| c.feedback = feedback));
        assert_eq!(jets.thrust_feedback(), HOVER);
        jets.advance(&[5.0; 4], DT);
        assert_eq!(jets.thrust_feedback() == jets.thrust(), is_true);
    }
}

#[test]
fn a_jet_without_a_command_stays() {
    for config in [JetsConfig::Ideal {}, second_order(|_| {})] {
        let mut jets = build(&config);
        jets.advance(&[10.0, 10.0], DT);
        assert_eq!(jets.thrust()[2..], HOVER[2..]);
        jets.advance(&[10.0; 9], DT);
    }
}

#[test]
fn engines_can_be_chosen_per_jet() {
    let names = |n: [&str; 4]| Some(n.map(str::to_owned).to_vec());
    let own = build(&second_order(|_| {}));
    let same = build(&second_order(|c| c.engines = names(["P160", "P160", "P220", "P220"])));
    let other = build(&second_order(|c| c.engines = names(["P100", "P160", "P220", "P220"])));
    assert_eq!(own.throttle(), same.throttle());
    assert_ne!(own.throttle()[0], other.throttle()[0]);
    assert_eq!(own.throttle()[1..], other.throttle()[1..]);
}

fn assert_refused(config: &JetsConfig, parts: &[&str]) {
    let message = Jets::new(config, &jets(), &engines(), &HOVER).unwrap_err().to_string();
    assert_says(&message, parts);
}

#[test]
fn every_jet_needs_a_finite_initial_thrust() {
    for config in [JetsConfig::Ideal {}, second_order(|_| {})] {
        let error = |thrust: &[f64]| Jets::new(&config, &jets(), &engines(), thrust).unwrap_err().to_string();
        assert_says(&error(&[1.0; 3]), &["initial_thrust", "3 entries", "4 entries", "chest_l"]);
        assert_says(&error(&[1.0, f64::NAN, 1.0, 1.0]), &["`r_arm`", "NaN"]);
    }
}

#[test]
fn engines_must_exist_and_be_as_many_as_jets() {
    let with = |names: &[&str]| {
        second_order(|c| c.engines = Some(names.iter().map(|name| (*name).to_owned()).collect()))
    };
    assert_refused(&with(&["P160", "P160", "P550", "P220"]), &["`chest_l`", "`P550`", "P100, P160"]);
    assert_refused(&with(&["P160"]), &["engines", "1 entries", "4 entries"]);
}

/// Thrusts that freeze between two ticks keep those of the tick before, whether they are measured as such or by speeds.
#[test]
fn a_frozen_thrust_is_the_one_before() {
    let mut config = experiment("test2");
    config.disturbances.outages = vec![Outage {
        jet: None,
        channel: OutageChannel::Thrust,
        kind: OutageKind::Frozen,
        start: 0.015,
        duration: None,
        error: 1.0,
    }];
    let (robot, wind) = (robot("ironcub_mk1"), Wind::new(&config.wind).unwrap());
    let state = config.simulator.initial.state();
    let shaft = Shaft::new("simulator.jets.shaft", shaft_config(), 200.0).unwrap();
    for shafts in [Vec::new(), vec![shaft; 4]] {
        let mut measuring = Measuring::new(&config, &robot, shafts, &wind, 0).unwrap();
        let mut seen = Vec::new();
        for (tick, thrust) in [[100.0; 4], [110.0; 4], [120.0; 4]].iter().enumerate() {
            let time = 0.01 * tick as f64;
            measuring.measure(time, (&state, thrust), [], &Vector3::zeros());
            let sample = measuring.sample();
            seen.push(if sample.thrust[0].is_nan() {
                shaft.thrust(sample.shaft_speed[0])
            } else {
                sample.thrust[0]
            });
            let _ = measuring.measure_joints(time, 0.005, &state);
        }
        for (seen, thrust) in seen.iter().zip([100.0, 110.0, 110.0]) {
            assert_within!(relative(*seen, thrust), 1e-12, "{seen} for {thrust}");
        }
    }
}

fn shaft_config() -> ShaftConfig {
    toml::from_str(
        "idle = 0.3\nramps = [0.1, 0.1]\nlags = [1.2, 1.6]\naccelerations = [0.1, 0.4]\nexponent = 2.0\nsquare_share = 0.1",
    )
    .unwrap()
}

/// A controller is given the speed in place of the thrust, and has the thrust from it; engines without a shaft have none.
#[test]
fn feedback_may_be_the_speed_of_the_shaft() {
    let mut config = experiment("robot");
    let shaft = shaft_config();
    let speeds = |shaft| second_order(|c| (c.feedback, c.shaft) = (ThrustFeedback::Speed, shaft));
    config.simulator.sensors = None;
    config.simulator.jets = speeds(None);
    assert_says(
        &Scenario::new(&config).unwrap_err(),
        &["simulator.jets.feedback", "without simulator.jets.shaft"],
    );
    config.simulator.jets = speeds(Some(shaft));
    config.controller.law.shaft = Some(shaft);
    let mut flight = Scenario::new(&config).unwrap().begin();
    let seen = flight.measurement();
    assert!(seen.thrust.iter().all(|thrust| thrust.is_nan()));
    assert!(seen.shaft_speed.iter().all(|speed| (0.5..0.9).contains(speed)));
    let state = flight.try_tick().unwrap();
    for (used, thrust) in state.estimate().robot.thrust.iter().zip(HOVER) {
        assert_within!(relative(*used, thrust), 1e-12);
    }
}
