//! The closed-loop flight: the one loop that binds plant and controller.
//!
//! At tick k, t = k h:
//!
//! ```text
//! observe   kinematics and aerodynamic forces at x_k in the wind of t
//! control   thrust rates and torques from (x_k, T_k, wind), held until the next tick
//! record    and stop if the flight is lost
//! advance   x_{k+1} from x_k, T_k and the torques;  T_{k+1} = T_k + h Ṫ*
//! ```
//!
//! which is the published order of execution with its unit delays written out: its physics block runs
//! first in a tick, on what the tick before left in the delays. Equation M77 of `docs/model.md`, the end of a flight M80.

use crate::config::{DynamicsBackend, Engine, ScenarioConfig};
use crate::disturbances::WindEstimator;
use crate::log::{FlightLog, FlightResult, LogRow, TrackingErrors};
use crate::plant::Plant;
use crate::summary::Summary;
use crate::wind::Wind;
use flight_core::control::{Controller, ControllerState, Measurement};
use flight_core::error::BuildError;
use flight_core::robot::RobotModel;
use flight_io::load_robot;
use nalgebra::Vector3;
use std::fmt;
use std::ops::ControlFlow;

/// When and why a flight was lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fall {
    /// Time \[s\].
    pub time: f64,
    /// What was exceeded.
    pub reason: FallReason,
}

/// Why a flight was lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FallReason {
    /// Base and desired base are this far apart \[rad\].
    RotationError(f64),
    /// Centre of mass and reference are this far apart \[m\].
    ComError(f64),
    /// The state holds a number that is not finite.
    NotFinite,
}

impl fmt::Display for FallReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RotationError(angle) => write!(f, "rotation error {:.1} deg", angle.to_degrees()),
            Self::ComError(distance) => write!(f, "CoM error {distance:.2} m"),
            Self::NotFinite => write!(f, "state not finite"),
        }
    }
}

/// A flight that is ready to start.
#[derive(Debug)]
pub struct Scenario {
    plant: Plant,
    controller: Controller,
    wind: Wind,
    /// What the controller is given in its place.
    controller_wind: Option<Wind>,
    /// Between the wind and the controller; `None` without errors.
    wind_estimator: Option<WindEstimator>,
    time_step: f64,
    n_ticks: usize,
    max_rotation_error: f64,
    max_com_error: f64,
}

/// A flight that was stopped from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

impl Scenario {
    /// Builds plant and controller.
    ///
    /// # Errors
    /// [`BuildError`] naming what in the configuration cannot be used.
    pub fn new(config: &ScenarioConfig) -> Result<Self, BuildError> {
        let robot = load_robot(&config.robot)?;
        Self::with_robot(config, robot)
    }

    /// Builds a flight of a robot that is loaded already; the configuration's own path is not read.
    ///
    /// # Errors
    /// [`BuildError`] naming what in the configuration cannot be used.
    pub fn with_robot(config: &ScenarioConfig, robot: RobotModel) -> Result<Self, BuildError> {
        for (key, is_there) in [
            ("simulator.ground", config.simulator.ground.is_some()),
            ("simulator.motors", config.simulator.motors.is_some()),
        ] {
            if is_there {
                let expected = "none: this engine knows neither ground nor motors; engine = \"mujoco\" does";
                return Err(BuildError::bad_value(key, "given", expected));
            }
        }
        if config.simulator.dynamics != DynamicsBackend::Tree {
            let expected = "tree; engine = \"jax\" has mjx too";
            return Err(BuildError::bad_value("simulator.dynamics", "mjx", expected));
        }
        Self::build(config, robot)
    }

    /// Refuses a configuration that its own engine cannot fly; reads the robot's files.
    ///
    /// # Errors
    /// [`BuildError`] naming what cannot be used.
    pub fn check(config: &ScenarioConfig) -> Result<(), BuildError> {
        if config.engine == Engine::Jax {
            let mut config = config.clone();
            config.simulator.dynamics = DynamicsBackend::Tree; // it flies either
            return Self::new(&config).map(|_| ());
        }
        if config.engine == Engine::Rust {
            return Self::new(config).map(|_| ());
        }
        if config.simulator.ground.is_none() {
            let expected = "a table: engine = \"mujoco\" flies nothing that has no ground under it";
            return Err(BuildError::bad_value("simulator.ground", "absent", expected));
        }
        if config.controller.law.contact.is_none() {
            let expected = "a table: without feet the controller cannot stand on simulator.ground";
            return Err(BuildError::bad_value("controller.contact", "absent", expected));
        }
        Self::build(config, load_robot(&config.robot)?).map(|_| ())
    }

    fn build(config: &ScenarioConfig, robot: RobotModel) -> Result<Self, BuildError> {
        let time_step = config.simulator.time_step;
        let disturbances = &config.disturbances;
        let plant = Plant::new(robot.clone(), &config.simulator, disturbances)?;
        let (wind, n_ticks) = (Wind::new(&config.wind)?, config.simulator.n_ticks());
        let controller_wind = disturbances.controller_wind.as_ref().map(Wind::new).transpose()?;
        let given = controller_wind.as_ref().unwrap_or(&wind);
        let estimator = |estimate| {
            let times = (0..=n_ticks).map(|tick| tick as f64 * time_step);
            let sum: Vector3<f64> = times.map(|time| given.velocity(time)).sum();
            WindEstimator::new(estimate, time_step, sum / (n_ticks + 1) as f64)
        };
        Ok(Self {
            plant,
            wind_estimator: disturbances.wind_estimate.as_ref().map(estimator).transpose()?,
            controller: config.controller(robot)?,
            wind,
            controller_wind,
            time_step,
            n_ticks,
            max_rotation_error: config.simulator.fall.rotation_error_deg.to_radians(),
            max_com_error: config.simulator.fall.com_error,
        })
    }

    /// Number of ticks after the one at time zero.
    #[must_use]
    pub fn n_ticks(&self) -> usize {
        self.n_ticks
    }

    /// Flies to the end or to the fall. `progress(tick, n_ticks)` is called every tick and may stop
    /// the flight.
    ///
    /// # Errors
    /// [`Interrupted`] if `progress` said so.
    pub fn run(
        mut self,
        mut progress: impl FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<FlightResult, Interrupted> {
        let mut log = FlightLog::new(self.plant.robot(), self.n_ticks + 1);
        let mut state: Option<ControllerState> = None;
        let mut fall = None;
        for tick in 0..=self.n_ticks {
            let time = tick as f64 * self.time_step;
            let wind = self.wind.velocity(time);
            self.plant.observe(&wind);
            let given = self.controller_wind.as_ref().map_or(wind, |wind| wind.velocity(time));
            let estimate = self.wind_estimator.as_mut().map_or(given, |estimator| estimator.update(&given));
            let measurement = Measurement {
                time,
                state: self.plant.state(),
                thrust: self.plant.jets().thrust_feedback(),
                wind: estimate,
                foot_wrenches: &[],
            };
            if state.is_none() {
                state = self.controller.start(&measurement).ok();
            }
            let Some(state) = &mut state else {
                fall = Some(Fall { time, reason: FallReason::NotFinite });
                break;
            };
            self.controller.tick(state, &measurement);
            let command = self.controller.command();
            let errors = TrackingErrors::new(&self.plant, &self.controller.terms().setpoint);
            log.push(&LogRow {
                time,
                wind,
                plant: &self.plant,
                terms: self.controller.terms(),
                command,
                errors,
            });
            fall = self.fall_at(time, &errors);
            if fall.is_some() {
                break;
            }
            let (torque, thrust_rate) = (&command.joint_torque, &command.thrust_rate);
            self.plant.advance(torque.as_slice(), thrust_rate.as_slice(), &wind, self.time_step);
            if progress(tick, self.n_ticks).is_break() {
                return Err(Interrupted);
            }
        }
        log.joint_setpoint = state.map_or_else(Vec::new, |state| state.posture().as_slice().to_vec());
        Ok(FlightResult { fall, summary: Summary::new(&log, log.len()), log })
    }

    fn fall_at(&self, time: f64, errors: &TrackingErrors) -> Option<Fall> {
        let reason =
            if !self.plant.state().is_finite() || !errors.rotation.is_finite() || !errors.com.is_finite() {
                FallReason::NotFinite
            } else if errors.rotation > self.max_rotation_error {
                FallReason::RotationError(errors.rotation)
            } else if errors.com > self.max_com_error {
                FallReason::ComError(errors.com)
            } else {
                return None;
            };
        Some(Fall { time, reason })
    }
}
