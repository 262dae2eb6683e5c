//! Simulated sensors: pose and velocity of the base, joints, thrusts, height above the ground; and the wind ahead.
//!
//! ```text
//! truth ──► delay ──► + bias + drift + noise ──► Measurement: state, thrust, height
//! joints ──► delay ──► + bias + tremble ──► quantisation of the encoder ──► differences ──► low pass
//! ```
//!
//! Equations M88 to M90 of `docs/model`.

use crate::foot_sensors::FootSensorConfig;
use crate::noise::Noise;
use crate::wind::Wind;
use flight_core::Measurement;
use flight_core::error::BuildError;
use flight_core::kinematics::RobotState;
use flight_core::spatial::exp_so3;
use flight_core::timing::share;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Stream of the noise, the same as that of turbulence; measured wind and thrust estimators have others.
const STREAM: u64 = 2;

/// Stream of the seed from which gaps are drawn.
const STREAM_OF_GAPS: u64 = 4;

/// Stream of the noise and the gaps of heights: other sensors draw the same numbers with and without it.
const STREAM_OF_HEIGHT: u64 = 5;

/// What is not measured.
const NONE: Vector3<f64> = Vector3::new(f64::NAN, f64::NAN, f64::NAN);

/// Sensors of the robot's own state; those without settings are exact. And the wind ahead.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SensorsConfig {
    /// Position of the base origin \[m, inertial axes\].
    pub base_position: SensorConfig,
    /// Rotation of the base; bias and noise rotate it about its own axes \[rad\].
    pub base_rotation: SensorConfig,
    /// Velocity of the base origin \[m/s, inertial axes\].
    pub base_linear_velocity: SensorConfig,
    /// Gyroscopes \[rad/s, base axes\]; the measured rotation transforms them to inertial axes.
    pub base_angular_velocity: SensorConfig,
    /// Joints.
    pub joints: EncoderConfig,
    /// Thrust of every jet.
    pub thrust: ThrustSensorConfig,
    /// Height of the base origin above the ground on which the robot is to land; without it none is measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<HeightSensorConfig>,
    /// Wrenches on the feet of the controller; without it they are exact.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feet: Option<FootSensorConfig>,
    /// Time ahead \[s\] over which the controller receives the true wind of every tick, as from a lidar; zero for none.
    #[schemars(range(min = 0, max = 10))]
    pub wind_preview: f64,
    /// Seed of the noise of all sensors.
    pub seed: u64,
}

/// A three-axis sensor; values are in the unit of its measurement.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SensorConfig {
    /// Bias of every measurement.
    pub bias: [f64; 3],
    /// Change of the bias per second.
    pub drift: [f64; 3],
    /// Standard deviation of white noise on every axis, drawn in every tick.
    #[schemars(range(min = 0))]
    pub noise_std: f64,
    /// Age of the measurement, rounded to ticks \[s\].
    #[schemars(range(min = 0, max = 1))]
    pub delay: f64,
    /// Time from one measurement to the next, rounded to ticks \[s\]; between them there is none. Zero: in every tick.
    #[schemars(range(min = 0, max = 1))]
    pub period: f64,
    /// Share of the other measurements that are missing, drawn one by one.
    #[schemars(range(min = 0, max = 1))]
    pub gaps: f64,
}

/// A sensor of the height above the ground, less that of a robot that stands as at the start of the flight.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HeightSensorConfig {
    /// Bias of every measurement \[m\].
    pub bias: f64,
    /// Standard deviation of white noise, drawn for every measurement \[m\].
    #[schemars(range(min = 0))]
    pub noise_std: f64,
    /// Age of the measurement, rounded to ticks \[s\].
    #[schemars(range(min = 0, max = 1))]
    pub delay: f64,
    /// Time from one measurement to the next, rounded to ticks \[s\]; between them there is none. Zero: in every tick.
    #[schemars(range(min = 0, max = 1))]
    pub period: f64,
    /// Share of the measurements that are missing, drawn one by one.
    #[schemars(range(min = 0, max = 1))]
    pub gaps: f64,
}

/// Encoders of the joints.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EncoderConfig {
    /// Bias of the position of every joint \[rad, m\]; empty for none.
    pub bias: Vec<f64>,
    /// Oscillation of the measured positions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tremble: Option<TrembleConfig>,
    /// Quantisation step of the positions \[rad, m\]; zero for none.
    #[schemars(range(min = 0))]
    pub resolution: f64,
    /// Time constant \[s\] of a first-order low pass of position differences, from which velocities are measured;
    /// without it velocities are measured directly.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0))]
    pub velocity_time_constant: Option<f64>,
    /// Age of the measurement, rounded to ticks \[s\].
    #[schemars(range(min = 0, max = 1))]
    pub delay: f64,
}

/// An oscillation of the measured positions of all joints, not of velocities that are measured directly; the phase of
/// each is a radian behind that of the one before.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrembleConfig {
    /// Amplitude \[rad, m\].
    #[schemars(range(min = 0))]
    pub amplitude: f64,
    /// Frequency \[Hz\].
    #[schemars(range(min = 0))]
    pub frequency: f64,
}

impl EncoderConfig {
    /// A joint's position \[rad, m\] as it is measured at `time` \[s\] (M90).
    fn measured(&self, joint: usize, position: f64, time: f64) -> f64 {
        let trembling = self.tremble.map_or(0.0, |tremble| tremble.of(joint, time));
        let error = self.bias.get(joint).copied().unwrap_or(0.0) + trembling;
        quantised(position + error, self.resolution)
    }
}

impl TrembleConfig {
    /// Error of a joint at `time` \[s\].
    fn of(self, joint: usize, time: f64) -> f64 {
        self.amplitude * libm::sin(std::f64::consts::TAU * self.frequency * time - joint as f64)
    }
}

/// Thrust sensors, equal for all jets.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ThrustSensorConfig {
    /// Bias of every measurement \[N\].
    pub bias: f64,
    /// Standard deviation of white noise on every jet, drawn in every tick \[N\].
    #[schemars(range(min = 0))]
    pub noise_std: f64,
    /// Quantisation step of the measurement \[N\]; zero for none.
    #[schemars(range(min = 0))]
    pub resolution: f64,
    /// Age of the measurement, rounded to ticks \[s\].
    #[schemars(range(min = 0, max = 1))]
    pub delay: f64,
}

/// Converts a delay or a time ahead \[s\] to ticks.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 10 s
pub(crate) fn age(delay: f64, time_step: f64) -> usize {
    (delay / time_step).round() as usize
}

/// A position or thrust as a sensor with this step measures it \[rad, m, N\].
fn quantised(position: f64, step: f64) -> f64 {
    // Not divided by `step`, which XLA would replace by a multiplication: ties must be rounded alike in both languages.
    if step > 0.0 { step * (position * (1.0 / step)).round() } else { position }
}

/// The sensors with their state; read once per tick.
#[derive(Debug, Clone)]
pub struct Sensors {
    config: SensorsConfig,
    time_step: f64,
    /// Fraction of the difference that the low pass of joint velocities corrects per tick.
    share: f64,
    noise: Noise,
    gaps: Noise,
    noise_of_height: Noise,
    /// The last ticks, a ring buffer; `now` is the latest.
    line: Vec<Measurement>,
    now: usize,
    /// Number of readings so far.
    readings: u32,
    reading: Measurement,
    /// Positions and velocities of the joints between two ticks.
    joints: (Vec<f64>, Vec<f64>),
    /// Wind ahead: times after the tick, from zero on; empty without a preview \[s, m/s\].
    wind_ahead: Vec<(f64, Vector3<f64>)>,
}

impl Sensors {
    /// Sensors of a robot with the given numbers of joints and jets, read every `time_step` \[s\].
    ///
    /// # Errors
    /// [`BuildError`] naming the key with a value beyond its range; also where the biases of joints are not one for each.
    pub fn new(
        config: &SensorsConfig,
        time_step: f64,
        joints: usize,
        jets: usize,
    ) -> Result<Self, BuildError> {
        flight_core::schema::check(config, "simulator.sensors")?;
        let biases = config.joints.bias.len();
        if biases != 0 && biases != joints {
            let expected = format!("{joints}, one for each joint, or none");
            return Err(BuildError::bad_value(
                "simulator.sensors.joints.bias",
                format!("{biases} numbers"),
                expected,
            ));
        }
        let SensorsConfig {
            base_position, base_rotation, base_linear_velocity, base_angular_velocity, ..
        } = config;
        let of_base = [base_position, base_rotation, base_linear_velocity, base_angular_velocity];
        let delays =
            of_base.map(|sensor| sensor.delay).into_iter().chain([config.joints.delay, config.thrust.delay]);
        let delays = delays.chain(config.height.as_ref().map(|sensor| sensor.delay));
        let oldest = age(delays.fold(0.0, f64::max), time_step);
        let nothing = Measurement::zero(joints, jets, 0);
        let time_constant = config.joints.velocity_time_constant.unwrap_or(0.0);
        Ok(Self {
            config: config.clone(),
            time_step,
            share: share(time_step / time_constant),
            noise: Noise::new(config.seed, STREAM),
            gaps: Noise::new(config.seed, STREAM_OF_GAPS),
            noise_of_height: Noise::new(config.seed, STREAM_OF_HEIGHT),
            line: vec![nothing.clone(); oldest + 1],
            now: 0,
            readings: 0,
            reading: nothing,
            joints: (vec![0.0; joints], vec![0.0; joints]),
            wind_ahead: match age(config.wind_preview, time_step) {
                0 => Vec::new(),
                last => (0..=last).map(|tick| (tick as f64 * time_step, Vector3::zeros())).collect(),
            },
        })
    }

    /// Measures the wind ahead of `time` \[s\]: times after it and velocities \[s, m/s\]. Does not allocate.
    pub fn look_ahead(&mut self, wind: &Wind, time: f64) -> &[(f64, Vector3<f64>)] {
        for (after, velocity) in &mut self.wind_ahead {
            *velocity = wind.velocity(time + *after);
        }
        &self.wind_ahead
    }

    /// Reads the encoders `after` the last tick \[s\]: positions \[rad, m\], and velocities \[rad/s, m/s\], which are not
    /// finite if they are measured by a low pass of the ticks. Does not allocate.
    pub fn read_joints(&mut self, state: &RobotState, after: f64) -> (&[f64], &[f64]) {
        let Self { config, time_step, readings, joints: (positions, velocities), .. } = self;
        let time = f64::from(readings.saturating_sub(1)) * *time_step + after;
        let are_filtered = config.joints.velocity_time_constant.is_some();
        for (joint, position) in state.joint_position.iter().enumerate() {
            positions[joint] = config.joints.measured(joint, *position, time);
            velocities[joint] = if are_filtered { f64::NAN } else { state.velocity[6 + joint] };
        }
        (positions, velocities)
    }

    /// Replaces the true state, thrusts and height in `sample` by what the sensors read. Does not allocate.
    ///
    /// Until a delay has passed, the first state is measured; the low pass of the joints starts in its steady state.
    pub fn read(&mut self, sample: &mut Measurement) {
        let Self { config, time_step, line, reading, noise, gaps, .. } = self;
        let (is_started, time) = (self.readings > 0, f64::from(self.readings) * *time_step);
        self.now = (self.now + 1) % line.len();
        for (place, tick) in line.iter_mut().enumerate() {
            if place == self.now || !is_started {
                tick.state.copy_from(&sample.state);
                tick.thrust.copy_from_slice(&sample.thrust);
                tick.height = sample.height;
            }
        }
        let (now, length) = (self.now, line.len());
        let then = |delay: f64| &line[(now + length - age(delay, *time_step)) % length];
        let mut errors = |sensor: &SensorConfig| {
            let drawn = Vector3::from_fn(|_, _| noise.normal());
            Vector3::from(sensor.bias) + time * Vector3::from(sensor.drift) + sensor.noise_std * drawn
        };

        reading.state.base.position =
            then(config.base_position.delay).state.base.position + errors(&config.base_position);
        reading.state.base.rotation =
            then(config.base_rotation.delay).state.base.rotation * exp_so3(&errors(&config.base_rotation));
        let linear = then(config.base_linear_velocity.delay).state.base_linear_velocity()
            + errors(&config.base_linear_velocity);
        let turning = &then(config.base_angular_velocity.delay).state;
        let gyro = turning.base.rotation.transpose() * turning.base_angular_velocity()
            + errors(&config.base_angular_velocity);
        let angular = reading.state.base.rotation * gyro;
        let readings = self.readings as usize;
        let mut is_missing = |sensor: &SensorConfig| {
            let every = age(sensor.period, *time_step).max(1);
            // The first one begins the flight.
            !readings.is_multiple_of(every)
                || (sensor.gaps > 0.0 && gaps.uniform() < sensor.gaps && readings > 0)
        };
        if is_missing(&config.base_position) {
            reading.state.base.position.fill(f64::NAN);
        }
        if is_missing(&config.base_rotation) {
            reading.state.base.rotation.fill(f64::NAN);
        }
        let linear = if is_missing(&config.base_linear_velocity) { NONE } else { linear };
        let angular = if is_missing(&config.base_angular_velocity) { NONE } else { angular };
        reading.state.velocity.as_mut_slice()[..3].copy_from_slice(linear.as_slice());
        reading.state.velocity.as_mut_slice()[3..6].copy_from_slice(angular.as_slice());

        let joints = &then(config.joints.delay).state;
        let velocities = &mut reading.state.velocity.as_mut_slice()[6..];
        for (joint, velocity) in velocities.iter_mut().enumerate() {
            let before = reading.state.joint_position[joint];
            let position = config.joints.measured(joint, joints.joint_position[joint], time);
            reading.state.joint_position[joint] = position;
            let is_difference = is_started && config.joints.velocity_time_constant.is_some();
            *velocity = if is_difference {
                *velocity + self.share * ((position - before) / *time_step - *velocity)
            } else {
                joints.velocity[6 + joint]
            };
        }

        let thrusts = &then(config.thrust.delay).thrust;
        for (measured, thrust) in reading.thrust.iter_mut().zip(thrusts) {
            let exact = thrust + config.thrust.bias + config.thrust.noise_std * noise.normal();
            *measured = quantised(exact, config.thrust.resolution);
        }
        sample.state.copy_from(&reading.state);
        sample.thrust.copy_from_slice(&reading.thrust);
        sample.height = config.height.as_ref().map_or(f64::NAN, |sensor| {
            let is_due = readings.is_multiple_of(age(sensor.period, *time_step).max(1));
            let is_there = is_due && self.noise_of_height.uniform() >= sensor.gaps;
            let error = sensor.bias + sensor.noise_std * self.noise_of_height.normal();
            if is_there { then(sensor.delay).height + error } else { f64::NAN }
        });
        self.readings = self.readings.saturating_add(1);
    }
}
