//! Set-point generation: from autopilot commands to smooth set-points of centre of mass and attitude, with
//! derivatives.
//!
//! Commands move a raw set-point at constant speeds. Minimum-jerk filters smooth its position, a first-order law its
//! attitude. The raw attitude is that of the *heading frame*: forward, left, up, fixed to the base by the robot's
//! forward axis. Its pitch is positive nose down.
//!
//! Equations M43, M44, M47, M48, M107, M115 and M182 of `docs/model`. Source: the published flight-control library, whose
//! steps per tick of 10 ms are speeds here.

use super::minimum_jerk::{FilterState, MinimumJerkFilter};
use super::mission::{AutopilotCommand, Mission};
use super::recorded::RecordedMotion;
use crate::control::measure::greatest::{Jumps, MAGNITUDES};
use crate::error::{BuildError, Table};
use crate::schema;
use crate::spatial::{
    GREATEST, axis_angle, exp_so3, is_rotation, log_so3, project_to_so3, rotation_from_rpy,
    rpy_from_rotation, skew, vee_of_skew_part,
};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Relative increase of the forward speed by the turbo command, which grows to ten times itself, and its growth \[1/s\], as
/// published.
const TURBO_BOOST: f64 = 9.0;
const TURBO_RATE: f64 = 2.0;

/// Smoothing times of the position, of the filter whose rate output is the jerk, and of the angular velocity \[s\], as
/// published.
const POSITION_SMOOTHING: f64 = 1.5;
const ACCELERATION_SMOOTHING: f64 = 0.005;
const ANGULAR_VELOCITY_SMOOTHING: f64 = 0.05;

/// Gain with which the smoothed attitude follows the raw one \[1/s\], as published.
const ATTITUDE_GAIN: f64 = 1.0;

/// Height above the ground \[m\] below which a landing descends slowly, and its greatest speed there \[m/s\]: from higher speeds
/// an arm engine's loss is not landed. A set-point at 0.75 m/s is 0.6 m ahead. Source: ours, the sweep `robot_landing_loss`.
const LANDING_HEIGHT: f64 = 2.5;
const LANDING_SPEED: f64 = 0.2;

/// Speeds and limits of the set-point generator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SetpointConfig {
    /// Forward and vertical speed of the raw position \[m/s\].
    #[schemars(inner(range(min = 0)))]
    pub speed: [f64; 2],
    /// Rates of raw pitch and yaw \[deg/s\].
    #[schemars(inner(range(min = 0)))]
    pub attitude_rate_deg: [f64; 2],
    /// Least and greatest raw pitch, positive nose down \[deg\].
    pub nose_down_limits_deg: [f64; 2],
    /// Speed of the descent after the mission has been abandoned \[m/s\].
    #[serde(default = "half_a_metre_per_second")]
    #[schemars(range(min = 0))]
    pub descent_speed: f64,
    /// Deceleration to the velocity of the descent, or to rest without a valid set-point \[m/s²\].
    #[serde(default = "deceleration_of_the_boost")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub deceleration: f64,
}

fn half_a_metre_per_second() -> f64 {
    0.5
}

/// `speed` times [`TURBO_RATE`] of the published flight, the deceleration at the end of its boost.
fn deceleration_of_the_boost() -> f64 {
    1.5
}

impl SetpointConfig {
    /// Refuses values beyond their range.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        schema::check(self, "controller.setpoint")?;
        let table = Table("controller.setpoint");
        let [low, high] = self.nose_down_limits_deg;
        table.check("nose_down_limits_deg[0]", low, |x| x <= high, "at most the upper limit")
    }
}

/// Set-point of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint {
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

impl Setpoint {
    /// A set-point at rest at a position and rotation.
    #[must_use]
    pub fn at_rest(com_position: Vector3<f64>, rotation: Matrix3<f64>) -> Self {
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

    /// Set-point without position control: the centre of mass is the present one \[m\], without acceleration or jerk
    /// (M107 of `docs/model`).
    #[must_use]
    pub fn without_place(&self, com: &Vector3<f64>) -> Self {
        let zero = Vector3::zeros();
        Self { com_position: *com, com_acceleration: zero, com_jerk: zero, ..*self }
    }

    /// Set-point with the heading of a `base` (M107).
    #[must_use]
    pub fn with_heading_of(&self, base: &Matrix3<f64>) -> Self {
        Self { rotation: turn_to(&self.rotation, base).0 * self.rotation, ..*self }
    }

    /// Whether a robot whose state is accepted can follow this set-point: position and velocities are
    /// within that range, the acceleration changes the velocity by at most its range in a second, all other
    /// derivatives are at most 10⁶ (m, rad, s), and the matrix is a rotation.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let Jumps { position, velocity, angular_velocity, .. } = MAGNITUDES;
        let limits = [position, velocity, velocity, GREATEST, angular_velocity, GREATEST, GREATEST];
        let mut vectors = self.vectors().into_iter().zip(limits);
        vectors.all(|(vector, most)| vector.iter().all(|x| x.abs() <= most)) && is_rotation(&self.rotation)
    }

    /// Position of the centre of mass and its derivatives, then angular velocity and its derivatives.
    #[must_use]
    pub fn vectors(&self) -> [&Vector3<f64>; 7] {
        [
            &self.com_position,
            &self.com_velocity,
            &self.com_acceleration,
            &self.com_jerk,
            &self.angular_velocity_b,
            &self.angular_acceleration_b,
            &self.angular_jerk_b,
        ]
    }

    /// The set-point of a motion, with the derivatives that a recording does not have.
    fn of_motion(
        motion: &RecordedMotion,
        angular_acceleration_b: Vector3<f64>,
        angular_jerk_b: Vector3<f64>,
    ) -> Self {
        let [com_position, com_velocity, com_acceleration, com_jerk] = motion.com;
        let RecordedMotion { rotation, angular_velocity_b, .. } = *motion;
        Self {
            com_position,
            com_velocity,
            com_acceleration,
            com_jerk,
            rotation,
            angular_velocity_b,
            angular_acceleration_b,
            angular_jerk_b,
        }
    }

    /// The set-point a short time \[s\] later, by its derivatives: the motion that it describes goes on (M151).
    #[must_use]
    pub fn after(&self, time: f64) -> Self {
        let (half, sixth) = (time * time / 2.0, time * time * time / 6.0);
        let [p, v, a, j, w, dw, ddw] = self.vectors();
        Self {
            com_position: p + v * time + a * half + j * sixth,
            com_velocity: v + a * time + j * half,
            com_acceleration: a + j * time,
            com_jerk: *j,
            rotation: self.rotation * exp_so3(&(w * time + dw * half + ddw * sixth)),
            angular_velocity_b: w + dw * time + ddw * half,
            angular_acceleration_b: dw + ddw * time,
            angular_jerk_b: *ddw,
        }
    }

    /// The set-point at the share `s` of the way to another one, `h` \[s\] later: as between samples of a recording
    /// (M49), the other derivatives linear.
    #[must_use]
    pub fn interpolate(&self, other: &Self, h: f64, s: f64) -> Self {
        let turn_b = log_so3(&(self.rotation.transpose() * other.rotation));
        Self::of_motion(
            &self.motion().interpolate(&other.motion(), &turn_b, h, s),
            self.angular_acceleration_b.lerp(&other.angular_acceleration_b, s),
            self.angular_jerk_b.lerp(&other.angular_jerk_b, s),
        )
    }

    /// Its motion, without the derivatives that a recording does not have.
    #[must_use]
    pub fn motion(&self) -> RecordedMotion {
        RecordedMotion {
            com: [self.com_position, self.com_velocity, self.com_acceleration, self.com_jerk],
            rotation: self.rotation,
            angular_velocity_b: self.angular_velocity_b,
        }
    }
}

/// The rotation about the vertical, and its angle \[rad\], that turns an attitude nearest to another one (M107).
fn turn_to(from: &Matrix3<f64>, to: &Matrix3<f64>) -> (Matrix3<f64>, f64) {
    let between = to * from.transpose();
    let angle = libm::atan2(between[(1, 0)] - between[(0, 1)], between[(0, 0)] + between[(1, 1)]);
    (axis_angle(&Vector3::z(), angle), angle)
}

/// Raw set-point before smoothing. It moves at constant speeds, brakes, or leads a given motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawSetpoint {
    /// Position of the centre of mass \[m\].
    pub position: Vector3<f64>,
    /// Its velocity \[m/s\].
    pub velocity: Vector3<f64>,
    /// Roll, pitch (nose down) and yaw of the heading frame \[rad\].
    pub rpy: Vector3<f64>,
    /// Boost, in ticks of growth.
    turbo_ticks: u32,
}

/// State of the set-point generator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetpointState {
    raw: RawSetpoint,
    position: FilterState,
    /// Filter of the acceleration; its rate is the jerk.
    acceleration: FilterState,
    angular_velocity: FilterState,
    /// Smoothed attitude of the base.
    rotation: Matrix3<f64>,
    /// Height of the centre of mass at touch-down \[m\]: that at the first tick, until a height above the ground is measured;
    /// `−∞` where neither is known, after a flight that began again.
    pub(in crate::control) ground: f64,
    /// Raw set-point of the mission when a descent began, from which it goes on where the descent is revoked.
    abandoned: Option<RawSetpoint>,
}

impl SetpointState {
    /// Raw set-point of the last tick.
    #[must_use]
    pub fn raw(&self) -> &RawSetpoint {
        &self.raw
    }

    /// Turns the raw and the smoothed attitude to the heading of a `base` (M107).
    pub fn take_heading(&mut self, base: &Matrix3<f64>) {
        let (turn, angle) = turn_to(&self.rotation, base);
        self.raw.rpy.z += angle;
        self.rotation = turn * self.rotation;
    }

    /// Raises the raw position to a height \[m\] if it is lower, because of the ground.
    pub(in crate::control) fn keep_above(&mut self, height: f64) {
        self.raw.position.z = self.raw.position.z.max(height);
    }
}

/// What a set-point follows after this tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ahead {
    /// The mission.
    Mission,
    /// The motion of the last given set-point: its raw position moves on at constant velocity.
    Motion,
    /// The descent.
    Descent,
    /// Braking to rest.
    Stop,
}

/// Converts the commands of a mission to a [`Setpoint`] every tick; its state is a [`SetpointState`].
#[derive(Debug, Clone)]
pub struct SetpointGenerator {
    config: SetpointConfig,
    mission: Mission,
    time_step: f64,
    /// Rotation, base from heading: its columns are forward, left, up.
    base_from_heading: Matrix3<f64>,
    /// Number of ticks in which the boost grows to its full value.
    full_boost: u32,
    position_filter: MinimumJerkFilter,
    acceleration_filter: MinimumJerkFilter,
    angular_velocity_filter: MinimumJerkFilter,
}

impl SetpointGenerator {
    /// Builds a generator with the tick `time_step` \[s\] for a robot whose forward direction is `forward_axis_b`, a
    /// unit vector orthogonal to base z.
    ///
    /// # Errors
    /// As [`SetpointConfig::check`] and [`Commands::check`](super::mission::Commands::check).
    pub fn new(
        config: &SetpointConfig,
        mission: Mission,
        forward_axis_b: &Vector3<f64>,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        config.check()?;
        if let Mission::Commands(commands) = &mission {
            commands.check()?;
        }
        let up = Vector3::z();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // positive; saturates
        let full_boost = (TURBO_BOOST / (TURBO_RATE * time_step)).round() as u32;
        Ok(Self {
            mission,
            time_step,
            base_from_heading: Matrix3::from_columns(&[*forward_axis_b, up.cross(forward_axis_b), up]),
            full_boost,
            position_filter: MinimumJerkFilter::new(POSITION_SMOOTHING, time_step),
            acceleration_filter: MinimumJerkFilter::new(ACCELERATION_SMOOTHING, time_step),
            angular_velocity_filter: MinimumJerkFilter::new(ANGULAR_VELOCITY_SMOOTHING, time_step),
            config: config.clone(),
        })
    }

    /// Speed of the descent \[m/s\].
    pub(in crate::control) fn descent_speed(&self) -> f64 {
        self.config.descent_speed
    }

    /// State of a mission that starts at the given centre of mass and base rotation.
    #[must_use]
    pub fn start(&self, com: Vector3<f64>, rotation: &Matrix3<f64>) -> SetpointState {
        let rest = FilterState::at_rest(Vector3::zeros());
        SetpointState {
            raw: RawSetpoint {
                position: com,
                velocity: Vector3::zeros(),
                rpy: self.heading_rpy(rotation),
                turbo_ticks: 0,
            },
            position: FilterState::at_rest(com),
            acceleration: rest,
            angular_velocity: rest,
            rotation: *rotation,
            ground: com.z,
            abandoned: None,
        }
    }

    /// Pitch of the heading frame of a base rotation, positive nose down \[deg\], and the limits into which commands
    /// turn a set-point that starts there; `None` if it is within them, and for a recording, which has none.
    #[must_use]
    pub fn pitch_beyond_limits(&self, rotation: &Matrix3<f64>) -> Option<(f64, [f64; 2])> {
        const NEGLIGIBLE: f64 = 1e-3; // deg: a base that turns may pitch by less before the first set-point
        let pitch = self.heading_rpy(rotation).y.to_degrees();
        let [low, high] = self.config.nose_down_limits_deg;
        let is_within = (low - NEGLIGIBLE..=high + NEGLIGIBLE).contains(&pitch);
        (!is_within && matches!(self.mission, Mission::Commands(_))).then_some((pitch, [low, high]))
    }

    /// Set-point of the tick at `time` \[s\].
    ///
    /// The smoothed attitude follows the raw one by `ω = −K sk(R_rawᵀ R)^∨`, integrated by forward Euler on the
    /// matrix; its projection onto SO(3) in every tick removes the drift.
    ///
    /// A recording is followed directly; only its angular velocity passes through the filter, which provides the
    /// derivatives that a recording does not have.
    #[must_use]
    pub fn update(&self, state: &mut SetpointState, time: f64) -> Setpoint {
        match &self.mission {
            Mission::Commands(commands) => {
                self.advance_raw(&mut state.raw, state.ground, commands.command(time));
                self.smooth(state)
            }
            Mission::Recorded(recording) => {
                let motion = recording.at(time);
                self.take_motion(state, &motion);
                let turning = &state.angular_velocity;
                Setpoint {
                    angular_velocity_b: turning.value(),
                    ..Setpoint::of_motion(&motion, turning.rate(), turning.acceleration())
                }
            }
        }
    }

    /// Sets the state to that of a given motion, from which a stop or a descent would start.
    pub fn take_motion(&self, state: &mut SetpointState, motion: &RecordedMotion) {
        let [position, velocity, acceleration, jerk] = motion.com;
        let outputs = [position, velocity, acceleration];
        let (raw_position, raw_velocity) = self.position_filter.input_of(outputs);
        self.angular_velocity_filter.update(&mut state.angular_velocity, &motion.angular_velocity_b);
        state.raw = RawSetpoint {
            position: raw_position,
            velocity: raw_velocity,
            rpy: self.heading_rpy(&motion.rotation),
            turbo_ticks: 0,
        };
        state.rotation = motion.rotation;
        state.position = FilterState::from_outputs(outputs, raw_position);
        state.acceleration = FilterState::from_outputs([acceleration, jerk, Vector3::zeros()], acceleration);
    }

    /// Set-point of a tick of the descent, which replaces the mission: level, with a velocity that approaches that of
    /// the descent, or zero if the robot `stays` (M115).
    #[must_use]
    pub fn descend(&self, state: &mut SetpointState, stays: bool) -> Setpoint {
        state.abandoned.get_or_insert(state.raw);
        let raw = &mut state.raw;
        let step = self.config.attitude_rate_deg[0].to_radians() * self.time_step;
        for angle in raw.rpy.iter_mut().take(2) {
            *angle -= angle.clamp(-step, step);
        }
        let speed = if stays { 0.0 } else { self.config.descent_speed };
        self.approach(raw, &Vector3::new(0.0, 0.0, -speed));
        self.smooth(state)
    }

    /// Goes on with the mission after a descent: from the position and velocity of the centre of mass \[m, m/s\], which had no
    /// set-point meanwhile (M107), and to the attitude and boost that the mission had when it was abandoned (M182).
    pub fn resume(&self, state: &mut SetpointState, com: &Vector3<f64>, velocity: &Vector3<f64>) {
        let Some(abandoned) = state.abandoned.take() else { return };
        let outputs = [*com, *velocity, Vector3::zeros()];
        let (position, _) = self.position_filter.input_of(outputs);
        state.position = FilterState::from_outputs(outputs, position);
        state.acceleration = FilterState::at_rest(Vector3::zeros());
        state.raw = RawSetpoint { position, ..abandoned };
    }

    /// Set-point of a tick without a valid one: the robot comes to rest (M115).
    #[must_use]
    pub fn stop(&self, state: &mut SetpointState) -> Setpoint {
        self.approach(&mut state.raw, &Vector3::zeros());
        self.smooth(state)
    }

    /// Set-point of a later tick, at `time` \[s\]: `state` is a copy of the state, advanced by all ticks before it.
    #[must_use]
    pub(crate) fn ahead(&self, ahead: Ahead, state: &mut SetpointState, time: f64) -> Setpoint {
        match ahead {
            Ahead::Mission => self.update(state, time),
            Ahead::Descent => self.descend(state, false),
            Ahead::Stop => self.stop(state),
            Ahead::Motion => {
                state.raw.position += state.raw.velocity * self.time_step;
                self.smooth(state)
            }
        }
    }

    /// Advances the raw position with a velocity that approaches `velocity`.
    fn approach(&self, raw: &mut RawSetpoint, velocity: &Vector3<f64>) {
        raw.turbo_ticks = 0;
        raw.velocity += (velocity - raw.velocity).cap_magnitude(self.config.deceleration * self.time_step);
        raw.position += raw.velocity * self.time_step;
    }

    /// Roll, pitch and yaw of the heading frame of a base rotation \[rad\].
    fn heading_rpy(&self, rotation: &Matrix3<f64>) -> Vector3<f64> {
        rpy_from_rotation(&(rotation * self.base_from_heading))
    }

    /// One tick of the published autopilot mapping, in flight (no foot on the ground), over a `ground` at which the centre of
    /// mass touches down \[m\]; only a landing, which is ours, depends on it (M43).
    ///
    /// While the boost is commanded or has not decayed, all other motions are ignored and the nose goes down. The
    /// published boost is a floating-point sum that ends at a rounding residue above zero, which adds one more step.
    /// The counter here takes this step by moving as long as boost was left *before* the tick.
    fn advance_raw(&self, raw: &mut RawSetpoint, ground: f64, command: AutopilotCommand) {
        let config = &self.config;
        let mut forward = f64::from(command.forward);
        let mut vertical = f64::from(command.vertical);
        let (mut nose_down, mut yaw) = (f64::from(command.nose_down), f64::from(command.yaw));
        if command.turbo || raw.turbo_ticks > 0 {
            if command.turbo {
                raw.turbo_ticks = (raw.turbo_ticks + 1).min(self.full_boost);
            } else {
                raw.turbo_ticks -= 1;
            }
            (forward, vertical, nose_down, yaw) = (1.0, 0.0, 1.0, 0.0);
        }
        let boost = f64::from(raw.turbo_ticks) * (TURBO_RATE * self.time_step);
        let [speed_forward, mut speed_vertical] = config.speed;
        // A ground that is not known may be near.
        if command.lands && (!ground.is_finite() || raw.position.z - ground < LANDING_HEIGHT) {
            speed_vertical = speed_vertical.min(LANDING_SPEED);
        }
        let [rate_pitch, rate_yaw] = config.attitude_rate_deg.map(|rate| rate.to_radians() * self.time_step);
        let [low, high] = config.nose_down_limits_deg.map(f64::to_radians);
        raw.rpy.y = (raw.rpy.y + rate_pitch * nose_down).clamp(low, high);
        raw.rpy.z += rate_yaw * yaw;
        let velocity = Vector3::new(speed_forward * (1.0 + boost) * forward, 0.0, speed_vertical * vertical);
        raw.velocity = axis_angle(&Vector3::z(), raw.rpy.z) * velocity;
        raw.position += raw.velocity * self.time_step;
    }

    /// Computes the smooth set-point that follows the raw one.
    fn smooth(&self, state: &mut SetpointState) -> Setpoint {
        self.position_filter.update(&mut state.position, &state.raw.position);
        self.acceleration_filter.update(&mut state.acceleration, &state.position.acceleration());

        let rotation = state.rotation;
        let raw_rotation = rotation_from_rpy(&state.raw.rpy) * self.base_from_heading.transpose();
        let omega = -ATTITUDE_GAIN * vee_of_skew_part(&(raw_rotation.transpose() * rotation));
        self.angular_velocity_filter.update(&mut state.angular_velocity, &omega);
        state.rotation = project_to_so3(&(rotation + rotation * skew(&omega) * self.time_step));

        Setpoint {
            com_position: state.position.value(),
            com_velocity: state.position.rate(),
            com_acceleration: state.position.acceleration(),
            com_jerk: state.acceleration.rate(),
            rotation,
            angular_velocity_b: state.angular_velocity.value(),
            angular_acceleration_b: state.angular_velocity.rate(),
            angular_jerk_b: state.angular_velocity.acceleration(),
        }
    }
}
