//! Channels of the measurement: missing or implausible values are replaced by predictions.
//!
//! The model advances the last value of every channel to this tick ([`ChannelsState::predict`]). A measured value is
//! used if it is finite and within its accepted range; for wind, joints and base it must also be near the prediction,
//! and for joints and base not frozen, that is, with the same bits for several ticks while the prediction moves away.
//! Otherwise the prediction is used, and the age of the channel grows. The first measurements of a flight may be the wrong
//! ones, and later the prediction: where more of the following ones contradict it, and agree with each other, than it rests
//! on, or as many as may be missing before the robot descends, the flight begins again from them.
//!
//! ```text
//! wind              its last value, which fades to zero
//! feet              the wrenches that keep them at rest in the model
//! thrusts           as the jets follow their commands
//! joints and base   a step of the model with the last torques and the observed wrench
//! height            that of the base
//! ```
//!
//! A base velocity that is not measured, and not just between two measurements, follows the differences of the pose, if
//! the pose is measured.
//!
//! Equations M101 to M103 and M141 of `docs/model`.

mod state;

pub use state::ChannelsState;

use super::greatest::{self, Jumps};
use super::measurement::{BETWEEN_MAX, BadStart, Channel, Estimate, Measurement, Sampling};
use crate::control::acting::Acting;
use crate::control::limits::Descent;
use crate::control::modes::Modes;
use crate::jets::{EngineModel, JetModel};
use crate::kinematics::RobotState;
use crate::robot::RobotModel;
use crate::spatial::{exp_so3, is_rotation, vee_of_skew_part};
use crate::timing::{is_longer, share};
use nalgebra::{DVector, Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use state::{Record, bound, time_is_plausible};
use std::slice::from_mut;

/// Which measurements are accepted, and what replaces the others.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelsConfig {
    /// Whether differences from the prediction beyond `Jumps::GREATEST` are refused. Without it all differences are
    /// accepted, no value counts as frozen and no time step as wrong.
    pub jump: bool,
}

/// Fraction of [`Jumps`] by which a value must differ from the prediction to count as frozen.
const FROZEN_SHARE: f64 = 0.02;

/// Number of ticks with the same bits after which a value may count as frozen.
const FROZEN_TICKS: u32 = 5;

/// Share of [`Jumps`] within which the second measurement confirms the first, and a first joint position may be beyond
/// its stops: less than a wrong first measurement can do harm with, more than noise of sensors.
const CONFIRMATION: f64 = 0.2;

/// Relative growth of [`Jumps`] with the age of a channel \[1/s\]: predictions drift.
const WIDENING: f64 = 1.0;

/// Time for which the last wind is held \[s\].
const WIND_HOLD: f64 = 1.0;

/// Time in which the wind fades to zero after it was held \[s\].
const WIND_FADE: f64 = 2.0;

/// Age of a channel of joints or base above which the robot levels and descends, to the end of the flight unless it begins
/// again \[s\].
const DESCEND_AFTER: f64 = 3.0;

/// Gain with which a base velocity that is not measured follows the differences of the pose \[1/s\].
const VELOCITY_GAIN: f64 = 100.0;

/// The channels of one controller.
#[derive(Debug, Clone)]
pub struct Channels {
    /// Whether jumps are refused.
    refuses_jumps: bool,
    time_step: f64,
    /// Greatest number of measurements that a prediction rests on.
    support_max: u32,
    parts: Vec<Channel>,
    jets: Vec<JetModel>,
    engines: Vec<EngineModel>,
    /// Greatest accepted magnitude of each number, and difference from its prediction.
    greatest: Measurement,
    jump: Measurement,
    /// Whether joint velocities must be measured; a joint observer estimates them from positions.
    needs_joint_velocity: bool,
    /// Range of each joint position in which a flight can begin \[rad, m\].
    ranges: Vec<(f64, f64)>,
}

/// A set of numbers with the same one in each channel of a kind.
fn limits(robot: &RobotModel, thrust: impl Fn(f64) -> f64, foot: [f64; 2], of: &Jumps) -> Measurement {
    let joints = robot.joints.len();
    let mut limits = Measurement::zero(joints, robot.jets.len(), robot.feet.len());
    for (to, jet) in limits.thrust.iter_mut().zip(&robot.jets) {
        *to = thrust(jet.thrust_max);
    }
    limits.wind.fill(of.wind);
    limits.height = of.height;
    let RobotState { base, joint_position, velocity } = &mut limits.state;
    joint_position.fill(of.joint_position);
    velocity.rows_mut(0, 3).fill(of.velocity);
    velocity.rows_mut(3, 3).fill(of.angular_velocity);
    velocity.rows_mut(6, joints).fill(of.joint_velocity);
    base.position.fill(of.position);
    base.rotation.fill(of.rotation);
    for (index, to) in limits.foot_wrenches.iter_mut().enumerate() {
        *to = foot[usize::from(index % 6 >= 3)];
    }
    limits
}

impl Channels {
    /// Channels of the jets, joints and feet of `robot`, at the tick `time_step` \[s\]. Joint velocities that are
    /// neither needed nor measured count as zero.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few thousand
    pub fn new(
        config: ChannelsConfig,
        robot: &RobotModel,
        models: Vec<JetModel>,
        time_step: f64,
        needs_joint_velocity: bool,
    ) -> Self {
        let near = if config.jump { Jumps::GREATEST } else { Jumps::NONE };
        let beyond = CONFIRMATION * near.joint_position;
        let stops = robot.joints.iter().map(|joint| joint.stops);
        let foot = [greatest::FOOT_FORCE, greatest::FOOT_MOMENT];
        let channels = [Channel::Wind].into_iter().chain((0..robot.jets.len()).map(Channel::Thrust));
        Self {
            refuses_jumps: config.jump,
            time_step,
            support_max: (DESCEND_AFTER / time_step) as u32,
            parts: channels
                .chain([
                    Channel::Joints,
                    Channel::LinearVelocity,
                    Channel::AngularVelocity,
                    Channel::Position,
                    Channel::Rotation,
                    Channel::Feet,
                    Channel::Height,
                ])
                .collect(),
            jets: models,
            engines: robot.jets.iter().map(|jet| jet.engine).collect(),
            greatest: limits(robot, |most| greatest::THRUST * most, foot, &greatest::MAGNITUDES),
            jump: limits(robot, |_| f64::INFINITY, [f64::INFINITY; 2], &near),
            needs_joint_velocity,
            ranges: stops.map(|(lower, upper)| (lower - beyond, upper + beyond)).collect(),
        }
    }

    /// Place of a channel after the thrusts, counted from that of the joints.
    fn place(&self, after_joints: usize) -> usize {
        1 + self.jets.len() + after_joints
    }

    /// Places of the linear and the angular velocity of the base.
    fn velocities(&self) -> [usize; 2] {
        [self.place(1), self.place(2)]
    }

    /// Whether a measurement has the sizes of this robot.
    #[must_use]
    pub fn fit(&self, measurement: &Measurement) -> bool {
        let (joints, feet) = (self.ranges.len(), self.greatest.foot_wrenches.len());
        let jets = self.jets.len();
        measurement.state.n_joints() == joints
            && measurement.state.velocity.len() == 6 + joints
            && measurement.thrust.len() == jets
            && [0, jets].contains(&measurement.shaft_speed.len())
            && (feet == 0 || measurement.foot_wrenches.len() == feet)
    }

    /// Whether thrusts can have these rates \[N/s\].
    #[must_use]
    pub fn accept_rates(&self, rates: &[f64]) -> bool {
        rates.iter().zip(&self.greatest.thrust).all(|(rate, most)| rate.abs() <= greatest::THRUST_RATE * most)
    }

    /// The state before the first tick, and what is known of the robot then.
    ///
    /// # Errors
    /// [`BadStart`] for a measurement that no flight can begin with.
    pub fn start(
        &self,
        measurement: &Measurement,
        mut estimate: Estimate,
    ) -> Result<(ChannelsState, Estimate), BadStart> {
        let (joints, jets, feet) =
            (self.ranges.len(), self.jets.len(), self.greatest.foot_wrenches.len() / 6);
        if !self.fit(measurement) {
            return Err(BadStart::OtherRobot { joints, jets, feet });
        }
        let bad = |name, value, expected| Err(BadStart::BadValue { name, value, expected });
        if !time_is_plausible(measurement.time) {
            return bad("time", measurement.time, "0 to 1e9 s");
        }
        let mut speeds = measurement.shaft_speed.iter().zip(&self.engines);
        if let Some((speed, _)) =
            speeds.find(|(speed, engine)| !speed.is_nan() && !matches!(engine, EngineModel::Shaft(_)))
        {
            return bad("shaft_speed", *speed, "NaN, or none, without controller.shaft");
        }
        self.read(measurement, &mut estimate);
        let now = &mut estimate.robot;
        if !now.is_measured(Channel::Wind) {
            now.wind.fill(0.0); // not measured: still air until it is
        }
        // A robot need not measure its height.
        for channel in self.parts.iter().filter(|channel| **channel != Channel::Height) {
            for (run, numbers) in now.numbers(*channel).into_iter().enumerate() {
                if let Some(value) = numbers.iter().find(|number| !number.is_finite()) {
                    return bad(channel.name(run), *value, "a finite number");
                }
            }
        }
        if !is_rotation(&measurement.state.base.rotation) {
            return Err(BadStart::NoRotation);
        }
        if self.refuses_jumps {
            self.check_ranges(now)?;
        }
        // Where wind, thrusts, foot wrenches or height cannot be accepted: none, until they are.
        for channel in self.parts.iter().filter(|channel| !channel.is_vital()) {
            if !self.is_within(now, *channel) {
                let none = if *channel == Channel::Height { f64::NAN } else { 0.0 };
                now.numbers_mut(*channel).into_iter().for_each(|numbers| numbers.fill(none));
            }
        }
        let state = ChannelsState {
            records: vec![Record::default(); self.parts.len()],
            last: now.clone(),
            predicted: now.clone(),
            jet_rate: DVector::zeros(jets),
            clock_offset: 0.0,
            is_begun: false,
        };
        Ok((state, estimate))
    }

    /// Whether joints and base are where a flight can begin.
    fn check_ranges(&self, now: &Measurement) -> Result<(), BadStart> {
        for channel in self.parts.iter().filter(|channel| channel.is_vital()) {
            let runs = now.numbers(*channel).into_iter().zip(self.greatest.numbers(*channel));
            for (run, (numbers, greatest)) in runs.enumerate() {
                if let Some((value, _)) = numbers.iter().zip(greatest).find(|(x, most)| x.abs() > **most) {
                    let expected = "at most 1e6 m, 300 m/s, 100 rad or 100 rad/s in magnitude";
                    return Err(BadStart::BadValue { name: channel.name(run), value: *value, expected });
                }
            }
        }
        for (joint, (position, (lower, upper))) in
            now.state.joint_position.iter().zip(&self.ranges).enumerate()
        {
            if !(*lower..=*upper).contains(position) {
                return Err(BadStart::BeyondStops {
                    joint,
                    position: *position,
                    lower: *lower,
                    upper: *upper,
                });
            }
        }
        Ok(())
    }

    /// Processes a measurement in a wind \[m/s\], or, of one that is not of this robot, its time alone: nothing is then
    /// measured. The last command is `acting`; the robot is to descend without a measured base or joints. Predictions stay
    /// within the accepted range, because otherwise a predicted velocity could grow without limit.
    pub fn update(
        &self,
        state: &mut ChannelsState,
        measurement: &Measurement,
        wind: Vector3<f64>,
        acting: &Acting,
        descent: &mut Descent,
        used: &mut Estimate,
    ) {
        let is_step = state.update_clock(measurement.time, self.time_step, self.refuses_jumps, used);
        let time = used.robot.time;
        if self.fit(measurement) {
            self.read(measurement, used);
            used.robot.wind = wind;
        } else {
            self.parts.iter().for_each(|channel| used.robot.remove(*channel));
            used.is_of_speed.fill(false);
        }
        used.robot.time = time;
        let (was_begun, dt) = (state.is_begun, used.elapsed);
        if was_begun {
            state.predict(acting, &self.jets, dt);
            for channel in &self.parts {
                for (numbers, most) in
                    state.predicted.numbers_mut(*channel).into_iter().zip(self.greatest.numbers(*channel))
                {
                    bound(numbers, most);
                }
            }
        }
        for (to, (now, predicted)) in
            used.thrust_innovation.iter_mut().zip(used.robot.thrust.iter().zip(&state.predicted.thrust))
        {
            // Over an unknown time it says nothing.
            *to = if is_step && was_begun { now - predicted } else { 0.0 };
        }
        // Changes during a pause are not jumps, and the first measurement has no predecessor.
        let missed_ticks = if was_begun { used.pause / self.time_step } else { f64::INFINITY };
        let mut is_pose_new = is_step;
        for (place, channel) in self.parts.iter().enumerate() {
            let is_new = self.accept(state, place, dt, missed_ticks, used);
            descent.is_blind |=
                channel.is_vital() && is_longer(state.records[place].age, DESCEND_AFTER, self.time_step);
            match channel {
                Channel::AngularVelocity if was_begun => self.integrate_pose(state, &used.robot, dt),
                Channel::Position | Channel::Rotation => is_pose_new &= is_new,
                _ => {}
            }
        }
        if is_pose_new {
            self.follow_pose(state, &used.robot, dt);
        }
        state.last.copy_from(&used.robot);
        self.fill_predicted(state, used);
        if descent.is_active() {
            used.modes.insert(Modes::DESCENDING);
        }
        let is_measured = (is_step || !was_begun) && !used.modes.intersects(Modes::WITHOUT_MOMENTUM);
        let is_wrong = self.parts.iter().zip(&state.records).any(|(channel, record)| {
            record.age > 0.0 && !record.is_missing && Modes::WITHOUT_MOMENTUM.contains(channel.mode())
        });
        used.gap = match is_measured {
            true => 0.0,
            false if is_step && !is_wrong => used.gap + dt,
            false => f64::INFINITY,
        };
        used.momentum = match is_measured {
            true if !was_begun || used.modes.contains(Modes::BEGUN_AGAIN) => Sampling::First,
            true => Sampling::Measured,
            false if is_longer(used.gap, BETWEEN_MAX, self.time_step) => Sampling::Unknown,
            false => Sampling::Between,
        };
        state.is_begun = true;
        used.thrust_rate.copy_from_slice(state.jet_rate.as_slice());
    }

    #[inline]
    fn is_within(&self, of: &Measurement, channel: Channel) -> bool {
        let mut runs = of.numbers(channel).into_iter().zip(self.greatest.numbers(channel));
        runs.all(|(numbers, greatest)| numbers.iter().zip(greatest).all(|(x, most)| x.abs() <= *most))
    }

    /// Whether the numbers of a channel are in their range.
    fn is_plausible(&self, now: &Measurement, channel: Channel) -> bool {
        now.is_measured(channel)
            && self.is_within(now, channel)
            && (channel != Channel::Rotation || is_rotation(&now.state.base.rotation))
    }

    /// Whether they are within so many jumps of others.
    #[inline]
    fn is_near(&self, now: &Measurement, channel: Channel, to: &Measurement, jumps: f64) -> bool {
        let runs = now.numbers(channel).into_iter().zip(to.numbers(channel));
        runs.zip(self.jump.numbers(channel)).all(|((now, to), jump)| {
            now.iter().zip(to).zip(jump).all(|((now, to), jump)| (now - to).abs() <= jumps * jump)
        })
    }

    /// Whether they are near their prediction.
    fn is_expected(&self, state: &ChannelsState, now: &Measurement, place: usize, missed_ticks: f64) -> bool {
        let record = &state.records[place];
        let width = if record.support > 1 { 1.0 } else { CONFIRMATION };
        let gate = width + WIDENING * record.age + missed_ticks;
        self.is_near(now, self.parts[place], &state.predicted, gate)
    }

    /// Accepts the numbers of a channel, or lets its age grow by `dt` \[s\]. Returns whether it is measured in this tick
    /// and in the last one, with different bits.
    fn accept(
        &self,
        state: &mut ChannelsState,
        place: usize,
        dt: f64,
        missed_ticks: f64,
        used: &mut Estimate,
    ) -> bool {
        let (kind, now, modes) = (self.parts[place], &used.robot, &mut used.modes);
        // What contradicts one velocity of the base contradicts both.
        let is_contradicted = kind.is_velocity()
            && self.velocities().into_iter().filter(|other| *other != place).any(|other| {
                let channel = self.parts[other];
                let is_sound =
                    || self.is_plausible(now, channel) && self.is_expected(state, now, other, missed_ticks);
                now.is_measured(channel) && !is_sound()
            });
        let is_plausible = self.is_plausible(now, kind);
        if let Channel::Thrust(jet) = kind {
            used.thrust_reading[jet] = if is_plausible { now.thrust[jet] } else { f64::NAN };
        }
        let is_sound = is_plausible && self.is_expected(state, now, place, missed_ticks) && !is_contradicted;
        let is_same = state.is_begun && now.numbers(kind) == state.last.numbers(kind);
        let agrees = state.records[place].against > 0 && self.is_near(now, kind, &state.last, 1.0);
        let leaves = kind.moves()
            && is_same
            && state.records[place].same.saturating_add(1) >= FROZEN_TICKS
            && !self.is_near(now, kind, &state.predicted, FROZEN_SHARE);
        let record = &mut state.records[place];
        let was_new = record.age == 0.0 && record.same == 0;
        record.is_missing = !now.is_measured(kind);
        record.same = if is_same { record.same.saturating_add(1) } else { 0 };
        // Of what moves the same bits are no other measurement.
        let counts = !is_same || !kind.moves();
        if counts {
            record.against = u32::from(is_plausible && !is_sound) * (1 + u32::from(agrees) * record.against);
        }
        let is_outvoted = record.against > record.support;
        record.is_distrusted |= kind == Channel::Wind
            && is_plausible
            && !is_sound
            && is_longer(record.age, WIND_HOLD, self.time_step);
        record.is_frozen = is_same && (record.is_frozen || leaves);
        if (is_sound || is_outvoted) && !record.is_frozen && !record.is_distrusted {
            record.age = 0.0;
            if is_outvoted {
                (record.support, record.against) = (record.against, 0);
                if kind.is_vital() {
                    modes.insert(Modes::BEGUN_AGAIN);
                }
            } else if counts {
                record.support = record.support.saturating_add(1).min(self.support_max);
            }
            // Of what moves the prediction continues, to be compared with a value that may be frozen.
            if counts {
                state.predicted.copy_channel(kind, now);
            }
        } else {
            record.age += dt;
            let is_between = !is_longer(record.age, BETWEEN_MAX, self.time_step);
            let is_usual = kind == Channel::Height && (state.predicted.height.is_nan() || is_between);
            modes.insert_if(!is_usual, kind.mode());
        }
        was_new && state.records[place].age == 0.0 && !is_same && state.is_begun
    }

    /// Advances the predicted pose by `dt` \[s\] with the velocity of this tick, measured or not (M78).
    fn integrate_pose(&self, state: &mut ChannelsState, now: &Measurement, dt: f64) {
        let is_predicted = self.velocities().map(|place| state.records[place].age > 0.0);
        let predicted = &mut state.predicted.state;
        let of = |is_predicted| if is_predicted { &*predicted } else { &now.state };
        let linear = of(is_predicted[0]).base_linear_velocity();
        let angular = of(is_predicted[1]).base_angular_velocity();
        for (position, velocity) in predicted.base.position.iter_mut().zip(&linear) {
            *position += dt * velocity;
        }
        predicted.base.rotation = exp_so3(&(angular * dt)) * predicted.base.rotation;
        bound(predicted.base.position.as_mut_slice(), self.greatest.state.base.position.as_slice());
        let height = &mut state.predicted.height;
        *height += dt * linear.z;
        bound(from_mut(height), &[self.greatest.height]);
    }

    /// Lets predicted base velocities that have not been measured for long follow the difference of the last two poses.
    fn follow_pose(&self, state: &mut ChannelsState, now: &Measurement, dt: f64) {
        let share = share(VELOCITY_GAIN * dt);
        let (base, last) = (&now.state.base, &state.last.state.base);
        let moved = base.position - last.position;
        let turned: Matrix3<f64> = base.rotation * last.rotation.transpose();
        for (row, (place, found)) in
            self.velocities().into_iter().zip([moved, vee_of_skew_part(&turned)]).enumerate()
        {
            if state.records[place].follows_pose(self.time_step) {
                let velocity = &mut state.predicted.state.velocity.as_mut_slice()[3 * row..3 * row + 3];
                for (velocity, found) in velocity.iter_mut().zip(&(found / dt)) {
                    *velocity += share * (found - *velocity);
                }
            }
        }
    }

    /// Replaces the numbers that were not accepted by predictions; a held wind fades.
    fn fill_predicted(&self, state: &ChannelsState, used: &mut Estimate) {
        for (channel, record) in self.parts.iter().zip(&state.records) {
            if record.age == 0.0 {
                continue;
            }
            used.robot.copy_channel(*channel, &state.predicted);
            match channel {
                Channel::Thrust(jet) => used.thrust_innovation[*jet] = 0.0,
                Channel::Wind => {
                    let left = 1.0 - (record.age - WIND_HOLD) / WIND_FADE;
                    used.robot.wind *= left.clamp(0.0, 1.0);
                    let is_lost = is_longer(record.age, WIND_HOLD + WIND_FADE, self.time_step);
                    used.modes.insert_if(is_lost, Modes::WIND_LOST);
                }
                _ => {}
            }
        }
    }

    /// Rejects the measured foot wrenches from now on, including those of this tick.
    pub fn reject_feet(&self, state: &mut ChannelsState, acting: &Acting, used: &mut Estimate) {
        state.records[self.place(5)].is_distrusted = true;
        used.robot.foot_wrenches.copy_from(&acting.foot_wrenches);
        used.modes.insert(Channel::Feet.mode());
    }

    /// Uses the measured thrust of a jet from the next tick on, or rejects it.
    pub fn use_sensor(state: &mut ChannelsState, jet: usize, is_sensor_used: bool) {
        state.records[1 + jet].is_distrusted = !is_sensor_used;
    }

    /// Corrects the predicted thrust of a jet, which is too large by `error` \[N\].
    pub fn correct_thrust(state: &mut ChannelsState, jet: usize, error: f64) {
        state.predicted.thrust[jet] -= error;
    }

    /// The height above the ground, if it is measured anew in this tick, and accepted \[m\].
    #[must_use]
    pub fn new_height(&self, state: &ChannelsState, used: &Estimate) -> Option<f64> {
        let record = &state.records[self.place(6)];
        (record.age == 0.0 && record.same == 0)
            .then_some(used.robot.height)
            .filter(|height| height.is_finite())
    }

    /// Writes what an estimator is given of a tick: NaN for values that were not accepted, except for a base velocity that
    /// follows the pose.
    pub fn select_accepted(&self, state: &ChannelsState, used: &Estimate, to: &mut Measurement) {
        to.copy_from(&used.robot);
        for (channel, record) in self.parts.iter().zip(&state.records) {
            if record.age > 0.0 && !(channel.is_velocity() && record.follows_pose(self.time_step)) {
                to.remove(*channel);
            }
        }
    }

    /// Whether state and thrusts of an estimate are in the accepted range.
    #[must_use]
    pub fn accept_estimate(&self, estimate: &Measurement) -> bool {
        let of_sensors =
            |channel: &&Channel| !matches!(channel, Channel::Wind | Channel::Feet | Channel::Height);
        self.parts.iter().filter(of_sensors).all(|channel| self.is_within(estimate, *channel))
    }

    /// Reads a measurement; where the speed of a shaft is measured, the thrust is that of it (M176). Joint velocities that
    /// are neither needed nor measured are zero.
    fn read(&self, measurement: &Measurement, used: &mut Estimate) {
        used.robot.copy_from(measurement);
        used.is_of_speed.fill(false);
        let thrusts = used.robot.thrust.iter_mut().zip(&mut used.is_of_speed);
        for (((thrust, is_of_speed), engine), speed) in
            thrusts.zip(&self.engines).zip(&measurement.shaft_speed)
        {
            if let (EngineModel::Shaft(shaft), true) = (engine, *speed >= 0.0) {
                (*thrust, *is_of_speed) = (shaft.thrust(*speed), true);
            }
        }
        if !self.needs_joint_velocity {
            let velocities = &mut used.robot.state.velocity.as_mut_slice()[6..];
            velocities.iter_mut().filter(|x| !x.is_finite()).for_each(|x| *x = 0.0);
        }
    }
}

impl Channel {
    /// Mode of a tick without it.
    fn mode(self) -> Modes {
        match self {
            Self::Wind => Modes::WIND_HELD,
            Self::Thrust(_) => Modes::THRUST_MODELLED,
            Self::Joints => Modes::JOINTS_PREDICTED,
            Self::LinearVelocity | Self::AngularVelocity => Modes::VELOCITY_PREDICTED,
            Self::Position => Modes::POSITION_PREDICTED,
            Self::Rotation => Modes::ROTATION_PREDICTED,
            Self::Feet => Modes::FEET_PREDICTED,
            Self::Height => Modes::GROUND_HELD,
        }
    }

    /// Whether the robot descends if it is missing.
    fn is_vital(self) -> bool {
        matches!(self, Self::Joints | Self::Position | Self::Rotation) || self.is_velocity()
    }

    /// Whether it moves with the robot, and so does its prediction.
    fn moves(self) -> bool {
        self.is_vital() || self == Self::Height
    }

    /// Whether it is a velocity of the base.
    fn is_velocity(self) -> bool {
        matches!(self, Self::LinearVelocity | Self::AngularVelocity)
    }

    /// Field of the measurement that has its numbers, the first or the second run.
    fn name(self, run: usize) -> &'static str {
        match self {
            Self::Wind => "wind",
            Self::Thrust(_) => "thrust",
            Self::Joints => ["joint_position", "joint_velocity"][run],
            Self::LinearVelocity => "base_linear_velocity",
            Self::AngularVelocity => "base_angular_velocity",
            Self::Position => "base_position",
            Self::Rotation => "base_rotation",
            Self::Feet => "foot_wrenches",
            Self::Height => "height",
        }
    }
}
