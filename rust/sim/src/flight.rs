//! The closed-loop flight: the loop that connects robot and controller.
//!
//! At tick k, t = k h:
//!
//! ```text
//! observe   kinematics and aerodynamic forces at x_k in the wind of t
//! measure   what the controller is given: sensors, outages, errors of the measured wind
//! tick      thrust rates and torques from (x_k, T_k, wind), held until the next tick
//! record    and stop if the flight is lost
//! advance   x_{k+1} from x_k, T_k and the torques;  T_{k+1} = T_k + h Ṫ*
//! ```
//!
//! This is the published order of execution with its unit delays written out: the published physics block is first in a
//! tick and uses the outputs of the tick before. Equation M77 of `docs/model`.

use crate::log::{FlightLog, Series};
use crate::outcome::{FlightResult, Judge, Loss, LossReason, Outcome};
use crate::plant::Plant;
use crate::scenario::{NoResult, Scenario};
use crate::signals::{TickRow, TrackingErrors, WorldRow, feet_of};
use crate::summary::Summary;
use crate::wind::Wind;
use crate::world::Seen;
use flight_core::control::{BadCommand, BadStart, Controller, ControllerState, Given, Measurement, Modes};
use flight_core::error::BuildError;
use flight_core::robot::RobotModel;
use nalgebra::Vector3;
use std::ops::ControlFlow;

/// A flight in progress.
#[derive(Debug)]
pub struct Flight {
    scenario: Scenario,
    log: FlightLog,
    /// `None` before the first tick.
    state: Option<ControllerState>,
    loss: Option<Loss>,
    /// Why it cannot begin; then it has no tick and no result.
    refusal: Option<BadStart>,
    /// Whether the robot has given up its mission and touched down.
    is_down: bool,
    /// Index of the next tick.
    tick: usize,
    /// Whether that tick is observed and measured.
    is_measured: bool,
    /// Velocity of the air in it \[m/s\].
    air: Vector3<f64>,
    /// What its world shows; `None` without one.
    seen: Option<Seen>,
    /// Number of each foot of the robot among the controller's.
    feet: Vec<Option<usize>>,
    /// Thrust rates of the tick \[N/s\].
    thrust_rate: Vec<f64>,
}

impl Scenario {
    /// The flight before its first tick.
    #[must_use]
    pub fn begin(self) -> Flight {
        let robot = self.plant.robot();
        let (has_ground, rows) = (self.world.is_some(), self.n_ticks + 1);
        let log = if has_ground { FlightLog::with_ground } else { FlightLog::new };
        Flight {
            log: log(robot, rows),
            state: None,
            loss: None,
            refusal: None,
            is_down: false,
            tick: 0,
            is_measured: false,
            air: Vector3::zeros(),
            seen: has_ground.then(|| Seen::new(robot)),
            feet: feet_of(robot, &self.controller.model().feet),
            thrust_rate: vec![0.0; robot.jets.len()],
            scenario: self,
        }
    }

    /// Flies to the end, or until the flight is lost. `progress(tick, n_ticks)` is called every tick and can stop the
    /// flight.
    ///
    /// # Errors
    /// [`NoResult`] if `progress` stopped the flight, and if it cannot begin with its first measurement.
    pub fn run(
        self,
        mut progress: impl FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<FlightResult, NoResult> {
        let mut flight = self.begin();
        while !flight.has_ended() {
            let tick = flight.tick;
            if flight.step() && progress(tick, flight.n_ticks()).is_break() {
                return Err(NoResult::Interrupted);
            }
        }
        flight.refusal.map_or_else(|| Ok(flight.result()), |refusal| Err(refusal.into()))
    }
}

impl Flight {
    /// Flies one tick; `false` if the flight is lost in it, cannot begin, or had ended before.
    pub fn step(&mut self) -> bool {
        // Only a given command can be refused.
        self.step_with(&Given::default(), None).unwrap_or(false)
    }

    /// Flies one tick, as [`Self::step`], with what is given to the controller beside its measurement, but for a preview, which
    /// is that of the sensors, and thrust rates \[N/s\] and joint torques \[N m, N\] that act in place of the controller's.
    ///
    /// # Errors
    /// [`BadCommand`] for a command with a number that is not finite, or of another robot's size; nothing then changes.
    pub fn step_with(
        &mut self,
        given: &Given,
        command: Option<(&[f64], &[f64])>,
    ) -> Result<bool, BadCommand> {
        if self.has_ended() {
            return Ok(false);
        }
        if let Some((thrust_rate, joint_torque)) = command {
            self.scenario.controller.check_command(thrust_rate, joint_torque)?;
        }
        self.measure();
        let reason = match self.start() {
            Ok(()) => {
                self.control(given, command)?;
                self.record()
            }
            Err(refusal) => {
                let reason = self.divergence();
                self.refusal = Some(refusal).filter(|_| reason.is_none());
                reason
            }
        };
        self.loss = reason.map(|reason| Loss { time: self.time(), reason });
        if self.loss.is_none() && !self.is_down && self.touches_down() {
            self.is_down = true;
            self.loss = self.crash().map(|reason| Loss { time: self.time(), reason });
        }
        if !self.has_ended() {
            self.advance(command.map(|(_, torque)| torque));
        }
        Ok(self.loss.is_none() && self.refusal.is_none())
    }

    /// Whether the robot descends instead of following its mission.
    fn is_descending(&self) -> bool {
        self.state.is_some() && self.scenario.controller.command().modes.contains(Modes::DESCENDING)
    }

    /// Whether it descends and touches the ground, whose height above the start is configured where the world has none.
    fn touches_down(&self) -> bool {
        let is_low = || {
            let com = self.log.series("com_position").map_or(&[][..], |series| &series.data);
            matches!(com, [_, _, first, .., last] if *last <= first + self.scenario.ground_height)
        };
        let carries = |seen: &Seen| seen.foot_wrenches.iter().any(|wrench| wrench.z > 0.0);
        self.is_descending() && self.seen.as_ref().map_or_else(is_low, carries)
    }

    /// Reason why this touch-down is a crash, if it is. The ground has slowed the robot within its first tick: the velocity is
    /// then that of the tick before.
    fn crash(&self) -> Option<LossReason> {
        let before = 1 + usize::from(self.seen.is_some());
        let row =
            |series: &Series| Vector3::from_column_slice(series.row(self.log.len().saturating_sub(before)));
        let velocity = self.log.series("com_velocity").map_or_else(Vector3::zeros, row);
        Judge::crash(&velocity, libm::acos(self.scenario.plant.state().base.rotation[(2, 2)].min(1.0)))
    }

    /// Observes the robot at the next tick, and measures it. Does nothing where that is done.
    fn measure(&mut self) {
        if self.is_measured {
            return;
        }
        self.is_measured = true;
        let (time, Self { scenario, air, seen, feet, .. }) = (self.time(), self);
        let Scenario { plant, world, wind, measuring, .. } = scenario;
        *air = wind.velocity(time);
        if let (Some(world), Some(seen)) = (world, &mut *seen) {
            world.observe(seen);
            plant.place(&seen.state);
        }
        plant.observe(air);
        let state = seen.as_ref().map_or(plant.state(), |seen| &seen.measured);
        let wrenches = seen.iter().flat_map(|seen| &seen.foot_wrenches);
        let used =
            feet.iter().zip(wrenches).filter_map(|(foot, wrench)| Some((foot.as_ref().copied()?, *wrench)));
        measuring.measure(time, (state, plant.jets().thrust_feedback()), used, air);
    }

    /// Starts the controller with its first measurement.
    fn start(&mut self) -> Result<(), BadStart> {
        if self.state.is_none() {
            let Scenario { controller, measuring, .. } = &mut self.scenario;
            self.state = Some(controller.start(measuring.sample())?);
        }
        Ok(())
    }

    /// Ticks the controller.
    fn control(&mut self, given: &Given, replacing: Option<(&[f64], &[f64])>) -> Result<(), BadCommand> {
        let Scenario { controller, measuring, wind, .. } = &mut self.scenario;
        let (measurement, preview) = measuring.look_ahead(wind);
        let Some(state) = &mut self.state else { return Ok(()) };
        let command = controller.tick_with(state, measurement, &Given { preview, ..*given });
        if self.tick == 0 || command.modes.contains(Modes::BEGUN_AGAIN) {
            self.log.joint_setpoint = state.posture().as_slice().to_vec();
        }
        if let Some((thrust_rate, joint_torque)) = replacing {
            controller.replace_command(state, thrust_rate, joint_torque)?;
        }
        Ok(())
    }

    /// Appends a row to the log; returns the reason why the flight is lost, if it is.
    fn record(&mut self) -> Option<LossReason> {
        let Some(state) = &self.state else { return None };
        let Scenario { plant, controller, measuring, judge, .. } = &self.scenario;
        let (terms, command) = (controller.terms(), controller.command());
        let errors = TrackingErrors::new(plant, &terms.setpoint);
        let tick = TickRow { measurement: measuring.sample(), state, terms, command, feet: &self.feet };
        self.log.push(&tick, Some(&WorldRow { wind: self.air, plant, errors, seen: self.seen.as_ref() }));
        judge.loss(plant, &self.air, &errors)
    }

    /// Advances the robot to the next tick, under the controller's torques or given ones \[N m, N\].
    fn advance(&mut self, given: Option<&[f64]>) {
        let (time, Self { scenario, state, seen, air, thrust_rate, .. }) = (self.time(), &mut *self);
        let Scenario { plant, world, controller, measuring, time_step, .. } = scenario;
        let period = *time_step / f64::from(plant.torque_steps());
        thrust_rate.copy_from_slice(controller.command().thrust_rate.as_slice());
        let command = |part: u32, robot: &_, torque: &mut [f64]| {
            if let (1.., None, Some(state)) = (part, given, state.as_mut()) {
                let joints = measuring.measure_joints(time, f64::from(part) * period, robot);
                controller.tick_torques(state, &joints);
            }
            torque.copy_from_slice(controller.command().joint_torque.as_slice());
        };
        match (world, seen) {
            (Some(world), Some(seen)) => {
                plant.advance_in((&mut **world, seen), thrust_rate, *time_step, command);
            }
            _ => plant.advance_in_steps(thrust_rate, air, *time_step, command),
        }
        self.tick += 1;
        self.is_measured = false;
    }

    fn divergence(&self) -> Option<LossReason> {
        Judge::divergence(&self.scenario.plant, &self.air)
    }

    /// Whether the last tick has been flown, the flight is lost, or the robot has touched down where it cannot stand.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        let has_landed = self.is_down && self.seen.is_none();
        let has_begun = self.refusal.is_none();
        self.loss.is_some() || !has_begun || has_landed || self.tick > self.scenario.n_ticks
    }

    /// Index of the next tick; of a flight that ended early, of its last tick.
    #[must_use]
    pub fn tick(&self) -> usize {
        self.tick
    }

    /// Number of ticks after the one at time zero.
    #[must_use]
    pub fn n_ticks(&self) -> usize {
        self.scenario.n_ticks
    }

    /// Time of [`Self::tick`] \[s\].
    #[must_use]
    pub fn time(&self) -> f64 {
        self.tick as f64 * self.scenario.time_step
    }

    /// What the controller is given in the next tick.
    pub fn measurement(&mut self) -> &Measurement {
        self.measure();
        self.scenario.measuring.sample()
    }

    /// The same, to be changed.
    pub fn sample_mut(&mut self) -> &mut Measurement {
        self.measure();
        self.scenario.measuring.sample_mut()
    }

    /// The simulated robot at the next tick, and the velocity of the air \[m/s\].
    pub fn truth(&mut self) -> (&Plant, &Vector3<f64>) {
        self.measure();
        (&self.scenario.plant, &self.air)
    }

    /// Computes the next tick with a copy of the controller's state, which is returned, and does not advance; the values of
    /// this tick are those of [`Self::controller`].
    ///
    /// # Errors
    /// [`BadStart`] if the flight cannot begin.
    pub fn try_tick(&mut self) -> Result<ControllerState, BadStart> {
        self.measure();
        let Self { scenario: Scenario { controller, measuring, wind, .. }, state, .. } = self;
        let (measurement, preview) = measuring.look_ahead(wind);
        let mut copy = match state {
            Some(state) => state.clone(),
            None => controller.start(measurement)?,
        };
        controller.tick_with(&mut copy, measurement, &Given { preview, ..Given::default() });
        Ok(copy)
    }

    /// The controller, with the values of its last tick.
    #[must_use]
    pub fn controller(&self) -> &Controller {
        &self.scenario.controller
    }

    /// State of the controller; `None` before the first tick.
    #[must_use]
    pub fn controller_state(&self) -> Option<&ControllerState> {
        self.state.as_ref()
    }

    /// Log of the ticks flown so far.
    #[must_use]
    pub fn log(&self) -> &FlightLog {
        &self.log
    }

    /// The simulated robot.
    #[must_use]
    pub fn robot(&self) -> &RobotModel {
        self.scenario.plant.robot()
    }

    /// Changes the wind from the next tick on. With `mean_only` the mean remains that of the configured wind.
    pub fn set_wind(&mut self, wind: Wind) {
        self.scenario.wind = wind;
    }

    /// Replaces the aerodynamic forces from the next tick on, as [`Plant::replace_link_forces`].
    ///
    /// # Errors
    /// As [`Plant::replace_link_forces`].
    pub fn replace_link_forces(&mut self, forces_i: Option<Vec<Vector3<f64>>>) -> Result<(), BuildError> {
        self.scenario.plant.replace_link_forces(forces_i)
    }

    /// Time and reason of the loss, if the flight was lost.
    #[must_use]
    pub fn loss(&self) -> Option<Loss> {
        self.loss
    }

    /// Why the flight cannot begin, if it cannot.
    #[must_use]
    pub fn refusal(&self) -> Option<BadStart> {
        self.refusal
    }

    /// Figures of merit of the ticks flown so far.
    #[must_use]
    pub fn summary(&self) -> Summary {
        // Physically impossible numbers are in the log, but not in the figures of merit.
        let is_excluded = self.loss.is_some_and(|loss| loss.reason.outcome() == Outcome::Diverged);
        Summary::new(&self.log, self.log.len().saturating_sub(usize::from(is_excluded)))
    }

    /// Outcome of the flight; before its end, as if it ended now.
    #[must_use]
    pub fn outcome(&self, summary: &Summary) -> Outcome {
        let descending = self.is_descending().then_some(Outcome::Landing);
        let descent = if self.is_down { Some(Outcome::Landed) } else { descending };
        Judge::outcome(self.loss, descent, summary)
    }

    /// Result of the flight.
    #[must_use]
    pub fn result(self) -> FlightResult {
        let summary = self.summary();
        FlightResult { outcome: self.outcome(&summary), loss: self.loss, log: self.log, summary }
    }
}
