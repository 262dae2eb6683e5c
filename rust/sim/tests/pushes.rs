//! Forces and moments on bodies of the simulated robot.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{assert_says, assert_within, difference, experiment, fly, random_state, rng, robot};
use flight_core::kinematics::Kinematics;
use flight_core::spatial::stack;
use flight_sim::disturbances::{Push, Pushes};
use flight_sim::{Disturbances, Outcome, Plant, Scenario};
use nalgebra::{DVector, Vector3, Vector6};

const STEP: f64 = 0.01;

fn push(force: [f64; 3], moment: [f64; 3], start: f64, duration: f64) -> Push {
    Push { body: "chest".into(), force, moment, start, duration }
}

/// Force at the body's centre of mass, moment, and both, by the Jacobian of that point; nothing outside of their times.
#[test]
fn a_push_is_a_wrench_on_its_body() {
    let robot = robot("ironcub_mk1");
    let state = random_state(&mut rng(7), &robot);
    let mut kinematics = Kinematics::new(&robot);
    kinematics.update(&robot, &state);
    let body = robot.body_index("chest").unwrap();
    let centre = kinematics.bodies[body].i_from_b.transform_point(&robot.bodies[body].com_b);
    let (linear, angular) = kinematics.jacobian(body, &centre);
    let (force, moment) = (Vector3::new(30.0, -20.0, 10.0), Vector3::new(1.0, 2.0, -3.0));
    for (f, m) in [(force, Vector3::zeros()), (Vector3::zeros(), moment), (force, moment)] {
        let mut pushes = Pushes::new(&[push(f.into(), m.into(), 2.0 * STEP, STEP)], &robot).unwrap();
        let expected = linear.transpose() * f + angular.transpose() * m;
        for acts in [0.0, 0.0, 1.0, 0.0] {
            let mut found = DVector::zeros(6 + robot.joints.len());
            pushes.add(&robot, &kinematics, STEP, &mut found);
            assert_within!(difference(found, expected.clone() * acts), 1e-12, because "rounding");
        }
    }
}

/// A push that begins or ends between ticks acts for its share of them, and its impulse is that of its duration.
#[test]
fn a_push_between_ticks_has_its_impulse() {
    let robot = robot("ironcub_mk1");
    let mut kinematics = Kinematics::new(&robot);
    kinematics.update(&robot, &flight_core::RobotState::zero(robot.joints.len()));
    let shares = |start, duration| {
        let mut pushes = Pushes::new(&[push([1.0, 0.0, 0.0], [0.0; 3], start, duration)], &robot).unwrap();
        let mean = |_| {
            let mut force = DVector::zeros(6 + robot.joints.len());
            pushes.add(&robot, &kinematics, STEP, &mut force);
            force[0]
        };
        [0; 6].map(mean)
    };
    for (start, duration, expected) in [
        (0.0, STEP, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (0.013, 0.02, [0.0, 0.7, 1.0, 0.3, 0.0, 0.0]),
        (0.022, 0.003, [0.0, 0.0, 0.3, 0.0, 0.0, 0.0]),
        (0.045, 10.0, [0.0, 0.0, 0.0, 0.0, 0.5, 1.0]),
    ] {
        let found = Vector6::from(shares(start, duration));
        assert_within!(difference(found, Vector6::from(expected)), 1e-12, because "rounding");
    }
}

/// In a step of the plant the velocities change by `Δt M⁻¹ w` more than without the push.
#[test]
fn a_push_accelerates_the_plant() {
    let mut config = experiment("test2");
    config.simulator.initial.free_fall_tick = false;
    let (force, moment) = (Vector3::new(20.0, 30.0, -10.0), Vector3::new(4.0, -5.0, 6.0));
    let step = |pushes: Vec<Push>| {
        let disturbances = Disturbances { pushes, ..Disturbances::default() };
        let law = &config.controller.law;
        let mut plant = Plant::new(robot("ironcub_mk1"), &config.simulator, &disturbances, law).unwrap();
        plant.observe(&Vector3::zeros());
        plant.advance(&[0.0; 23], &[0.0; 4], &Vector3::zeros(), STEP);
        (plant.dynamics().mass_matrix.clone() * &plant.state().velocity, plant)
    };
    let (without, plant) = step(vec![]);
    let (with, _) = step(vec![push(force.into(), moment.into(), 0.0, STEP)]);
    let body = plant.robot().body_index("chest").unwrap();
    let centre = plant.kinematics().bodies[body].i_from_b.transform_point(&plant.robot().bodies[body].com_b);
    let mut expected = DVector::zeros(29);
    let wrench = stack(&force, &moment);
    plant.kinematics().add_generalised_wrench(body, &centre, &wrench, &mut expected);
    assert_within!(difference(with - without, expected * STEP), 1e-10, because "rounding of the factors");
}

/// A healthy robot that is touched flies on: the shipped controllers take no touch for a fault.
#[test]
fn a_touched_robot_flies_on() {
    let touches = [("chest", [8.0, 0.0, 0.0], [0.0; 3]), ("root_link", [0.0; 3], [0.0, 3.0, 0.0])];
    let mut flights = Vec::new();
    for (name, start) in [("test2_observer", 3.0), ("test2_mpc", 3.0), ("mk3_hover", 2.1)] {
        for (body, force, moment) in touches {
            let mut config = experiment(name);
            config.simulator.duration = start + 5.0;
            config.disturbances.pushes =
                vec![Push { body: body.into(), force, moment, start, duration: 0.2 }];
            flights.push(config);
        }
    }
    for flight in fly(&flights) {
        let rotation = flight.summary.max_rotation_error.to_degrees();
        assert!(flight.outcome == Outcome::Completed && rotation < 30.0, "{rotation} deg");
    }
}

#[test]
fn bad_pushes_are_refused_by_name() {
    let good = || push([1.0, 0.0, 0.0], [0.0; 3], 1.0, 0.2);
    let refused = |bad: Push| {
        let mut config = experiment("test2");
        config.disturbances.pushes = vec![good(), bad];
        Scenario::check(&config).unwrap_err()
    };
    for (bad, words) in [
        (Push { body: "chset".into(), ..good() }, ["body", "chset"]),
        (Push { moment: [0.0, f64::NAN, 0.0], ..good() }, ["moment[1]` is not finite", "finite"]),
    ] {
        assert_says(&refused(bad), &["disturbances.pushes[1].", words[0], words[1]]);
    }
}
