//! What sensors say: every parameter does what it says, and nothing else.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "what is not disturbed is the same to the last bit")]

use crate::common::{assert_within, random_state, read, rng, robot};
use flight_core::Measurement;
use flight_core::kinematics::RobotState;
use flight_core::spatial::exp_so3;
use flight_sim::sensors::{EncoderConfig, SensorConfig, ThrustSensorConfig, TrembleConfig};
use flight_sim::{Sensors, SensorsConfig};
use nalgebra::Vector3;

const STEP: f64 = 0.01;
const READS: usize = 4000;

fn sensors(config: &SensorsConfig) -> Sensors {
    Sensors::new(config, STEP, 5, 3).unwrap()
}

/// States of a robot that moves: any, one per tick, with thrusts.
fn motion(ticks: usize) -> Vec<(RobotState, Vec<f64>)> {
    let (robot, mut rng) = (robot("sparrow"), rng(5));
    let moving = |tick| (random_state(&mut rng, &robot), vec![tick as f64, 50.0 + tick as f64, 99.0]);
    (0..ticks).map(moving).collect()
}

fn read_all(config: &SensorsConfig, motion: &[(RobotState, Vec<f64>)]) -> Vec<Measurement> {
    let mut sensors = sensors(config);
    motion.iter().map(|(state, thrust)| read(&mut sensors, state, thrust)).collect()
}

fn gyro(state: &RobotState) -> Vector3<f64> {
    state.base.rotation.transpose() * state.base_angular_velocity()
}

#[test]
fn without_errors_the_state_is_measured() {
    let motion = motion(20);
    for ((state, thrust), said) in motion.iter().zip(read_all(&SensorsConfig::default(), &motion)) {
        assert_eq!(said.state.base.position, state.base.position);
        assert_within!((said.state.base.rotation - state.base.rotation).amax(), 1e-15, because "a product with one");
        assert_eq!(said.state.joint_position, state.joint_position);
        assert_within!((&said.state.velocity - &state.velocity).amax(), 1e-14, because "turned into base axes and back");
        assert_eq!(&said.thrust, thrust);
    }
}

/// Errors of every channel in its own axes: position, rotation, linear and angular velocity, thrust.
fn errors(state: &RobotState, thrust: &[f64], said: &Measurement) -> [Vector3<f64>; 5] {
    let turned = state.base.rotation.transpose() * said.state.base.rotation;
    let vee = Vector3::new(turned[(2, 1)], turned[(0, 2)], turned[(1, 0)]);
    [
        said.state.base.position - state.base.position,
        vee,
        said.state.base_linear_velocity() - state.base_linear_velocity(),
        gyro(&said.state) - gyro(state),
        Vector3::from_fn(|jet, _| said.thrust[jet] - thrust[jet]),
    ]
}

#[test]
fn bias_and_noise_are_what_they_say() {
    let of = |size: f64| SensorConfig {
        bias: [size, -2.0 * size, 0.5 * size],
        noise_std: size,
        ..SensorConfig::default()
    };
    let config = SensorsConfig {
        base_position: of(0.03),
        base_rotation: of(0.001),
        base_linear_velocity: of(0.04),
        base_angular_velocity: of(0.02),
        thrust: ThrustSensorConfig { bias: 1.5, noise_std: 0.7, ..ThrustSensorConfig::default() },
        seed: 4,
        ..SensorsConfig::default()
    };
    let still = vec![motion(1).remove(0); READS];
    let readings = read_all(&config, &still);
    assert_eq!(readings, read_all(&config, &still));
    let found: Vec<_> =
        still.iter().zip(&readings).map(|((state, thrust), said)| errors(state, thrust, said)).collect();
    let expected = [
        (Vector3::from(config.base_position.bias), 0.03),
        (Vector3::from(config.base_rotation.bias), 0.001),
        (Vector3::from(config.base_linear_velocity.bias), 0.04),
        (Vector3::from(config.base_angular_velocity.bias), 0.02),
        (Vector3::repeat(1.5), 0.7),
    ];
    let count = READS as f64;
    for (channel, (bias, std)) in expected.into_iter().enumerate() {
        let mean = found.iter().map(|errors| errors[channel]).sum::<Vector3<f64>>() / count;
        for axis in 0..3 {
            assert_within!((mean[axis] - bias[axis]).abs() / std, 4.0 / count.sqrt(), because "one seed: four standard deviations of a mean of that many");
            let square = found.iter().map(|errors| (errors[channel][axis] - mean[axis]).powi(2)).sum::<f64>();
            assert_within!(((square / count).sqrt() / std - 1.0).abs(), 4.0 / (2.0 * count).sqrt(), because "one seed: four standard deviations of a deviation of that many");
        }
        // No two channels share their noise.
        let other = (channel + 1) % expected.len();
        let both = found.iter().map(|e| (e[channel][0] - mean[0]) * (e[other][0] - expected[other].0[0]));
        let correlation = both.sum::<f64>() / (count * std * expected[other].1);
        assert_within!(correlation.abs(), 4.0 / count.sqrt(), because "one seed: four standard deviations of a correlation of that many");
    }
}

#[test]
fn every_channel_has_its_own_delay() {
    let late = |delay| SensorConfig { delay, ..SensorConfig::default() };
    let config = SensorsConfig {
        base_position: late(0.01),
        base_rotation: late(0.02),
        base_linear_velocity: late(0.03),
        base_angular_velocity: late(0.046),
        joints: EncoderConfig { delay: 0.06, ..EncoderConfig::default() },
        thrust: ThrustSensorConfig { delay: 0.07, ..ThrustSensorConfig::default() },
        ..SensorsConfig::default()
    };
    let motion = motion(30);
    let readings = read_all(&config, &motion);
    for (tick, said) in readings.iter().enumerate() {
        let then = |age: usize| &motion[tick.saturating_sub(age)];
        assert_eq!(said.state.base.position, then(1).0.base.position);
        assert_eq!(said.state.base.rotation, then(2).0.base.rotation);
        assert_eq!(said.state.base_linear_velocity(), then(3).0.base_linear_velocity());
        assert_within!((gyro(&said.state) - gyro(&then(5).0)).amax(), 1e-14, because "turned into base axes and back");
        assert_eq!(said.state.joint_position, then(6).0.joint_position);
        assert_eq!(said.state.joint_velocity(), then(6).0.joint_velocity());
        assert_eq!(said.thrust, then(7).1);
    }
}

/// A sensor of the base with a period says nothing between, and with gaps as often as they say; the first measurement is
/// there.
#[test]
fn sensors_of_the_base_have_rates_and_gaps() {
    let every = |period| SensorConfig { period, ..SensorConfig::default() };
    let config = SensorsConfig {
        base_position: every(0.02),
        base_rotation: every(0.0),
        base_linear_velocity: every(0.05),
        base_angular_velocity: SensorConfig { gaps: 0.2, ..SensorConfig::default() },
        seed: 3,
        ..SensorsConfig::default()
    };
    let motion = motion(1000);
    let mut missing = 0;
    for (tick, ((truth, _), said)) in motion.iter().zip(read_all(&config, &motion)).enumerate() {
        let is_said = |numbers: Vector3<f64>| numbers.iter().all(|number| number.is_finite());
        assert_eq!(is_said(said.state.base.position), tick.is_multiple_of(2), "tick {tick}");
        assert_eq!(said.state.base.rotation, truth.base.rotation, "tick {tick}");
        assert_eq!(is_said(said.state.base_linear_velocity()), tick.is_multiple_of(5), "tick {tick}");
        missing += usize::from(!is_said(said.state.base_angular_velocity()));
        assert!(tick > 0 || missing == 0);
    }
    assert_within!((missing as f64 - 200.0).abs(), 51.0, because "four standard deviations of a thousand draws");
}

/// Gyroscopes stand in the base, whose measured rotation turns what they say.
#[test]
fn the_measured_rotation_turns_the_gyroscopes() {
    let (tilt, drift) = ([0.1, 0.0, -0.2], [0.3, -0.1, 0.2]);
    let of = |bias| SensorConfig { bias, ..SensorConfig::default() };
    let config = SensorsConfig {
        base_rotation: of(tilt),
        base_angular_velocity: of(drift),
        ..SensorsConfig::default()
    };
    let (state, thrust) = motion(1).remove(0);
    let said = read(&mut sensors(&config), &state, &thrust);
    let rotation = state.base.rotation * exp_so3(&Vector3::from(tilt));
    let expected = rotation * (gyro(&state) + Vector3::from(drift));
    assert_within!((said.state.base_angular_velocity() - expected).amax(), 1e-14, because "a few products of order one");
}

#[test]
fn encoders_and_thrust_sensors_have_steps() {
    let config = SensorsConfig {
        joints: EncoderConfig { resolution: 0.25, ..EncoderConfig::default() },
        thrust: ThrustSensorConfig { resolution: 0.5, ..ThrustSensorConfig::default() },
        ..SensorsConfig::default()
    };
    let (mut state, mut thrust) = motion(1).remove(0);
    thrust.copy_from_slice(&[0.74, 0.76, 8.25]);
    state.joint_position.copy_from_slice(&[0.37, 0.38, -0.125, 0.125, 1.0]);
    let said = read(&mut sensors(&config), &state, &thrust);
    assert_eq!(said.state.joint_position.as_slice(), [0.25, 0.5, -0.25, 0.25, 1.0]);
    assert_eq!(said.thrust, [0.5, 1.0, 8.5]);
    assert_eq!(said.state.joint_velocity(), state.joint_velocity());
}

/// A bias that grows, encoders that are off, and joints that seem to tremble.
#[test]
fn errors_grow_and_tremble() {
    let (frequency, amplitude, bias) = (3.0, 0.01, vec![0.1, -0.2, 0.3, 0.0, 0.05]);
    let config = SensorsConfig {
        base_angular_velocity: SensorConfig {
            bias: [0.1, 0.0, 0.0],
            drift: [0.0, 0.2, -0.3],
            ..Default::default()
        },
        joints: EncoderConfig {
            bias: bias.clone(),
            tremble: Some(TrembleConfig { amplitude, frequency }),
            ..EncoderConfig::default()
        },
        ..SensorsConfig::default()
    };
    let (state, thrust) = motion(1).remove(0);
    let mut sensors = sensors(&config);
    for tick in 0..30_u32 {
        let (time, said) = (f64::from(tick) * STEP, read(&mut sensors, &state, &thrust));
        let turned = gyro(&said.state) - gyro(&state) - Vector3::new(0.1, 0.2 * time, -0.3 * time);
        assert_within!(turned.amax(), 1e-13, because "a few products of order one", "tick {tick}");
        let after = 0.3 * STEP;
        let (between, velocities) = sensors.read_joints(&state, after);
        for (joint, bias) in bias.iter().enumerate() {
            let positions = [(time, said.state.joint_position[joint]), (time + after, between[joint])];
            for (time, position) in positions {
                let phase = std::f64::consts::TAU * frequency * time - joint as f64;
                let moved = position - state.joint_position[joint];
                assert_within!((moved - bias - amplitude * phase.sin()).abs(), 1e-13, because "as above");
            }
            assert_eq!([said.state.velocity[6 + joint], velocities[joint]], [state.velocity[6 + joint]; 2]);
        }
    }
}

/// Joints that start to turn at 2 rad/s: the measured velocity goes there with the time constant.
#[test]
fn encoder_velocities_are_filtered_differences() {
    let time_constant = 0.03;
    let config = SensorsConfig {
        joints: EncoderConfig { velocity_time_constant: Some(time_constant), ..EncoderConfig::default() },
        ..SensorsConfig::default()
    };
    let (mut state, thrust) = motion(1).remove(0);
    state.velocity.fill(0.0);
    let mut sensors = sensors(&config);
    for tick in 0..20_u32 {
        let said = read(&mut sensors, &state, &thrust).state.velocity[6];
        let expected = 2.0 * (1.0 - (-f64::from(tick) * STEP / time_constant).exp());
        assert_within!((said - expected).abs(), 1e-12, because "twenty differences of positions of order one over 10 ms");
        state.joint_position.add_scalar_mut(2.0 * STEP);
    }
}

#[test]
fn bad_sensors_are_refused_by_name() {
    for (expected, bias) in [
        ("joints.bias[0]` is not finite", vec![f64::NAN; 5]),
        ("joints.bias is 2 numbers; expected 5, one for each joint, or none", vec![0.1; 2]),
    ] {
        let mut config = SensorsConfig::default();
        config.joints.bias = bias;
        let refusal = Sensors::new(&config, STEP, 5, 3).unwrap_err().to_string();
        assert!(refusal.contains(&format!("simulator.sensors.{expected}")), "{refusal}");
    }
}
