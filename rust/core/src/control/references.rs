//! From autopilot commands to smooth references for centre of mass, attitude and their derivatives.
//!
//! Equations M43, M44, M47 and M48 of `docs/model.md`. Source: the published flight-control library.

use super::minimum_jerk::MinimumJerkFilter;
use super::mission::{AutopilotCommand, Mission};
use super::recorded::RecordedMotion;
use crate::error::{BuildError, check};
use crate::spatial::{project_to_so3, rotation_from_rpy, rpy_from_rotation, skew, vee_of_skew_part};
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// Steps, limits and smoothing times of the reference generator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceConfig {
    /// Step of the raw position per tick along base x and z (forward, vertical) \[m\].
    pub step_position: [f64; 2],
    /// Step of raw pitch and yaw per tick \[deg\].
    pub step_attitude_deg: [f64; 2],
    /// Greatest and smallest raw pitch \[deg\].
    pub pitch_limits_deg: [f64; 2],
    /// The forward step grows to `1 + turbo_boost` times itself.
    pub turbo_boost: f64,
    /// Growth of the boost per tick.
    pub turbo_ramp: f64,
    /// Smoothing time of the position \[s\].
    pub position_smoothing: f64,
    /// Smoothing time of the filter whose rate output is the jerk \[s\].
    pub acceleration_smoothing: f64,
    /// Smoothing time of the angular velocity \[s\].
    pub angular_velocity_smoothing: f64,
    /// Gain with which the smoothed attitude follows the raw one \[1/s\].
    pub attitude_gain: f64,
}

impl ReferenceConfig {
    /// Refuses times, steps and gains that mean nothing.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let positive = |name: &str, value: f64| {
            check(&format!("controller.references.{name}"), value, |x| x > 0.0, "a positive number")
                .map(|_| ())
        };
        positive("position_smoothing", self.position_smoothing)?;
        positive("acceleration_smoothing", self.acceleration_smoothing)?;
        positive("angular_velocity_smoothing", self.angular_velocity_smoothing)?;
        positive("turbo_ramp", self.turbo_ramp)?;
        let non_negative = |name: &str, value: f64| {
            check(&format!("controller.references.{name}"), value, |x| x >= 0.0, "a number ≥ 0").map(|_| ())
        };
        non_negative("turbo_boost", self.turbo_boost)?;
        non_negative("attitude_gain", self.attitude_gain)?;
        for step in self.step_position {
            non_negative("step_position", step)?;
        }
        for step in self.step_attitude_deg {
            non_negative("step_attitude_deg", step)?;
        }
        let [low, high] = self.pitch_limits_deg;
        check("controller.references.pitch_limits_deg[0]", low, |x| x <= high, "at most the upper limit")?;
        check("controller.references.pitch_limits_deg[1]", high, |_| true, "finite degrees")?;
        Ok(())
    }
}

/// Reference of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// Centre of mass \[m, inertial axes\].
    pub com_position: Vector3<f64>,
    /// Its velocity \[m/s\].
    pub com_velocity: Vector3<f64>,
    /// Its acceleration \[m/s²\].
    pub com_acceleration: Vector3<f64>,
    /// Its jerk \[m/s³\].
    pub com_jerk: Vector3<f64>,
    /// Desired base rotation `R_d`, inertial from desired base.
    pub rotation: Matrix3<f64>,
    /// Angular velocity of the desired base \[rad/s, desired base axes\].
    pub angular_velocity_b: Vector3<f64>,
    /// Its first derivative \[rad/s²\].
    pub angular_acceleration_b: Vector3<f64>,
    /// Its second derivative \[rad/s³\].
    pub angular_jerk_b: Vector3<f64>,
}

impl Reference {
    /// Standing still at a position and rotation.
    #[must_use]
    pub fn hold(com_position: Vector3<f64>, rotation: Matrix3<f64>) -> Self {
        let zero = Vector3::zeros();
        Self {
            com_position,
            com_velocity: zero,
            com_acceleration: zero,
            com_jerk: zero,
            rotation,
            angular_velocity_b: zero,
            angular_acceleration_b: zero,
            angular_jerk_b: zero,
        }
    }
}

/// Raw reference: moves by whole steps, before any smoothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawReference {
    /// Position of the centre of mass \[m\].
    pub position: Vector3<f64>,
    /// Roll, pitch, yaw of the base \[rad\].
    pub rpy: Vector3<f64>,
    /// Ticks' worth of turbo built up.
    turbo_ticks: u32,
}

impl RawReference {
    /// Starts where the robot is.
    #[must_use]
    pub fn new(position: Vector3<f64>, rpy: Vector3<f64>) -> Self {
        Self { position, rpy, turbo_ticks: 0 }
    }

    /// One tick of the published autopilot mapping, in flight (no foot on the ground).
    ///
    /// While turbo is commanded or left over, all other motions are ignored and the nose goes down.
    /// The published boost is a floating-point sum that ends at a rounding residue above zero, so
    /// that one more step is taken; the counter here takes that step by moving as long as boost was
    /// left *before* the tick.
    pub fn advance(&mut self, config: &ReferenceConfig, command: AutopilotCommand) {
        let full = (config.turbo_boost / config.turbo_ramp).round();
        let (mut forward, mut vertical, mut pitch, mut yaw) = (
            f64::from(command.forward),
            f64::from(command.vertical),
            f64::from(command.pitch),
            f64::from(command.yaw),
        );
        if command.turbo || self.turbo_ticks > 0 {
            let left_over = self.turbo_ticks > 0;
            if command.turbo {
                if f64::from(self.turbo_ticks) < full {
                    self.turbo_ticks += 1;
                }
            } else {
                self.turbo_ticks -= 1;
            }
            forward = if self.turbo_ticks > 0 || left_over { -1.0 } else { 0.0 };
            vertical = 0.0;
            yaw = 0.0;
            pitch = -1.0;
        }
        let boost = f64::from(self.turbo_ticks) * config.turbo_ramp;
        let [step_forward, step_vertical] = config.step_position;
        let [step_pitch, step_yaw] = config.step_attitude_deg;
        self.rpy.y += step_pitch.to_radians() * pitch;
        self.rpy.z += step_yaw.to_radians() * yaw;
        let step = Vector3::new(step_forward * (1.0 + boost) * forward, 0.0, step_vertical * vertical);
        self.position += Rotation3::from_euler_angles(0.0, 0.0, self.rpy.z) * step;
        let [low, high] = config.pitch_limits_deg.map(f64::to_radians);
        self.rpy.y = self.rpy.y.clamp(low, high);
    }
}

/// Turns autopilot commands into a [`Reference`] every tick.
#[derive(Debug, Clone)]
pub struct ReferenceGenerator {
    config: ReferenceConfig,
    time_step: f64,
    raw: RawReference,
    position_filter: MinimumJerkFilter,
    jerk_filter: MinimumJerkFilter,
    angular_velocity_filter: MinimumJerkFilter,
    rotation: Matrix3<f64>,
}

impl ReferenceGenerator {
    /// Starts at the centre of mass and the roll, pitch, yaw that the robot has at its first tick.
    #[must_use]
    pub fn new(config: &ReferenceConfig, time_step: f64, com: Vector3<f64>, rpy: Vector3<f64>) -> Self {
        let zero = Vector3::zeros();
        Self {
            config: config.clone(),
            time_step,
            raw: RawReference::new(com, rpy),
            position_filter: MinimumJerkFilter::new(config.position_smoothing, time_step, com),
            jerk_filter: MinimumJerkFilter::new(config.acceleration_smoothing, time_step, zero),
            angular_velocity_filter: MinimumJerkFilter::new(
                config.angular_velocity_smoothing,
                time_step,
                zero,
            ),
            rotation: rotation_from_rpy(&rpy),
        }
    }

    /// Raw reference of the last tick.
    #[must_use]
    pub fn raw(&self) -> &RawReference {
        &self.raw
    }

    /// Reference of the tick at `time` \[s\].
    ///
    /// The smoothed attitude follows the raw one by `ω = −K sk(R_refᵀ R)^∨`, forward Euler on the
    /// matrix; its projection back onto SO(3) every tick removes the drift of that step.
    ///
    /// A recording is followed as it is; only its angular velocity passes through the filter, whose
    /// outputs are the derivatives that a recording does not have.
    pub fn update(&mut self, mission: &Mission, time: f64) -> Reference {
        let commands = match mission {
            Mission::Commands(commands) => commands,
            Mission::Recorded(recording) => return self.follow(&recording.at(time)),
        };
        self.raw.advance(&self.config, commands.command(time));

        let position = self.position_filter.update(&self.raw.position);
        let acceleration = self.jerk_filter.update(&position.acceleration);

        let rotation = self.rotation;
        let error = vee_of_skew_part(&(rotation_from_rpy(&self.raw.rpy).transpose() * rotation));
        let omega = -self.config.attitude_gain * error;
        let angular = self.angular_velocity_filter.update(&omega);
        self.rotation = project_to_so3(&(rotation + rotation * skew(&omega) * self.time_step));

        Reference {
            com_position: position.value,
            com_velocity: position.rate,
            com_acceleration: position.acceleration,
            com_jerk: acceleration.rate,
            rotation,
            angular_velocity_b: angular.value,
            angular_acceleration_b: angular.rate,
            angular_jerk_b: angular.acceleration,
        }
    }

    fn follow(&mut self, motion: &RecordedMotion) -> Reference {
        let [com_position, com_velocity, com_acceleration, com_jerk] = motion.com;
        let angular = self.angular_velocity_filter.update(&motion.angular_velocity_b);
        self.raw = RawReference::new(com_position, rpy_from_rotation(&motion.rotation));
        self.rotation = motion.rotation;
        Reference {
            com_position,
            com_velocity,
            com_acceleration,
            com_jerk,
            rotation: motion.rotation,
            angular_velocity_b: angular.value,
            angular_acceleration_b: angular.rate,
            angular_jerk_b: angular.acceleration,
        }
    }
}
