//! What the motion changes of the thrusts' wrench, beside differences.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{Running, assert_within, at, hover_of, move_state, random_state, rng, robot};
use flight_core::control::law::attitude::{MomentumGains, attitude_demand};
use flight_core::control::law::setpoint::Setpoint;
use nalgebra::{DVector, Matrix3, Vector3};

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

/// A rotation that no moment changes is damped: with the wanted rotation, `k̈* = −ė − c₁ ω`, and `ė = ω`.
#[test]
fn the_attitude_law_damps_a_rotation() {
    let (ko, c0, c1) = (10.0, 0.0, 50.0);
    let gains = MomentumGains { kp_linear: [0.0; 3], kd_linear: [0.0; 3], ko, c0, c1 };
    let setpoint = Setpoint::at_rest(Vector3::zeros(), Matrix3::identity());
    let (inertia, omega) =
        (Matrix3::from_diagonal(&Vector3::new(2.0, 3.0, 4.0)), Vector3::new(0.3, -0.2, 0.1));
    let moment = omega.cross(&(inertia * omega));
    let inverse = inertia.try_inverse().unwrap();
    let demand =
        attitude_demand(&gains, &setpoint, &Matrix3::identity(), &omega, &moment, &inertia, &inverse);
    assert_within!((demand.k_ddot_desired_b + (1.0 + c1) * omega).amax(), 1e-13);
}
