//! What cannot be right is refused where it is built, or does not outlive its tick.

#![allow(clippy::unwrap_used, clippy::panic)]
use crate::common::{Loop, assert_within, experiment};
use flight_core::Measurement;
use flight_core::control::CommandStatus;
use flight_core::spatial::{orthonormality_error, rotation_from_rpy, rpy_from_rotation};
use nalgebra::{DVector, Matrix3, Vector3};

/// At gimbal lock itself, where only one of roll and yaw is left, the rotation still comes back.
#[test]
fn rpy_at_gimbal_lock_names_the_rotation() {
    for (yaw, sign) in [(0.7_f64, 1.0), (-2.0, 1.0), (0.7, -1.0), (3.0, -1.0)] {
        let (s, c) = yaw.sin_cos();
        let r = Matrix3::new(0.0, -s, sign * c, 0.0, c, sign * s, -sign, 0.0, 0.0);
        assert_within!(orthonormality_error(&r), 1e-15, because "a few units in the last place of numbers of order one");
        assert_within!((rotation_from_rpy(&rpy_from_rotation(&r)) - r).amax(), 1e-12);
    }
}

/// A velocity of another length is a bad measurement, not a panic.
#[test]
fn a_velocity_of_another_length_is_a_bad_measurement() {
    for length in [28, 30, 0] {
        let Loop { plant, mut controller, .. } = Loop::new(&experiment("test2"));
        let mut state = plant.state().clone();
        state.velocity = DVector::zeros(length);
        let thrust = plant.jets().thrust();
        let wind = Vector3::zeros();
        let m = |state| Measurement { time: 0.0, state, thrust, wind, foot_wrenches: &[] };
        controller.tick(&m(plant.state()));
        assert_eq!(controller.tick(&m(&state)).status, CommandStatus::BadMeasurement);
    }
}

/// One absurd sample does not cost the flight: a tick later the torques are sensible again.
#[test]
fn one_absurd_velocity_is_forgotten() {
    let Loop { plant, mut controller, .. } = Loop::new(&experiment("test2"));
    let good = plant.state().clone();
    let mut absurd = good.clone();
    absurd.velocity[9] = 1e12;
    let mut tick = |state: &flight_core::RobotState, k: u32| {
        let m = Measurement {
            time: f64::from(k) * 0.01,
            state,
            thrust: plant.jets().thrust(),
            wind: Vector3::zeros(),
            foot_wrenches: &[],
        };
        let c = controller.tick(&m).clone();
        (c.status, controller.terms().unlimited_torque.amax(), c.joint_torque.amax())
    };
    tick(&good, 0);
    tick(&absurd, 1);
    for k in 2..100 {
        tick(&good, k);
    }
    let last = tick(&good, 100);
    assert!(last.1 < 40.0, "{last:?}");
}
