//! State of the channels from tick to tick: its prediction and its clock.

use crate::control::acting::Acting;
use crate::control::measure::measurement::{BETWEEN_MAX, Estimate, Measurement};
use crate::control::modes::Modes;
use crate::jets::JetModel;
use crate::timing::is_longer;
use nalgebra::DVector;

/// Longest time between two ticks, in ticks. Half a tick absorbs rounding.
const GAP_MAX: f64 = 10.5;

/// Longest time without ticks that can be a pause of the controller \[s\]; if it is longer, the clock has jumped.
const PAUSE_MAX: f64 = 1.0;

/// Longest flight \[s\]; for larger times, ticks of milliseconds are lost in rounding.
const TIME_MAX: f64 = 1e9;

/// State of one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Record {
    /// Time since its last accepted measurement \[s\].
    pub(super) age: f64,
    /// Number of successive ticks in which its bits have not changed.
    pub(super) same: u32,
    /// Number of measurements that its prediction rests on: accepted ones since the flight began, or began again.
    pub(super) support: u32,
    /// Number of successive measurements that contradict the prediction, but not each other.
    pub(super) against: u32,
    /// Whether it has no number in this tick; one that is not accepted otherwise is wrong.
    pub(super) is_missing: bool,
    /// Whether it counts as frozen, until its bits change.
    pub(super) is_frozen: bool,
    /// Whether its measurements are rejected: those of wind and feet for good.
    pub(super) is_distrusted: bool,
}

impl Record {
    /// Whether a velocity of the base is to follow the pose: it is wrong, or has been missing for longer than between two
    /// measurements.
    pub(super) fn follows_pose(&self, time_step: f64) -> bool {
        self.age > 0.0 && (!self.is_missing || is_longer(self.age, BETWEEN_MAX, time_step))
    }
}

/// State of the channels, kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelsState {
    pub(super) records: Vec<Record>,
    /// The measurement of the last tick.
    pub(super) last: Measurement,
    /// Prediction from the last accepted values.
    pub(super) predicted: Measurement,
    /// Predicted rates of the thrusts \[N/s\].
    pub(super) jet_rate: DVector<f64>,
    /// Offset of the measurement's clock from that of the controller \[s\].
    pub(super) clock_offset: f64,
    /// Whether there has been a tick.
    pub(super) is_begun: bool,
}

impl ChannelsState {
    /// Moves the time on with that of a measurement \[s\]: M108. If `can_jump`, a time that does not follow the last one
    /// is a jump of the clock. Whether the time since the last tick is known.
    pub(super) fn update_clock(
        &mut self,
        measured: f64,
        time_step: f64,
        can_jump: bool,
        used: &mut Estimate,
    ) -> bool {
        let last = used.robot.time;
        let next = last + time_step;
        let is_known = time_is_plausible(measured);
        let time = if is_known { measured - self.clock_offset } else { next };
        let elapsed = time - last;
        let is_step = elapsed > 0.0 && elapsed < GAP_MAX * time_step;
        let has_jumped = self.is_begun && !is_step && can_jump;
        if has_jumped {
            self.clock_offset = measured - next;
        }
        used.robot.time = if has_jumped { next } else { time };
        used.elapsed = if is_step { elapsed } else { time_step };
        let may_have_paused = self.is_begun && !is_step && elapsed > 0.0 && elapsed <= PAUSE_MAX;
        used.pause = if may_have_paused { elapsed } else { 0.0 };
        used.modes = Modes::default();
        if !is_known || has_jumped {
            used.modes.insert(Modes::CLOCK_PREDICTED);
        }
        is_step
    }

    /// Advances all values except the pose by `dt` \[s\] (M101): joints and base by M78, thrusts by M31 or M173.
    pub(super) fn predict(&mut self, acting: &Acting, jets: &[JetModel], dt: f64) {
        let Self { predicted, jet_rate, .. } = self;
        predicted.foot_wrenches.copy_from(&acting.foot_wrenches);
        let thrusts = predicted.thrust.iter_mut().zip(jet_rate.iter_mut());
        for ((thrust, rate), (jet, command)) in thrusts.zip(jets.iter().zip(&acting.thrust_rate)) {
            (*thrust, *rate) = jet.advance(*thrust, *rate, *command, dt);
        }
        let state = &mut predicted.state;
        for (velocity, acceleration) in state.velocity.iter_mut().zip(&acting.acceleration) {
            *velocity += dt * acceleration;
        }
        for (position, velocity) in state.joint_position.iter_mut().zip(&state.velocity.as_slice()[6..]) {
            *position += dt * velocity;
        }
    }
}

/// Brings numbers into `[−greatest, greatest]`; NaN stays NaN.
pub(super) fn bound(numbers: &mut [f64], greatest: &[f64]) {
    for (number, most) in numbers.iter_mut().zip(greatest) {
        if number.abs() > *most {
            *number = most.copysign(*number);
        }
    }
}

/// Whether a time is in the range of a flight.
pub(super) fn time_is_plausible(time: f64) -> bool {
    (0.0..=TIME_MAX).contains(&time)
}
