//! A tick works in preallocated space: after the first one neither controller nor plant allocates.
//!
//! A test binary of its own, because it replaces the allocator by one that counts.

#![allow(unsafe_code, reason = "a global allocator cannot be written without")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[path = "common/cases.rs"]
mod cases;
mod common;
#[path = "common/episode.rs"]
mod episode;

use cases::cases;
use common::counting::{Counting, allocations};
use common::network::{SMALL, random_network};
use common::{Loop, Running, at, experiment, outage, tick_at};
use episode::Episodes;
use flight_core::Measurement;
use flight_core::aero::Precision;
use flight_core::control::Modes;
use flight_io::{AeroConfig, load_robot};
use flight_sim::config::AeroKinematics;
use flight_sim::disturbances::{FailureKind, JetFailure, OutageChannel, OutageKind};
use flight_sim::fuel::FuelConfig;
use flight_sim::motors::{ElasticityConfig, MotorsConfig};
use flight_sim::{Scenario, ScenarioConfig};
use nalgebra::{DVector, Vector3};
use proptest::prelude::*;
use std::hint::black_box;
use std::path::Path;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The counter counts: otherwise every test below would pass.
#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(black_box(Box::new(1)))), 1);
    assert_eq!(allocations(|| drop(black_box(vec![0_u8; 100]))), 1);
    let mut growing = Vec::with_capacity(1);
    assert_eq!(allocations(|| black_box(&mut growing).extend([1, 2, 3])), 1);
    assert_eq!(allocations(|| ()), 0);
}

/// Flies and counts; returns the greatest number of active bounds and whether every tick was nominal.
#[track_caller]
fn assert_no_allocations(
    what: &str,
    config: &ScenarioConfig,
    seconds: f64,
    wind: Vector3<f64>,
) -> (u32, bool) {
    let mut flight = Loop::new(config);
    let (mut in_ticks, mut in_plant, mut active, mut nominal) = (0, 0, 0, true);
    for tick in 0..tick_at(seconds) {
        // The flight begins in still air, also where the wind is no number.
        let blow = if tick == 0 { Vector3::zeros() } else { wind * (tick as f64 * 0.01).min(1.0) };
        in_plant += allocations(|| flight.plant.observe(&blow));
        let thrust = flight.plant.jets().thrust_feedback();
        let measurement = Measurement { wind: blow, ..at(tick as f64 * 0.01, flight.plant.state(), thrust) };
        let of_this_tick = allocations(|| {
            flight.controller.tick(&measurement);
        });
        if tick > 0 {
            in_ticks += of_this_tick;
        }
        let command = flight.controller.command();
        active = active.max(command.rates_qp.active).max(command.torque_qp.active);
        nominal &= command.modes.is_empty();
        let (torque, rate) = (command.joint_torque.as_slice(), command.thrust_rate.as_slice());
        in_plant += allocations(|| flight.plant.advance(torque, rate, &blow, 0.01));
    }
    assert_eq!((in_ticks, in_plant), (0, 0), "{what}: allocations in ticks and in the plant");
    (active, nominal)
}

const SIDE: Vector3<f64> = Vector3::new(0.0, -10.0, 0.0);

#[test]
fn drives_and_fuel_do_not_allocate() {
    let mut config = experiment("test2_observer");
    config.simulator.motors = Some(MotorsConfig {
        friction: 0.5,
        friction_of: [].into(),
        damping: 0.5,
        load_friction: [].into(),
        inertia: 0.05,
        time_constant: 0.005,
        elasticity: Some(ElasticityConfig { stiffness: 500.0, damping: 0.5 }),
    });
    let fuel =
        FuelConfig { mass: 1.2, body: "chest".into(), position: [0.0; 3], idle: 1e-3, by_thrust: 4e-5 };
    config.simulator.fuel = Some(fuel);
    assert_no_allocations("drives and fuel", &config, 2.0, SIDE);
}

fn with(name: &str, change: impl FnOnce(&mut ScenarioConfig)) -> ScenarioConfig {
    let mut config = experiment(name);
    change(&mut config);
    config
}

fn sphere_cylinder() -> AeroConfig {
    let file = common::configs("aero/sphere_cylinder.toml");
    flight_io::load(&file).unwrap()
}

/// A network with every feature; its files are in `folder`.
fn small_network(folder: &Path) -> AeroConfig {
    random_network(folder, &common::robot("ironcub_mk1"), &SMALL, "small", Precision::F32)
}

/// Plans, also after the loss of an engine, work in preallocated space.
#[test]
fn the_predictive_law_does_not_allocate() {
    let mut config = experiment("test2_mpc");
    assert_no_allocations("plans", &config, 1.0, SIDE);
    config.disturbances.jets.failure =
        Some(JetFailure { jet: "l_arm_jet".into(), time: 0.5, kind: FailureKind::Off, decay: 0.0 });
    assert_no_allocations("plans of a descent", &config, 1.0, SIDE);
}

/// Every model and quirk, sub-steps, engines with throttles.
#[test]
#[allow(clippy::large_stack_arrays, reason = "a handful of configurations, once")]
fn no_model_allocates() {
    let folder = tempfile::tempdir().unwrap();
    for (what, config) in [
        ("published", experiment("test2_published")),
        ("baseline", experiment("test1")),
        ("observer", experiment("test2_observer")),
        ("policy", experiment("test1_policy")),
        (
            "sphere/cylinder",
            with("test2", |config| {
                config.controller.aero = sphere_cylinder();
                config.simulator.aero = sphere_cylinder();
            }),
        ),
        ("frozen", with("test2", |config| config.simulator.kinematics = AeroKinematics::Frozen)),
        (
            "network",
            with("test2", |config| {
                config.controller.aero = small_network(folder.path());
                config.simulator.aero = small_network(folder.path());
            }),
        ),
        ("sub-steps", with("test2", |config| config.simulator.substeps = 4)),
        ("engines with throttles", experiment("second_order_jets")),
    ] {
        let (_, nominal) = assert_no_allocations(what, &config, 3.0, SIDE);
        assert!(nominal, "{what}");
    }
}

/// Holding allocates no more than flying does: a tick without answers, after every method was tried, or one that measures a
/// number that is not finite.
#[test]
fn a_tick_that_holds_does_not_allocate() {
    let unanswerable = with("test2", |config| {
        config.controller.law.weights.momentum = 1e305;
        config.controller.law.torque.weight_acceleration = 1e306;
    });
    let (_, nominal) = assert_no_allocations("no answers", &unanswerable, 0.1, SIDE);
    assert!(!nominal);
    let config = experiment("test2");
    let bad = Vector3::new(0.0, f64::NAN, 0.0);
    let (_, nominal) = assert_no_allocations("bad measurements", &config, 0.1, bad);
    assert!(!nominal);
}

/// A whole tick of a flight: sensors, estimator, wind observer, channels that are predicted, an engine
/// that is lost, and the log.
#[test]
fn a_tick_of_a_flight_does_not_allocate() {
    let lost = |channel| outage(channel, OutageKind::Missing, 0.02, Some(0.1));
    let channels =
        [OutageChannel::Wind, OutageChannel::Thrust, OutageChannel::Joints, OutageChannel::BasePosition];
    let channels = channels.into_iter().chain([OutageChannel::BaseRotation, OutageChannel::BaseVelocity]);
    let predicted = with("test2_observer", |config| {
        config.simulator.initial.base_velocity[2] = 1.0; // for it to be in the air for a second
        config.disturbances.outages = channels.map(lost).collect();
        config.disturbances.jets.failure =
            Some(JetFailure { jet: "chest_l_jet".into(), time: 0.3, kind: FailureKind::Off, decay: 0.1 });
    });
    let seen = with("test2_sensors", |config| {
        config.controller.law.wind_observer = true;
        config.simulator.duration = 1.0;
    });
    let falling = with("robot", |config| {
        config.simulator.duration = 1.0;
        config.disturbances.jets.failure =
            Some(JetFailure { jet: "l_arm_jet".into(), time: 0.3, kind: FailureKind::Off, decay: 0.0 });
    });
    let cases = [
        ("channels", predicted, 0b110_0111_1101),
        ("sensors", seen, 0),
        ("a descent", falling, 0b110_0000_0000),
    ];
    for (what, config, modes) in cases {
        let mut flight = Scenario::new(&config).unwrap().begin();
        let mut counted = 0;
        for tick in 0..tick_at(1.0) {
            let of_this_tick = allocations(|| {
                flight.step();
            });
            // The first tick makes the controller's state, the third what the outages hold.
            counted += if tick > 2 { of_this_tick } else { 0 };
        }
        assert_eq!(counted, 0, "{what}");
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let found =
            flight.log().series("degraded_modes").unwrap().data.iter().fold(0, |all, x| all | *x as u32);
        assert_eq!(found, modes, "{what}");
    }
}

/// A robot that stands: feet that carry, that let go and carry again.
#[test]
fn a_tick_on_the_ground_does_not_allocate() {
    let config = experiment("balancing_lateral");
    let robot = load_robot(&config.robot).unwrap();
    let mut controller = Running::new(config.controller(robot).unwrap());
    let mut state = config.simulator.initial.state();
    let thrust = [0.0; 4];
    let (mut counted, mut rows) = (0, 0);
    for tick in 0..400 {
        let time = f64::from(tick) * 0.01;
        let phase = time * 5.0;
        let carried = if tick % 100 < 90 { 212.5 } else { 0.0 };
        state.joint_position[15] = 0.02 * phase.sin();
        state.velocity[6 + 15] = 0.1 * phase.cos();
        let foot = [0.0, 0.0, carried, 3.0 * phase.sin(), -1.2, 0.0];
        let foot_wrenches = DVector::from_vec([foot, foot].concat());
        let measurement = Measurement { wind: 2.0 * SIDE, foot_wrenches, ..at(time, &state, &thrust) };
        let of_this_tick = allocations(|| {
            controller.tick(&measurement);
        });
        if tick > 0 {
            counted += of_this_tick;
        }
        assert_eq!(controller.command().modes, Modes::default(), "tick {tick}");
        rows = rows.max(controller.command().torque_qp.active);
    }
    assert_eq!(counted, 0);
    assert!(rows > 0, "no wrench reached its limits");
}

/// Whatever flies and whatever is measured: no allocation, no panic, certified answers or none, numbers. The example
/// `soak` tries more of these ticks.
#[test]
fn random_flights_with_faults() {
    let episodes = Episodes::new(1);
    proptest!(cases(150), |(number in any::<u64>())| {
        if let Ok(mut flight) = episodes.draw(number) {
            for tick in 0..100 {
                prop_assert_eq!(flight.tick().finding, None, "tick {}", tick);
            }
        }
    });
}
