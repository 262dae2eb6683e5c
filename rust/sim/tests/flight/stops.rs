//! Joint stops: what the equation M87 of `docs/model` says of them.

use super::{NO_AIR, with};
use crate::common::{assert_within, experiment, robot};
use flight_sim::config::Integrator;
use flight_sim::{Disturbances, Plant};
use nalgebra::Vector3;

const ELBOW: usize = 6;
/// Stiffness \[N m/rad\].
const STIFFNESS: f64 = 1e5;

/// The robot without air and thrust.
fn plant(integrator: Integrator, joint_stops: bool) -> Plant {
    let config = with(experiment("test2"), |config| {
        config.simulator.aero = NO_AIR;
        config.simulator.initial.free_fall_tick = false;
        config.simulator.initial.thrust = vec![0.0; 4];
        config.simulator.integrator = integrator;
        config.simulator.joint_stops = joint_stops;
    });
    Plant::new(robot("ironcub_mk1"), &config.simulator, &Disturbances::default(), &config.controller.law)
        .unwrap()
}

/// Elbow position and velocity, tick by tick, under a torque at the elbow.
fn press_joint(plant: &mut Plant, torque: f64, step: f64, ticks: usize) -> Vec<(f64, f64)> {
    let mut torques = [0.0; 23];
    torques[ELBOW] = torque;
    (0..ticks)
        .map(|_| {
            plant.observe(&Vector3::zeros());
            plant.advance(&torques, &[0.0; 4], &Vector3::zeros(), step);
            let state = plant.state();
            (state.joint_position[ELBOW], state.joint_velocity()[ELBOW])
        })
        .collect()
}

/// A joint that is pressed against its stop comes to rest where the spring holds the torque, without bouncing
/// back, at every step and with both integrators.
#[test]
fn a_pressed_joint_rests_at_its_stop() {
    let (lower, _) = robot("ironcub_mk1").joints[ELBOW].stops;
    assert_eq!(lower, 12_f64.to_radians(), "the controller may go further than the URDF");
    for integrator in [Integrator::SemiImplicitEuler, Integrator::ExplicitEuler] {
        for (step, ticks) in [(0.01, 50), (0.005, 100), (0.002, 250), (0.001, 500)] {
            let mut plant = plant(integrator, true);
            let motion = press_joint(&mut plant, -20.0, step, ticks);
            let hit = motion.iter().position(|(position, _)| *position < lower + 1e-3).unwrap();
            for (position, velocity) in &motion[hit + 2..] {
                assert!((lower - 1e-3..lower + 1e-3).contains(position), "{step}: {position}");
                assert!(velocity.abs() < 0.2, "{step}: {velocity}");
            }
            // The rest of the robot, which turns meanwhile, presses on the elbow too: a tenth of the torque.
            let (last, _) = motion[motion.len() - 1];
            assert!(
                (lower - last - 20.0 / STIFFNESS).abs() < 0.1 * 20.0 / STIFFNESS,
                "{step}: {}",
                lower - last
            );
        }
    }
}

/// Stops are forces between links: they change neither the momentum nor its moment.
#[test]
fn stops_change_no_momentum() {
    let mut plant = plant(Integrator::SemiImplicitEuler, true);
    let step = 1e-4;
    for _ in 0..2000 {
        press_joint(&mut plant, -20.0, step, 1);
        plant.observe(&Vector3::zeros());
    }
    let momentum = plant.dynamics().momentum;
    let fallen = -9.81 * plant.kinematics().mass() * 2000.0 * step;
    // Explicit in the velocity products, so to the first order in the step: 1e-4 of what moves.
    assert_within!((momentum[2] - fallen).abs() / fallen.abs(), 1e-3);
    for axis in [0, 1, 3, 4, 5] {
        assert_within!(momentum[axis].abs(), 1e-2);
    }
}

/// Without them joints turn on.
#[test]
fn stops_can_be_switched_off() {
    let motion = press_joint(&mut plant(Integrator::SemiImplicitEuler, false), -0.5, 0.01, 20);
    assert!(motion[19].0 < -0.3, "{}", motion[19].0);
}
