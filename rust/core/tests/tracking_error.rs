//! The supervisor: which errors count as straying, and after which time.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::{Running, TIME_STEP, experiment};
use crate::control::Sample as _;
use flight_core::Measurement;
use flight_core::control::Modes;
use flight_core::control::detect::tracking_error::{Errors, TrackingErrorConfig};
use flight_core::control::law::setpoint::Setpoint;
use flight_core::spatial::axis_angle;
use flight_core::timing::Exceeded;
use flight_io::load_robot;
use nalgebra::{Matrix3, Vector3};

const LIMITS: TrackingErrorConfig = TrackingErrorConfig { rotation: 0.6, position: 0.4, joint_velocity: 2.0 };

/// A limit counts after the confirmation time, in which it has been exceeded throughout.
#[test]
fn a_limit_has_to_be_exceeded_for_a_while() {
    let near = Errors { rotation: 0.5, position: 0.3, joint_velocity: 1.9 };
    for far in [
        Errors { rotation: 0.7, ..near },
        Errors { position: 0.5, ..near },
        Errors { joint_velocity: 2.1, ..near },
    ] {
        let mut exceeded = Exceeded::default();
        let strays = [far, far, near, far, far, far, far, near]
            .map(|errors| LIMITS.update(&mut exceeded, TIME_STEP, &errors));
        assert_eq!(strays, [false, false, false, false, false, false, true, false], "{far:?}");
    }
}

/// What a controller says in its fifth tick towards a set-point, from a robot in this state.
fn says(change: impl Fn(&mut Measurement, &mut Setpoint)) -> Modes {
    let mut config = experiment("test2_observer");
    let law = &mut config.controller.law;
    (law.fault_detection.tracking_error, law.channels.jump, law.fault_detection.engines) =
        (Some(LIMITS), false, None);
    let mut controller = Running::new(config.controller(load_robot(&config.robot).unwrap()).unwrap());
    let mut sample = Measurement::start(&config);
    controller.tick(&sample);
    let mut setpoint =
        Setpoint::at_rest(controller.terms().setpoint.com_position, sample.state.base.rotation);
    change(&mut sample, &mut setpoint);
    for _ in 0..4 {
        sample.time += TIME_STEP;
        controller.tick_towards(&sample, &setpoint);
    }
    controller.command().modes
}

/// Errors of rotation and centre of mass count with the rates at which they grow or shrink, those of the set-point
/// included; joints count with their speed. Errors along the body's and the inertial axes are the same.
#[test]
fn errors_count_with_their_rates() {
    type Change = fn(&mut Measurement, &mut Setpoint);
    let cases: [(&str, bool, Change); 14] = [
        ("nothing", false, |_, _| {}),
        ("0.38 m beside it", false, |_, setpoint| setpoint.com_position.y += 0.38),
        ("0.42 m beside it", true, |_, setpoint| setpoint.com_position.y -= 0.42),
        ("0.2 m, growing by 0.75 m/s", true, |sample, setpoint| {
            setpoint.com_position.x -= 0.2;
            sample.state.velocity[0] = 0.75;
        }),
        ("0.42 m, shrinking by 0.5 m/s", false, |sample, setpoint| {
            setpoint.com_position.x += 0.42;
            sample.state.velocity[0] = 0.5;
        }),
        ("0.2 m, both at 0.5 m/s", false, |sample, setpoint| {
            setpoint.com_position.x -= 0.2;
            (sample.state.velocity[0], setpoint.com_velocity.x) = (0.5, 0.5);
        }),
        ("turned by 0.58 rad", false, |_, setpoint| setpoint.rotation *= axis_angle(&Vector3::y(), 0.58)),
        ("turned by 0.62 rad", true, |_, setpoint| setpoint.rotation *= axis_angle(&Vector3::z(), -0.62)),
        ("level", false, |sample, setpoint| {
            (sample.state.base.rotation, setpoint.rotation) = (Matrix3::identity(), Matrix3::identity());
        }),
        ("upside down, to the last bit", true, |sample, setpoint| {
            let half_turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
            (sample.state.base.rotation, setpoint.rotation) = (Matrix3::identity(), half_turn);
        }),
        ("0.3 rad, growing by 1.5 rad/s", true, |sample, setpoint| {
            setpoint.rotation = axis_angle(&Vector3::z(), -0.3) * setpoint.rotation;
            sample.state.velocity[5] = 1.5;
        }),
        ("0.3 rad, both at 1 rad/s", false, |sample, setpoint| {
            setpoint.rotation = axis_angle(&Vector3::z(), -0.3) * setpoint.rotation;
            setpoint.angular_velocity_b.z = 1.0;
            sample.state.velocity[5] = 1.0;
        }),
        ("a joint at 1.9 rad/s", false, |sample, _| sample.state.velocity[12] = -1.9),
        ("a joint at 2.1 rad/s", true, |sample, _| sample.state.velocity[12] = -2.1),
    ];
    for (what, expected, change) in cases {
        let modes = says(change);
        assert_eq!(modes, if expected { Modes::TRACKING_ERROR } else { Modes::default() }, "{what}: {modes}");
    }
}
