//! Fuel that leaves the robot.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{assert_says, assert_within, difference, experiment, robot};
use flight_core::kinematics::Kinematics;
use flight_sim::fuel::{Fuel, FuelConfig};
use flight_sim::{Disturbances, Plant, Scenario};
use nalgebra::{Matrix3, Vector3};

const CHEST: usize = 3;

/// Idle and full thrust of a P220: 0.13 and 0.725 l/min, of 0.8 kg/l.
fn fuel() -> FuelConfig {
    FuelConfig {
        mass: 1.2,
        body: "chest".into(),
        position: [0.0, 0.1, -0.15],
        idle: 1.4e-3,
        by_thrust: 3.8e-5,
    }
}

/// Chest and burned fuel together are the full chest: mass, first moment, and inertia about any point.
#[test]
fn the_chest_loses_a_point_mass() {
    let full = robot("ironcub_mk1");
    let mut robot = full.clone();
    let mut tank = Fuel::new(&fuel(), &robot).unwrap();
    let thrust = [100.0, 50.0, 150.0, 200.0];
    for _ in 0..1000 {
        tank.burn(&thrust, 0.01, &mut robot);
    }
    let burned = 10.0 * (4.0 * 1.4e-3 + 3.8e-5 * 500.0);
    let (before, after) = (&full.bodies[CHEST], &robot.bodies[CHEST]);
    assert_within!(difference(after.mass + burned, before.mass), 1e-13);
    let at = Vector3::from(fuel().position);
    assert_within!(difference(after.com_b * after.mass + at * burned, before.com_b * before.mass), 1e-13);
    let about = Vector3::new(0.3, -0.2, 0.1);
    let arm = |point: Vector3<f64>, mass: f64| {
        let r = point - about;
        mass * (Matrix3::identity() * r.norm_squared() - r * r.transpose())
    };
    let together = after.inertia_b + arm(after.com_b, after.mass) + arm(at, burned);
    assert_within!(difference(together, before.inertia_b + arm(before.com_b, before.mass)), 1e-13);
    for _ in 0..10_000 {
        tank.burn(&thrust, 0.01, &mut robot);
    }
    assert_within!(difference(robot.bodies[CHEST].mass, before.mass - 1.2), 1e-13, "an empty tank");
}

/// The plant's mass and centre of mass are those of the lighter robot, and its motion goes on without a jump.
#[test]
fn a_plant_becomes_lighter() {
    let mut config = experiment("test2");
    config.simulator.fuel = Some(fuel());
    let (simulator, law) = (&config.simulator, &config.controller.law);
    let mut plant = Plant::new(robot("ironcub_mk1"), simulator, &Disturbances::default(), law).unwrap();
    let before = plant.robot().mass();
    let thrust: f64 = plant.jets().thrust().iter().sum();
    for _ in 0..10 {
        plant.observe(&Vector3::zeros());
        plant.advance(&[0.0; 23], &[0.0; 4], &Vector3::zeros(), 0.01);
    }
    plant.observe(&Vector3::zeros());
    let burned = 0.1 * (4.0 * 1.4e-3 + 3.8e-5 * thrust);
    assert_within!(difference(before - plant.kinematics().mass(), burned), 1e-13);
    let mut anew = Kinematics::new(plant.robot());
    anew.update(plant.robot(), plant.state());
    assert_within!(difference(anew.com, plant.kinematics().com), 1e-15);
    assert_within!(difference(plant.dynamics().mass_matrix[(0, 0)], plant.kinematics().mass()), 1e-13);
}

#[test]
fn bad_fuel_is_refused_by_name() {
    let refused = |change: fn(&mut FuelConfig), expected: &[&str]| {
        let mut config = experiment("test2");
        let mut tank = fuel();
        change(&mut tank);
        config.simulator.fuel = Some(tank);
        assert_says(&Scenario::new(&config).unwrap_err(), expected);
    };
    refused(|tank| tank.mass = 100.0, &["simulator.fuel.mass", "100", "of the body"]);
    refused(|tank| tank.position = [3.0, 0.0, 0.0], &["simulator.fuel.mass", "inertia"]);
    refused(|tank| tank.body = "chst".into(), &["simulator.fuel.body", "chst"]);
}
