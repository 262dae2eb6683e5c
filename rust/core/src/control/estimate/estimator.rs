//! State estimator for the control law: the robot's model, corrected by delayed measurements and integrated to the
//! present.
//!
//! ```text
//! measurements of age d ──► stored until all have the greatest age D ──► correct x̂(t − D)
//! x̂(t − D) ──► D ticks of the model under the commands given then ──► x̂(t), for the controller
//!                   each corrected by what has been measured of it so far
//! ```
//!
//! The control law assumes measurements without delay and noise, and commands that act at once; the estimator provides
//! the former, and the state in which a late command begins to act. Forces that are not in the model enter through the
//! controller's observed wrench. Without delays, latency and time constants the estimate equals the measurement.
//!
//! Equations M91 to M93, M145 and M150 of `docs/model`.

mod config;

pub use config::{EstimatorConfig, FilterConfig, LatencyConfig};

use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::control::acting::Acting;
use crate::control::law::contact::WRENCH;
use crate::control::measure::measurement::{BETWEEN_MAX, Channel, Measurement};
use crate::dynamics::{Dynamics, MassFactor};
use crate::error::BuildError;
use crate::jets::{JetDynamics, JetModel};
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use crate::spatial::{GREATEST, exp_so3, log_so3, project_to_so3};
use crate::timing::{ROUNDING, share};
use nalgebra::{DVector, Vector3, Vector6};

/// Greatest latency of torques beyond the configured one that is used when it is measured \[s\].
pub const LATENCY_UNKNOWN: f64 = 0.05;

/// Channels whose gaps are counted, in the order of the configuration.
const BASE: [Channel; 4] =
    [Channel::Position, Channel::Rotation, Channel::LinearVelocity, Channel::AngularVelocity];

/// Inputs of the model from one tick to the next.
#[derive(Debug, Clone, PartialEq)]
struct Order {
    torque: Vec<f64>,
    thrust_rate: Vec<f64>,
    unmodelled: Vector6<f64>,
    wind_i: Vector3<f64>,
    /// Wrenches that keep the feet at rest, foot after foot.
    foot_wrenches: Vec<f64>,
    /// Duration of the input \[s\]; known when the next tick starts.
    duration: f64,
}

/// State of the robot with what its model and its measurements do not contain.
#[derive(Debug, Clone, PartialEq)]
struct Predicted {
    robot: Measurement,
    /// Accelerations of the joints that the model does not explain \[rad/s²\].
    disturbance: DVector<f64>,
    /// Bias of the gyroscopes \[rad/s, base axes\].
    gyro_bias: Vector3<f64>,
    /// Rates of the thrusts \[N/s\].
    thrust_rate: Vec<f64>,
}

impl Predicted {
    fn copy_from(&mut self, other: &Self) {
        self.robot.copy_from(&other.robot);
        self.disturbance.copy_from(&other.disturbance);
        self.gyro_bias = other.gyro_bias;
        self.thrust_rate.copy_from_slice(&other.thrust_rate);
    }
}

/// What acts in a tick: for the share `late` of it one command, then another.
#[derive(Debug, Clone, Copy)]
struct Mixed<'a> {
    late: f64,
    before: &'a [f64],
    after: &'a [f64],
}

impl Mixed<'_> {
    /// Mean of entry `index` over the tick.
    fn at(&self, index: usize) -> f64 {
        if self.late > 0.0 {
            self.late * self.before[index] + (1.0 - self.late) * self.after[index]
        } else {
            self.after[index]
        }
    }
}

/// The robot's model and its workspace.
#[derive(Debug, Clone)]
struct Model {
    robot: RobotModel,
    jets: Vec<JetModel>,
    aero: AeroModel,
    kinematics: Kinematics,
    dynamics: Dynamics,
    link_forces: LinkForces,
    mass_factor: MassFactor,
    acceleration: DVector<f64>,
}

impl Model {
    /// Advances the model by `duration` \[s\] with semi-implicit Euler (M92) under the inputs of `order`, with the torques
    /// and thrust rates that act.
    fn advance(
        &mut self,
        estimate: &mut Predicted,
        (order, duration): (&Order, f64),
        (torque, thrust_rate): (Mixed, Mixed),
    ) {
        let Predicted { robot: Measurement { state, thrust, .. }, disturbance, thrust_rate: rates, .. } =
            estimate;
        let Self { robot, jets, aero, kinematics, dynamics, link_forces, mass_factor, acceleration } = self;
        kinematics.update(robot, state);
        dynamics.update(robot, state, kinematics);
        link_forces.update(robot, kinematics, LinkConventions::default(), aero, &order.wind_i);
        acceleration.copy_from(&dynamics.bias);
        acceleration.neg_mut();
        for joint in 0..disturbance.len() {
            acceleration[6 + joint] += torque.at(joint);
        }
        kinematics.add_thrusts(robot, thrust.iter().copied(), acceleration);
        for (foot, wrench) in robot.feet.iter().zip(order.foot_wrenches.chunks_exact(WRENCH)) {
            let (sole, wrench) = (kinematics.frame_pose(&foot.frame), Vector6::from_column_slice(wrench));
            kinematics.add_generalised_wrench(foot.frame.body, &sole.position, &wrench, acceleration);
        }
        link_forces.add_generalised_force(robot, kinematics, acceleration);
        if !mass_factor.factorise(&dynamics.mass_matrix) {
            return;
        }
        mass_factor.solve_in_place(acceleration);
        // The point where the unmodelled wrench acts is unknown. Unexplained joint accelerations are internal and must not
        // change the momentum.
        let mut wrench = order.unmodelled;
        for (joint, extra) in disturbance.iter().enumerate() {
            acceleration[6 + joint] += extra;
            wrench -= dynamics.momentum_matrix.column(6 + joint) * *extra;
        }
        dynamics.add_whole_acceleration(kinematics, &wrench, acceleration);
        state.velocity.axpy(duration, acceleration, 1.0);
        state.advance_pose(duration);
        for (index, ((thrust, rate), jet)) in thrust.iter_mut().zip(rates).zip(jets).enumerate() {
            (*thrust, *rate) = jet.advance(*thrust, *rate, thrust_rate.at(index), duration);
        }
    }
}

/// How measurements correct an estimate.
#[derive(Debug, Clone)]
struct Gains {
    /// Age of each channel on arrival in ticks, in the order of the configuration.
    delays: [usize; 7],
    /// Fraction of each channel's innovation that corrects the estimate.
    shares: [f64; 7],
    /// Fractions of the joint position innovation that correct velocities, per tick, and accelerations, per tick
    /// squared.
    by_position: [f64; 2],
    /// Fraction of the rate with which the rotation is corrected that the bias of the gyroscopes receives.
    of_bias: f64,
}

impl Gains {
    /// Corrects an estimate by the measurements of its time that have arrived, the last of which is number `last` in
    /// `line`, with their gaps; it is as old as measurements without delay of `since` ticks ago, `None` if it is younger. `step` is the
    /// duration of the tick before it \[s\] (M91, M93, M145).
    fn correct(
        &self,
        estimate: &mut Predicted,
        (line, gaps): (&[Measurement], &[[u8; 4]]),
        last: usize,
        since: Option<usize>,
        step: f64,
    ) {
        let Predicted { robot, disturbance, gyro_bias, .. } = estimate;
        let arrived = self.delays.map(|delay| since.and_then(|since| since.checked_sub(delay)));
        let place = |since: Option<usize>| (last + line.len() - since.unwrap_or(0)) % line.len();
        let measured = arrived.map(|since| &line[place(since)]);
        // A measurement after a gap corrects as much as one in every tick of it would have.
        let share = |channel: usize| {
            let Some(since) = arrived[channel] else { return 0.0 };
            let gap = gaps[place(Some(since))].get(channel).copied().unwrap_or(0);
            let once = self.shares[channel];
            (0..gap).fold(once, |share, _| share + (1.0 - share) * once)
        };
        let shares = std::array::from_fn(share);
        if arrived[4].is_some() {
            let [of_velocity, of_acceleration] = self.by_position;
            for joint in 0..disturbance.len() {
                let found = robot.state.joint_position[joint];
                let innovation = prefer_measured(measured[4].state.joint_position[joint], found) - found;
                robot.state.velocity[6 + joint] += of_velocity / step * innovation;
                disturbance[joint] += of_acceleration / (step * step) * innovation;
            }
        }
        let turned = correct(robot, measured, &shares, gyro_bias);
        *gyro_bias -= self.of_bias / step * turned;
    }
}

/// State estimator of one robot, with its workspace; its state is an [`EstimatorState`].
#[derive(Debug, Clone)]
pub struct Estimator {
    model: Model,
    time_step: f64,
    /// Age of the oldest channel on arrival in ticks.
    waiting: usize,
    /// Greatest gap of a channel that counts, in ticks.
    gap_max: u8,
    /// Latencies of torques and thrust rates \[ticks\], and the greatest that is used.
    latency: LatencyConfig,
    latency_max: f64,
    gains: Gains,
    /// Fractions of an unmodelled force and moment that appear in the estimated momentum per tick: those of lags with
    /// age and time constant of the linear and of the angular velocity.
    pub momentum_fractions: [f64; 2],
    /// The estimate on its way to the present.
    ahead: Predicted,
}

/// State of the estimator, kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimatorState {
    /// The last measurements: a ring buffer of the greatest age plus one.
    line: Vec<Measurement>,
    /// For how many ticks before each measurement its position, rotation and velocities of the base were missing.
    gaps: Vec<[u8; 4]>,
    /// The same of the next measurement.
    gap: [u8; 4],
    /// The last inputs, a ring buffer that reaches back to the thrust rates under the oldest measurement.
    orders: Vec<Order>,
    /// Number of measurements processed.
    ticks: usize,
    /// Estimate at the greatest age.
    then: Predicted,
    /// Latency of the torques, where it is not as configured \[s\].
    torque_latency: Option<f64>,
}

impl Estimator {
    /// Builds an estimator with models of the robot and of its aerodynamics, updated every `time_step` \[s\].
    ///
    /// # Errors
    /// As [`EstimatorConfig::check`].
    pub fn new(
        config: &EstimatorConfig,
        robot: RobotModel,
        jet_dynamics: JetDynamics,
        aero: AeroModel,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        config.check()?;
        let channels = config.channels().map(|(_, channel)| *channel);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 0.2 s
        let ticks = |time: f64| (time / time_step).round() as usize;
        let mut delays = channels.map(|channel| ticks(channel.delay));
        let share = |time: f64| share(time_step / time);
        let mut shares = channels.map(|channel| share(channel.time_constant));
        let mut by_position = [0.0; 2];
        if let Some(time) = config.joint_observer {
            // Observer gains that place all three poles at e^(-Δt/T).
            let (left, pole) = (share(time), 1.0 - share(time));
            (delays[5], shares[4], shares[5]) = (0, 1.0 - pole * pole * pole, 0.0);
            by_position = [left * left * (1.0 + 2.0 * pole), left * left * left];
        }
        let joints = robot.joints.len();
        let model = Model {
            kinematics: Kinematics::new(&robot),
            dynamics: Dynamics::new(&robot),
            link_forces: LinkForces::new(&robot),
            mass_factor: MassFactor::new(6 + joints),
            acceleration: DVector::zeros(6 + joints),
            jets: robot.jet_models(jet_dynamics),
            robot,
            aero,
        };
        let waiting = delays.into_iter().max().unwrap_or(0);
        let latency = config.latency;
        let (whole, [left, _]) = latency.in_ticks(time_step);
        let momentum_fractions = [2, 3]
            .map(|of| share(((whole + delays[of]) as f64 + left) * time_step + channels[of].time_constant));
        let of_bias = config.gyro_bias.map_or(0.0, share);
        let ahead = Predicted {
            robot: Measurement::zero(joints, model.robot.jets.len(), model.robot.feet.len()),
            disturbance: DVector::zeros(joints),
            gyro_bias: Vector3::zeros(),
            thrust_rate: vec![0.0; model.robot.jets.len()],
        };
        let gains = Gains { delays, shares, by_position, of_bias };
        let latency_max = latency.torque + LATENCY_UNKNOWN;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most 255
        let gap_max = (BETWEEN_MAX / time_step + ROUNDING).min(255.0) as u8;
        Ok(Self {
            model,
            time_step,
            waiting,
            gap_max,
            latency,
            latency_max,
            gains,
            momentum_fractions,
            ahead,
        })
    }

    /// State before the first measurement, for a flight that starts from `first`.
    #[must_use]
    pub fn start(&self, first: &Measurement) -> EstimatorState {
        let (joints, jets) = (self.model.robot.joints.len(), self.model.robot.jets.len());
        let order = Order {
            torque: vec![0.0; joints],
            thrust_rate: vec![0.0; jets],
            unmodelled: Vector6::zeros(),
            wind_i: Vector3::zeros(),
            foot_wrenches: vec![0.0; WRENCH * self.model.robot.feet.len()],
            duration: self.time_step,
        };
        EstimatorState {
            line: vec![first.clone(); 1 + self.waiting],
            gaps: vec![[0; 4]; 1 + self.waiting],
            gap: [0; 4],
            orders: vec![order; self.orders()],
            ticks: 0,
            then: Predicted {
                robot: first.clone(),
                disturbance: DVector::zeros(joints),
                gyro_bias: Vector3::zeros(),
                thrust_rate: vec![0.0; jets],
            },
            torque_latency: None,
        }
    }

    /// Number of inputs that are stored: those that the step to the oldest estimate needs.
    fn orders(&self) -> usize {
        1 + self.waiting + reach(self.latency_max.max(self.latency.thrust) / self.time_step)
    }

    /// Numbers of measurements and of inputs that its states store.
    #[must_use]
    pub fn sizes(&self) -> [usize; 2] {
        [1 + self.waiting, self.orders()]
    }

    /// Returns the estimate at the present time from the measurement in [`EstimatorState::next_measurement`]. Does not allocate.
    ///
    /// The first measurement starts the flight: its plausible numbers also stand for the time before it. Implausible
    /// numbers correct nothing; the model's prediction replaces them. An estimate that is not finite restarts from the
    /// measurement.
    ///
    /// `elapsed` is the time since the last measurement \[s\], rounded to whole time steps; delays count measurements.
    /// `thrust_innovation` returns the correction of each thrust by the measurement \[N\], `thrust_rate` the rate of each
    /// when the thrust rates of this tick begin to act \[N/s\].
    pub fn update(
        &mut self,
        memory: &mut EstimatorState,
        elapsed: f64,
        thrust_innovation: &mut [f64],
        thrust_rate: &mut [f64],
    ) -> &Measurement {
        memory.last_order().duration = self.time_step * (elapsed / self.time_step).round().max(1.0);
        let Self { model, time_step, waiting, gap_max, latency, latency_max, gains, ahead, .. } = self;
        let EstimatorState { line, gaps, gap, orders, ticks, then, torque_latency } = memory;
        let torque = torque_latency.map_or(latency.torque, |torque| torque.clamp(0.0, *latency_max));
        let acting_in = LatencyConfig { torque, thrust: latency.thrust.max(torque) };
        // Ages count from when the torques of this tick begin to act, in whole ticks.
        let (latency, [torque, thrust]) = acting_in.in_ticks(*time_step);
        let (waiting, oldest, length) = (*waiting, latency + *waiting, line.len());
        // Inputs of `age` ticks ago; the first ones also stand for the time before (M140).
        let given = |age: usize| &orders[ticks.saturating_sub(age) % orders.len()];
        // Torques and thrust rates that act under these inputs, with the shares of the earlier ones.
        let acting = |age: usize, late: [f64; 2]| {
            let sent = |lag: f64| (given(age + reach(lag)), given(age + whole(lag)));
            let ((torques, next_torques), (rates, next_rates)) = (sent(torque), sent(thrust));
            (
                Mixed { late: late[0], before: &torques.torque, after: &next_torques.torque },
                Mixed { late: late[1], before: &rates.thrust_rate, after: &next_rates.thrust_rate },
            )
        };
        let late = [torque, thrust.fract()];
        let begun = *ticks > waiting;
        // Duration of the step that leads to `then`.
        let step = if begun { given(oldest + 1).duration } else { *time_step };
        if let (0, Some((now, others))) = (*ticks, line.split_first_mut()) {
            for measured in others {
                measured.copy_from(now);
            }
            take_over(&mut then.robot, now);
            gaps.fill([0; 4]);
            *gap = [0; 4];
        }
        let now = &line[*ticks % length];
        gaps[*ticks % length] = *gap;
        for (gap, channel) in gap.iter_mut().zip(BASE) {
            *gap = if now.is_measured(channel) { 0 } else { (*gap + 1).min(*gap_max) };
        }
        if begun {
            model.advance(then, (given(oldest + 1), step), acting(oldest + 1, late));
        }
        if !then.robot.state.is_finite() || then.robot.thrust.iter().any(|thrust| !thrust.is_finite()) {
            then.robot.copy_from(now);
            then.disturbance.fill(0.0);
            then.gyro_bias.fill(0.0);
            then.thrust_rate.fill(0.0);
        }
        thrust_innovation.copy_from_slice(&then.robot.thrust);
        gains.correct(then, (line, gaps), *ticks, Some(waiting), step);
        for (innovation, corrected) in thrust_innovation.iter_mut().zip(&then.robot.thrust) {
            *innovation = corrected - *innovation;
        }
        ahead.copy_from(then);
        if *ticks > 0 {
            // What is younger than the latest measurement is only predicted: its age is below all of the channels.
            for age in (0..latency + waiting.min(*ticks)).rev() {
                let order = given(age + 1);
                model.advance(ahead, (order, order.duration), acting(age + 1, late));
                gains.correct(ahead, (line, gaps), *ticks, age.checked_sub(latency), order.duration);
            }
            if torque > 0.0 {
                // To when the torques of this tick begin to act.
                let part = torque * *time_step;
                model.advance(ahead, (given(1), part), acting(0, [1.0; 2]));
            }
        }
        // When this tick's thrust rates begin to act, those on their way have acted.
        for (jet, (to, model)) in thrust_rate.iter_mut().zip(&model.jets).enumerate() {
            let mut reached = (ahead.robot.thrust[jet], ahead.thrust_rate[jet]);
            for age in (1..=whole(thrust)).rev() {
                reached = model.advance(reached.0, reached.1, given(age).thrust_rate[jet], *time_step);
            }
            *to = reached.1;
        }
        *ticks += 1;
        &ahead.robot
    }
}

impl EstimatorState {
    /// Where the measurement of the next update is written; numbers that are not finite are not measured.
    pub fn next_measurement(&mut self) -> &mut Measurement {
        let length = self.line.len();
        &mut self.line[self.ticks % length]
    }

    /// Restarts from the next measurement, because the estimates before it are worth nothing. The last inputs stand for all
    /// before.
    pub fn restart(&mut self) {
        let last = self.last();
        self.orders.swap(0, last);
        self.ticks = 0;
    }

    /// Uses this latency of the torques \[s\] in place of the configured one, from the next tick on. Not more than
    /// [`LATENCY_UNKNOWN`] beyond that is used.
    pub fn use_torque_latency(&mut self, latency: f64) {
        self.torque_latency = Some(latency);
    }

    /// Subtracts the error `deviation` \[N\] of a jet's sensor from its thrust; its stored measurements are discarded.
    pub fn correct_thrust(&mut self, jet: usize, deviation: f64) {
        self.then.robot.thrust[jet] -= deviation;
        for measured in &mut self.line {
            measured.thrust[jet] = f64::NAN;
        }
    }

    /// Stores the inputs from this tick to the next: the command, the observed wrench, and the wind that the controller
    /// uses \[m/s\], which is finite whatever is measured.
    pub fn command(&mut self, acting: &Acting, unmodelled: &Vector6<f64>, wind_i: &Vector3<f64>) {
        self.replace_command(acting);
        let order = self.last_order();
        order.unmodelled = *unmodelled;
        order.wind_i = *wind_i;
        order.foot_wrenches.copy_from_slice(acting.foot_wrenches.as_slice());
    }

    /// Replaces thrust rates and torques that act from this tick to the next.
    pub fn replace_command(&mut self, acting: &Acting) {
        let order = self.last_order();
        order.torque.copy_from_slice(acting.torque.as_slice());
        order.thrust_rate.copy_from_slice(acting.thrust_rate.as_slice());
    }

    fn last_order(&mut self) -> &mut Order {
        let last = self.last();
        &mut self.orders[last]
    }

    /// Place of the last inputs.
    fn last(&self) -> usize {
        (self.ticks + self.orders.len() - 1) % self.orders.len()
    }
}

/// Whole ticks of a lag.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 0.2 s
fn whole(lag: f64) -> usize {
    lag.floor() as usize
}

/// Ticks that a lag reaches back.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 0.2 s
fn reach(lag: f64) -> usize {
    lag.ceil() as usize
}

/// Copies the numbers of `measured` that are plausible and keeps the others.
fn take_over(to: &mut Measurement, measured: &Measurement) {
    let Measurement { state: to, thrust: to_thrust, .. } = to;
    let Measurement { state, thrust, .. } = measured;
    let take = |to: &mut f64, measured| *to = prefer_measured(measured, *to);
    to.base.position.zip_apply(&state.base.position, take);
    to.base.rotation.zip_apply(&state.base.rotation, take);
    to.joint_position.zip_apply(&state.joint_position, take);
    to.velocity.zip_apply(&state.velocity, take);
    for (to, measured) in to_thrust.iter_mut().zip(thrust) {
        take(to, *measured);
    }
}

/// The measurement, or the estimate if the measurement is implausible.
fn prefer_measured(measured: f64, estimate: f64) -> f64 {
    if measured.abs() <= GREATEST { measured } else { estimate }
}

/// Corrects an estimate by measurements of its time, each with its fraction (M91), those of the gyroscopes less their
/// bias. Returns by how much the rotation was corrected \[rad, base axes\].
fn correct(
    estimate: &mut Measurement,
    measured: [&Measurement; 7],
    shares: &[f64; 7],
    gyro_bias: &Vector3<f64>,
) -> Vector3<f64> {
    let [position, rotation, linear, angular, joints, joint_velocities, thrusts] = measured;
    let Measurement { state, thrust, .. } = estimate;
    let (rotation_now, turning) = (state.base.rotation, state.base_angular_velocity());
    let gyro_now = rotation_now.transpose() * turning;
    let rotation_measured = angular.state.base.rotation.zip_map(&rotation_now, prefer_measured);
    let expected = turning + rotation_now * gyro_bias;
    let turning_measured = angular.state.base_angular_velocity().zip_map(&expected, prefer_measured);
    let gyro_measured = rotation_measured.transpose() * turning_measured - gyro_bias;
    let gyro_now = gyro_now + shares[3] * (gyro_measured - gyro_now);
    let turn = shares[1]
        * log_so3(
            &(rotation_now.transpose()
                * rotation.state.base.rotation.zip_map(&rotation_now, prefer_measured)),
        );
    let place = state.base.position;
    state.base.position +=
        shares[0] * (position.state.base.position.zip_map(&place, prefer_measured) - place);
    state.base.rotation = project_to_so3(&(state.base.rotation * exp_so3(&turn)));
    let linear_now = state.base_linear_velocity();
    let linear_measured = linear.state.base_linear_velocity().zip_map(&linear_now, prefer_measured);
    let linear_now = linear_now + shares[2] * (linear_measured - linear_now);
    let angular_now = state.base.rotation * gyro_now;
    let velocities = state.velocity.as_mut_slice();
    velocities[..3].copy_from_slice(linear_now.as_slice());
    velocities[3..6].copy_from_slice(angular_now.as_slice());
    for (found, measured) in state.joint_position.iter_mut().zip(&joints.state.joint_position) {
        *found += shares[4] * (prefer_measured(*measured, *found) - *found);
    }
    for (found, measured) in velocities[6..].iter_mut().zip(joint_velocities.state.joint_velocity()) {
        *found += shares[5] * (prefer_measured(*measured, *found) - *found);
    }
    for (found, measured) in thrust.iter_mut().zip(&thrusts.thrust) {
        *found = (*found + shares[6] * (prefer_measured(*measured, *found) - *found)).max(0.0);
    }
    turn
}
