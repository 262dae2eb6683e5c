//! What cannot be right is refused where it is built, or does not outlive its tick.

#![allow(clippy::unwrap_used, clippy::panic)]
use crate::common::{Loop, at, experiment};
use flight_core::control::Modes;
use nalgebra::DVector;

/// A velocity of another length is a bad measurement, not a panic.
#[test]
fn a_velocity_of_another_length_is_a_bad_measurement() {
    for length in [28, 30, 0] {
        let Loop { plant, mut controller, .. } = Loop::new(&experiment("test2"));
        let mut state = plant.state().clone();
        state.velocity = DVector::zeros(length);
        let thrust = plant.jets().thrust();
        controller.tick(&at(0.0, plant.state(), thrust));
        assert!(controller.tick(&at(0.0, &state, thrust)).modes.contains(Modes::MEASUREMENT_IGNORED));
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
        let c = controller.tick(&at(f64::from(k) * 0.01, state, plant.jets().thrust())).clone();
        (c.modes, controller.terms().unlimited_torque.amax(), c.joint_torque.amax())
    };
    tick(&good, 0);
    tick(&absurd, 1);
    for k in 2..100 {
        tick(&good, k);
    }
    let last = tick(&good, 100);
    assert!(last.1 < 40.0, "{last:?}");
}
