//! What the motion changes of the thrusts' wrench, beside differences.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{Running, assert_within, at, hover_of, move_state, random_state, rng, robot};
use nalgebra::DVector;

/// `Λ_T ν` is the change of `A_T T` as the robot moves on, the couples of its rotors with it.
#[test]
fn lambda_of_the_thrusts_is_the_change_of_their_wrench() {
    const STEP: f64 = 1e-5;
    for name in ["slider", "sparrow"] {
        let robot = robot(name);
        let is_rotor = robot.jets.iter().any(|jet| jet.torque_to_thrust.abs() > 0.01);
        assert_eq!(is_rotor, name == "slider");
        let config = hover_of(&robot);
        let thrust: Vec<f64> = robot.jets.iter().map(|jet| 0.6 * jet.thrust_max).collect();
        let mut rng = rng(3);
        for _ in 0..5 {
            let state = random_state(&mut rng, &robot);
            let wrench = |time: f64| {
                let mut controller = Running::new(config.controller(robot.clone()).unwrap());
                controller.tick(&at(0.0, &move_state(&state, time), &thrust));
                let momentum = &controller.terms().momentum;
                (&momentum.a_t * DVector::from_row_slice(&thrust), &momentum.lambda_t * &state.velocity)
            };
            let ((before, _), (_, found), (after, _)) = (wrench(-STEP), wrench(0.0), wrench(STEP));
            let expected = (after - before) / (2.0 * STEP);
            let scale = found.amax();
            // Differences of the third order, of some rad/s, and the rounding of some hundred newtons.
            assert_within!((found - expected).amax(), 1e-7 * scale, "{name}");
        }
    }
}
