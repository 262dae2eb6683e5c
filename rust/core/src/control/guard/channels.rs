//! Channels of the measurement: missing or implausible values are replaced by predictions.
//!
//! The model advances the last value of every channel to this tick (`ChannelsState::predict`). A measured value is
//! used if it is finite and within its accepted range; for wind, joints and base it must also be near the prediction,
//! and for joints and base not frozen, that is, with the same bits for several ticks while the prediction moves away.
//! Otherwise the prediction is used, and the age of the channel grows. The first measurements of a flight may be the wrong ones: where more of the
//! following ones contradict the prediction, and agree with each other, than it rests on, the flight begins again from
//! them.
//!
//! ```text
//! wind              its last value, which fades to zero
//! feet              the wrenches that keep them at rest in the model
//! thrusts           as the jets follow their commands
//! joints and base   a step of the model with the last torques and the observed wrench
//! ```
//!
//! A base velocity that is not measured, and not just between two measurements, follows the differences of the pose, if
//! the pose is measured.
//!
//! Equations M101 to M103 and M141 of `docs/model`.

mod config;
mod layout;
mod state;

pub use config::{ChannelsConfig, Jumps};
pub use state::ChannelsState;

use crate::control::greatest;
use crate::control::measurement::{BadStart, Measurement, Reading, UsedMeasurement};
use crate::control::modes::Modes;
use crate::jets::{EngineModel, JetModel};
use crate::robot::RobotModel;
use crate::spatial::{exp_so3, is_rotation, vee_of_skew_part};
use crate::timing::share;
use layout::{ChannelKind, Entry, Numbers, rotation_of, vector};
use nalgebra::{DVector, Vector3, Vector6};
use state::{Channel, bound, time_is_plausible};

/// Fraction of [`Jumps`] by which a value must differ from the prediction to count as frozen.
const FROZEN_SHARE: f64 = 0.02;

/// Number of ticks with the same bits after which a value may count as frozen.
const FROZEN_TICKS: u32 = 5;

/// Share of [`Jumps`] within which the second measurement confirms the first, and a first joint position may be beyond
/// its stops: less than a wrong first measurement can do harm with, more than noise of sensors.
const CONFIRMATION: f64 = 0.2;

/// Relative growth of [`Jumps`] with the age of a channel \[1/s\]: predictions drift.
const WIDENING: f64 = 1.0;

/// Time in which the wind fades to zero after it was held \[s\].
const WIND_FADE: f64 = 2.0;

/// Gain with which a base velocity that is not measured follows the differences of the pose \[1/s\].
const VELOCITY_GAIN: f64 = 100.0;

/// The channels of one controller; preallocated.
#[derive(Debug, Clone)]
pub struct Channels {
    config: ChannelsConfig,
    time_step: f64,
    layout: Numbers,
    entries: Vec<Entry>,
    /// Places of the linear and the angular velocity of the base among them.
    velocities: [usize; 2],
    jets: Vec<JetModel>,
    engines: Vec<EngineModel>,
    /// Whether each thrust in `now` is that of a measured speed.
    pub(super) is_of_speed: Vec<bool>,
    greatest: Vec<f64>,
    jump: Vec<f64>,
    /// Whether joint velocities must be measured; a joint observer estimates them from positions.
    needs_joint_velocity: bool,
    /// Range of each joint position in which a flight can begin \[rad, m\].
    ranges: Vec<(f64, f64)>,
    now: Vec<f64>,
}

impl Channels {
    /// Channels of the jets, joints and feet of `robot`, at the tick `time_step` \[s\]. Joint velocities that are
    /// neither needed nor measured count as zero.
    #[must_use]
    pub fn new(
        config: &ChannelsConfig,
        robot: &RobotModel,
        models: Vec<JetModel>,
        time_step: f64,
        needs_joint_velocity: bool,
    ) -> Self {
        let (jets, joints, feet) = (robot.jets.len(), robot.joints.len(), robot.feet.len());
        let layout = Numbers::new(jets, joints, feet);
        let near = config.jump.clone().unwrap_or(Jumps::NONE);
        let mut greatest = vec![f64::INFINITY; layout.len()];
        let mut jump = vec![f64::INFINITY; layout.len()];
        for (entry, jet) in layout.thrust.clone().zip(&robot.jets) {
            greatest[entry] = greatest::THRUST * jet.thrust_max;
        }
        for (range, most, near) in [
            (&layout.wind, greatest::WIND, near.wind),
            (&layout.joint_position, greatest::JOINT_POSITION, near.joint_position),
            (&layout.joint_velocity, greatest::JOINT_VELOCITY, near.joint_velocity),
            (&layout.linear_velocity, greatest::VELOCITY, near.velocity),
            (&layout.angular_velocity, greatest::ANGULAR_VELOCITY, near.angular_velocity),
            (&layout.position, greatest::POSITION, near.position),
            (&layout.rotation, 2.0, near.rotation),
        ] {
            greatest[range.clone()].fill(most);
            jump[range.clone()].fill(near);
        }
        for foot in greatest[layout.feet.clone()].chunks_exact_mut(6) {
            foot[..3].fill(greatest::FOOT_FORCE);
            foot[3..].fill(greatest::FOOT_MOMENT);
        }
        let thrusts = layout.thrust.clone().map(|number| (ChannelKind::Thrust, number..number + 1));
        let entries = [(ChannelKind::Wind, layout.wind.clone())].into_iter().chain(thrusts).chain([
            (ChannelKind::Joints, layout.joints()),
            (ChannelKind::LinearVelocity, layout.linear_velocity.clone()),
            (ChannelKind::AngularVelocity, layout.angular_velocity.clone()),
            (ChannelKind::Position, layout.position.clone()),
            (ChannelKind::Rotation, layout.rotation.clone()),
            (ChannelKind::Feet, layout.feet.clone()),
        ]);
        let beyond = CONFIRMATION * near.joint_position;
        let stops = robot.joints.iter().map(|joint| joint.stops);
        Self {
            config: config.clone(),
            time_step,
            ranges: stops.map(|(lower, upper)| (lower - beyond, upper + beyond)).collect(),
            now: vec![0.0; layout.len()],
            entries: entries.map(|(kind, range)| Entry { kind, range }).collect(),
            velocities: [jets + 2, jets + 3],
            jets: models,
            engines: robot.jets.iter().map(|jet| jet.engine).collect(),
            is_of_speed: vec![false; jets],
            greatest,
            jump,
            needs_joint_velocity,
            layout,
        }
    }

    /// Whether a measurement has the sizes of this robot.
    #[must_use]
    pub fn fit(&self, measurement: &Measurement) -> bool {
        let (joints, feet) = (self.layout.joint_position.len(), self.layout.feet.len() / 6);
        measurement.state.n_joints() == joints
            && measurement.state.velocity.len() == 6 + joints
            && measurement.thrust.len() == self.layout.thrust.len()
            && [0, measurement.thrust.len()].contains(&measurement.shaft_speed.len())
            && (feet == 0 || measurement.foot_wrenches.len() == feet)
    }

    /// Whether a state has the sizes of these channels.
    #[must_use]
    pub fn fit_state(&self, state: &ChannelsState) -> bool {
        state.last.len() == self.layout.len() && state.channels.len() == self.entries.len()
    }

    /// Thrusts of the last tick, or of the start, as far as they were accepted; predicted ones elsewhere \[N\].
    #[must_use]
    pub fn thrust<'a>(&self, state: &'a ChannelsState) -> &'a [f64] {
        &state.predicted[self.layout.thrust.clone()]
    }

    /// The state before the first tick.
    ///
    /// # Errors
    /// [`BadStart`] for a measurement that no flight can begin with.
    pub fn start(&mut self, measurement: &Measurement) -> Result<ChannelsState, BadStart> {
        let (joints, jets) = (self.layout.joint_position.len(), self.layout.thrust.len());
        if !self.fit(measurement) {
            return Err(BadStart::OtherRobot { joints, jets, feet: self.layout.feet.len() / 6 });
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
        self.read(measurement);
        let wind = &mut self.now[self.layout.wind.clone()];
        if !wind.iter().all(|x| x.is_finite()) {
            wind.fill(0.0); // not measured: still air until it is
        }
        if let Some((index, value)) = self.now.iter().enumerate().find(|(_, x)| !x.is_finite()) {
            return bad(self.layout.name(index), *value, "a finite number");
        }
        if !is_rotation(&measurement.state.base.rotation) {
            return Err(BadStart::NoRotation);
        }
        if self.config.jump.is_some() {
            self.check_ranges(&measurement.state.joint_position)?;
        }
        // Where wind, thrusts or foot wrenches cannot be accepted: none, until they are.
        for Entry { range, .. } in self.entries.iter().filter(|entry| !entry.kind.is_vital()) {
            let numbers = &mut self.now[range.clone()];
            if !is_within(numbers, &self.greatest[range.clone()]) {
                numbers.fill(0.0);
            }
        }
        Ok(ChannelsState {
            channels: vec![Channel::default(); self.entries.len()],
            last: self.now.clone(),
            predicted: self.now.clone(),
            acceleration: DVector::zeros(6 + joints),
            commanded_in: measurement.state.clone(),
            joint_torque: DVector::zeros(joints),
            thrust_rate: DVector::zeros(jets),
            jet_rate: DVector::zeros(jets),
            foot_wrenches: DVector::zeros(self.layout.feet.len()),
            time: measurement.time,
            clock_offset: 0.0,
            gap: 0.0,
            is_begun: false,
            is_descending: false,
        })
    }

    /// Whether the joints and base in `now` can be where a flight begins.
    fn check_ranges(&self, joint_position: &DVector<f64>) -> Result<(), BadStart> {
        for Entry { range, .. } in self.entries.iter().filter(|entry| entry.kind.is_vital()) {
            if let Some(index) = range.clone().find(|index| self.now[*index].abs() > self.greatest[*index]) {
                let expected = "at most 1e6 m, 300 m/s, 100 rad or 100 rad/s in magnitude";
                let (name, value) = (self.layout.name(index), self.now[index]);
                return Err(BadStart::BadValue { name, value, expected });
            }
        }
        for (joint, (position, (lower, upper))) in joint_position.iter().zip(&self.ranges).enumerate() {
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

    /// Processes a measurement of matching size and writes the result to `used`.
    pub fn update(
        &mut self,
        state: &mut ChannelsState,
        measurement: &Measurement,
        used: &mut UsedMeasurement,
    ) {
        self.read(measurement);
        self.take_in(state, measurement.time, used);
    }

    /// As [`Self::update`], for a measurement at `time` \[s\] that does not fit: nothing is measured.
    pub fn update_unmeasured(&mut self, state: &mut ChannelsState, time: f64, used: &mut UsedMeasurement) {
        self.now.fill(f64::NAN);
        self.is_of_speed.fill(false);
        self.take_in(state, time, used);
    }

    /// Judges the numbers in `now` and makes `used` of them.
    fn take_in(&mut self, state: &mut ChannelsState, time: f64, used: &mut UsedMeasurement) {
        let is_step = state.update_clock(time, self.time_step, self.config.jump.is_some(), used);
        let (was_begun, dt) = (state.is_begun, used.elapsed);
        if was_begun {
            state.predict(&self.layout, &self.jets, &self.greatest, dt);
        }
        let now = &self.now[self.layout.thrust.clone()];
        for ((to, now), predicted) in used.thrust_innovation.iter_mut().zip(now).zip(self.thrust(state)) {
            // Over an unknown time it says nothing.
            *to = if is_step && was_begun { now - predicted } else { 0.0 };
        }
        // Changes during a pause are not jumps, and the first measurement has no predecessor.
        let missed_ticks = if was_begun { used.pause / self.time_step } else { f64::INFINITY };
        let mut is_pose_new = is_step;
        for (place, Entry { kind, .. }) in self.entries.iter().enumerate() {
            let is_new = self.accept(state, place, dt, missed_ticks, &mut used.modes);
            match kind {
                ChannelKind::AngularVelocity if was_begun => self.integrate_pose(state, dt),
                ChannelKind::Position | ChannelKind::Rotation => is_pose_new &= is_new,
                _ => {}
            }
        }
        if is_pose_new {
            self.follow_pose(state, dt);
        }
        state.last.copy_from_slice(&self.now);
        self.fill_predicted(state, used);
        if state.is_descending {
            used.modes.insert(Modes::DESCENDING);
        }
        used.has_momentum = (is_step || !was_begun) && !used.modes.intersects(Modes::WITHOUT_MOMENTUM);
        let is_wrong = self.entries.iter().zip(&state.channels).any(|(entry, channel)| {
            channel.age > 0.0 && !channel.is_missing && Modes::WITHOUT_MOMENTUM.contains(entry.kind.mode())
        });
        state.gap = match used.has_momentum {
            true => 0.0,
            false if is_step && !is_wrong => state.gap + dt,
            false => f64::INFINITY,
        };
        used.gap = state.gap;
        state.is_begun = true;
        self.layout.write(&self.now, used);
        used.thrust_rate.copy_from_slice(state.jet_rate.as_slice());
    }

    /// Whether the numbers of a channel are in their range.
    fn is_plausible(&self, place: usize) -> bool {
        let Entry { range, kind } = &self.entries[place];
        let now = &self.now[range.clone()];
        is_within(now, &self.greatest[range.clone()])
            && (*kind != ChannelKind::Rotation || is_rotation(&rotation_of(now)))
    }

    /// Whether they are within so many jumps of others.
    fn is_near(&self, place: usize, to: &[f64], jumps: f64) -> bool {
        let range = &self.entries[place].range;
        let mut entries = self.now[range.clone()].iter().zip(to).zip(&self.jump[range.clone()]);
        entries.all(|((now, to), jump)| (now - to).abs() <= jumps * jump)
    }

    /// Whether they are in their range, and near their prediction.
    fn is_sound(&self, state: &ChannelsState, place: usize, missed_ticks: f64) -> bool {
        let channel = &state.channels[place];
        let width = if channel.support > 1 { 1.0 } else { CONFIRMATION };
        let gate = width + WIDENING * channel.age + missed_ticks;
        let predicted = &state.predicted[self.entries[place].range.clone()];
        self.is_plausible(place) && self.is_near(place, predicted, gate)
    }

    /// Accepts the numbers of a channel, or lets its age grow by `dt` \[s\]. Returns whether it is measured in this tick
    /// and in the last one, with different bits.
    fn accept(
        &self,
        state: &mut ChannelsState,
        place: usize,
        dt: f64,
        missed_ticks: f64,
        modes: &mut Modes,
    ) -> bool {
        // What contradicts one velocity of the base contradicts both.
        let is_contradicted = self.entries[place].kind.is_velocity()
            && self.velocities.into_iter().filter(|other| *other != place).any(|other| {
                let numbers = &self.now[self.entries[other].range.clone()];
                numbers.iter().all(|x| x.is_finite()) && !self.is_sound(state, other, missed_ticks)
            });
        let is_sound = self.is_sound(state, place, missed_ticks) && !is_contradicted;
        let (Entry { range, kind }, channel) = (&self.entries[place], &mut state.channels[place]);
        let (now, predicted) = (&self.now[range.clone()], &mut state.predicted[range.clone()]);
        let last = &state.last[range.clone()];
        let is_same = state.is_begun && *now == *last;
        let was_new = channel.age == 0.0 && channel.same == 0;
        channel.is_missing = now.iter().any(|x| !x.is_finite());
        channel.same = if is_same { channel.same.saturating_add(1) } else { 0 };
        let is_plausible = self.is_plausible(place);
        // Of joints and base the same bits are no other measurement.
        let counts = !is_same || !kind.is_vital();
        if counts {
            let agrees = channel.against > 0 && self.is_near(place, last, 1.0);
            channel.against =
                u32::from(is_plausible && !is_sound) * (1 + u32::from(agrees) * channel.against);
        }
        let is_outvoted = channel.against > channel.support;
        channel.is_distrusted |=
            *kind == ChannelKind::Wind && is_plausible && !is_sound && channel.age > self.config.wind_hold;
        // The prediction of a wind does not move.
        let leaves =
            kind.is_vital() && channel.same >= FROZEN_TICKS && !self.is_near(place, predicted, FROZEN_SHARE);
        channel.is_frozen = is_same && (channel.is_frozen || leaves);
        if (is_sound || is_outvoted) && !channel.is_frozen && !channel.is_distrusted {
            channel.age = 0.0;
            if is_outvoted {
                (channel.support, channel.against) = (channel.against, 0);
                if kind.is_vital() {
                    modes.insert(Modes::BEGUN_AGAIN);
                }
            } else if counts {
                channel.support = channel.support.saturating_add(1);
            }
            // For joints and base the prediction continues, to be compared with a value that may be frozen.
            if !is_same || !kind.is_vital() {
                predicted.copy_from_slice(now);
            }
        } else {
            channel.age += dt;
            modes.insert(kind.mode());
        }
        state.is_descending |= kind.is_vital() && channel.age > self.config.descend_after;
        was_new && channel.age == 0.0 && !is_same && state.is_begun
    }

    /// Advances the predicted pose by `dt` \[s\] with the velocity of this tick, measured or not (M78).
    fn integrate_pose(&self, state: &mut ChannelsState, dt: f64) {
        let (layout, ages) = (&self.layout, self.velocities.map(|place| state.channels[place].age));
        let (predicted, position) = (&mut state.predicted, layout.position.clone());
        let velocity = Vector6::from_fn(|row, _| {
            let numbers = if ages[row / 3] > 0.0 { &*predicted } else { &self.now };
            numbers[layout.velocity()][row]
        });
        for (position, velocity) in predicted[position.clone()].iter_mut().zip(&velocity) {
            *position += dt * velocity;
        }
        let angular: Vector3<f64> = velocity.fixed_rows::<3>(3).into();
        let rotation = exp_so3(&(angular * dt)) * rotation_of(&predicted[layout.rotation.clone()]);
        predicted[layout.rotation.clone()].copy_from_slice(rotation.as_slice());
        bound(&mut predicted[position.clone()], &self.greatest[position]);
    }

    /// Lets predicted base velocities that have not been measured for long follow the difference of the last two poses.
    fn follow_pose(&self, state: &mut ChannelsState, dt: f64) {
        let share = share(VELOCITY_GAIN * dt);
        let (position, rotation) = (self.layout.position.clone(), self.layout.rotation.clone());
        let moved = vector(&self.now[position.clone()]) - vector(&state.last[position]);
        let turned =
            rotation_of(&self.now[rotation.clone()]) * rotation_of(&state.last[rotation]).transpose();
        for (place, found) in self.velocities.into_iter().zip([moved, vee_of_skew_part(&turned)]) {
            if state.channels[place].follows_pose() {
                let velocity = &mut state.predicted[self.entries[place].range.clone()];
                for (velocity, found) in velocity.iter_mut().zip(&(found / dt)) {
                    *velocity += share * (found - *velocity);
                }
            }
        }
    }

    /// Replaces the numbers that were not accepted by predictions; a held wind fades.
    fn fill_predicted(&mut self, state: &ChannelsState, used: &mut UsedMeasurement) {
        let mut innovations = used.thrust_innovation.iter_mut();
        for (Entry { range, kind }, channel) in self.entries.iter().zip(&state.channels) {
            let innovation = if *kind == ChannelKind::Thrust { innovations.next() } else { None };
            if channel.age == 0.0 {
                continue;
            }
            let now = &mut self.now[range.clone()];
            now.copy_from_slice(&state.predicted[range.clone()]);
            if let Some(innovation) = innovation {
                *innovation = 0.0;
            }
            if *kind == ChannelKind::Wind {
                let left = 1.0 - (channel.age - self.config.wind_hold) / WIND_FADE;
                for x in now {
                    *x *= left.clamp(0.0, 1.0);
                }
                if left <= 0.0 {
                    used.modes.insert(Modes::WIND_LOST);
                }
            }
        }
    }

    /// Rejects the measured foot wrenches from now on, including those of this tick.
    pub fn reject_feet(&self, state: &mut ChannelsState, used: &mut UsedMeasurement) {
        for (entry, channel) in self.entries.iter().zip(&mut state.channels) {
            channel.is_distrusted |= entry.kind == ChannelKind::Feet;
        }
        let wrenches = state.foot_wrenches.as_slice().chunks_exact(6);
        for (to, wrench) in used.foot_wrenches.iter_mut().zip(wrenches) {
            to.copy_from_slice(wrench);
        }
        used.modes.insert(ChannelKind::Feet.mode());
    }

    /// Rejects the measured thrust of a jet from now on; it was too large by `deviation` \[N\].
    pub fn reject_sensor(&self, state: &mut ChannelsState, jet: usize, deviation: f64) {
        let number = self.layout.thrust.start + jet;
        for (entry, channel) in self.entries.iter().zip(&mut state.channels) {
            channel.is_distrusted |= entry.range.contains(&number);
        }
        state.predicted[number] -= deviation;
    }

    /// Writes the measurement for an estimator: NaN for values that were not accepted, except for a base velocity that
    /// follows the pose.
    pub fn select_accepted(&mut self, state: &ChannelsState, reading: &mut Reading) {
        for (entry, channel) in self.entries.iter().zip(&state.channels) {
            if channel.age > 0.0 && !(entry.kind.is_velocity() && channel.follows_pose()) {
                self.now[entry.range.clone()].fill(f64::NAN);
            }
        }
        self.layout.write_reading(&self.now, &mut reading.state, &mut reading.thrust);
    }

    /// Replaces the state and thrusts of `used` by an estimate; if a number of the estimate is outside the accepted
    /// range, replaces the estimate by `used`.
    pub fn replace(&mut self, estimate: &mut Reading, used: &mut UsedMeasurement) {
        let Reading { state, thrust } = &*estimate;
        let (time, wind, foot_wrenches) = (used.time, used.wind, &used.foot_wrenches);
        let measurement = Measurement { time, state, thrust, shaft_speed: &[], wind, foot_wrenches };
        self.layout.read(&measurement, &mut self.now);
        if is_within(&self.now, &self.greatest) {
            used.state.copy_from(state);
            used.thrust.copy_from_slice(thrust);
        } else {
            estimate.copy(&used.state, &used.thrust);
        }
    }

    /// Reads the numbers of a measurement; where the speed of a shaft is measured, the thrust is that of it (M176).
    fn read(&mut self, measurement: &Measurement) {
        self.layout.read(measurement, &mut self.now);
        self.is_of_speed.fill(false);
        let thrusts = self.now[self.layout.thrust.clone()].iter_mut().zip(&mut self.is_of_speed);
        for (((thrust, is_of_speed), engine), speed) in
            thrusts.zip(&self.engines).zip(measurement.shaft_speed)
        {
            if let (EngineModel::Shaft(shaft), true) = (engine, *speed >= 0.0) {
                (*thrust, *is_of_speed) = (shaft.thrust(*speed), true);
            }
        }
        self.fill_joint_velocity();
    }

    /// Sets joint velocities that are neither needed nor measured to zero.
    fn fill_joint_velocity(&mut self) {
        if !self.needs_joint_velocity {
            let velocities = &mut self.now[self.layout.joint_velocity.clone()];
            velocities.iter_mut().filter(|x| !x.is_finite()).for_each(|x| *x = 0.0);
        }
    }
}

/// Whether numbers are in `[−greatest, greatest]`.
fn is_within(numbers: &[f64], greatest: &[f64]) -> bool {
    numbers.iter().zip(greatest).all(|(number, most)| number.abs() <= *most)
}
