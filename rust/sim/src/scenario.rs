//! A configured flight, built and checked.

use crate::config::{AeroKinematics, Backend, DynamicsBackend, Integrator, ScenarioConfig};
use crate::disturbances::JointFaultKind;
use crate::log::FlightLog;
use crate::measuring::Measuring;
use crate::outcome::Judge;
use crate::plant::Plant;
use crate::warnings::warnings;
use crate::wind::Wind;
use crate::world::World;
use flight_core::control::{BadStart, Controller};
use flight_core::error::{BuildError, check};
use flight_core::robot::RobotModel;
use flight_io::{load_changed, load_robot};
use serde::Serialize;
use serde_json::{Value, json};
use std::path::Path;

/// A flight that is ready to start.
#[derive(Debug)]
pub struct Scenario {
    pub(crate) plant: Plant,
    /// What moves the robot in place of the plant's rigid bodies.
    pub(crate) world: Option<Box<dyn World>>,
    pub(crate) controller: Controller,
    pub(crate) wind: Wind,
    pub(crate) measuring: Measuring,
    pub(crate) judge: Judge,
    /// Height of the ground above that of the start \[m\].
    pub(crate) ground_height: f64,
    pub(crate) time_step: f64,
    pub(crate) n_ticks: usize,
}

/// Reason why a flight has no result.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoResult {
    /// The caller stopped it.
    #[error("interrupted")]
    Interrupted,
    /// It cannot begin with its first measurement.
    #[error(transparent)]
    Refused(#[from] BadStart),
}

impl Scenario {
    /// Builds plant and controller.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part of the configuration.
    pub fn new(config: &ScenarioConfig) -> Result<Self, BuildError> {
        let robot = load_robot(&config.robot)?;
        Self::with_robot(config, robot)
    }

    /// Builds a flight with a robot that is already loaded; the path in the configuration is not read.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part of the configuration.
    pub fn with_robot(config: &ScenarioConfig, robot: RobotModel) -> Result<Self, BuildError> {
        config.check_drives()?;
        Self::build(config, robot)
    }

    /// Builds it, whether or not the robot has the drives of the controller's model: in another world they are that world's.
    fn build(config: &ScenarioConfig, robot: RobotModel) -> Result<Self, BuildError> {
        let time_step = config.controller.law.time_step;
        let disturbances = &config.disturbances;
        let torque_steps = config.controller.law.torque.steps;
        let plant = Plant::new(robot.clone(), &config.simulator, disturbances, &config.controller.law)?;
        if let Some(sensors) = config.simulator.sensors.as_ref().filter(|_| torque_steps > 1) {
            let expected = "0 with controller.torque.steps above 1: joints are measured between two ticks";
            check("simulator.sensors.joints.delay", sensors.joints.delay, |delay| delay == 0.0, expected)?;
        }
        FlightLog::check(&robot, config.simulator.duration, time_step)?;
        let wind = Wind::new(&config.wind)?;
        let judge = Judge::new(&config.simulator);
        let controller = config.controller(robot)?;
        let (shafts, feet) = (plant.jets().measured_shafts(), controller.model().feet.len());
        let measuring = Measuring::new(config, plant.robot(), shafts, &wind, feet)?;
        let (n_ticks, ground_height) = (config.n_ticks(), config.simulator.ground_height.unwrap_or(0.0));
        let world = None;
        Ok(Self { plant, world, controller, wind, measuring, judge, ground_height, time_step, n_ticks })
    }

    /// Builds a flight in another world.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part of the configuration, or one that no other world simulates.
    pub fn in_world(config: &ScenarioConfig, world: Box<dyn World>) -> Result<Self, BuildError> {
        config.check_drives()?;
        let robot = load_robot(&config.robot)?;
        let scenario = Self::build(&of_world(config, &robot)?, robot)?;
        Ok(Self { world: Some(world), ..scenario })
    }

    /// Checks that the configuration can be flown by its own back end, and returns its [warnings](Self::warnings); reads
    /// the robot's files.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part.
    pub fn check(config: &ScenarioConfig) -> Result<Vec<String>, BuildError> {
        config.check_drives()?;
        let mut of_this_backend = ScenarioConfig { own_controller: None, ..config.clone() };
        match config.backend {
            Backend::Rust => {}
            Backend::Jax => of_this_backend.simulator.dynamics = DynamicsBackend::Tree, // both can be flown
            Backend::Mujoco => {
                check_ground(config)?;
                of_this_backend = of_world(config, &load_robot(&config.robot)?)?;
            }
        }
        let robot = load_robot(&of_this_backend.robot)?;
        Self::build(&of_this_backend, robot)?.all_warnings(config)
    }

    /// What can be flown but is probably not meant: key, value and what was expected.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let rotation = &self.plant.state().base.rotation;
        let beyond = self.controller.setpoint_generator().pitch_beyond_limits(rotation);
        let warning = beyond.map(|(pitch, [low, high])| {
            format!(
                "simulator.initial.base_rpy_deg has a nose-down pitch of {pitch:.3} deg; expected one within \
                 controller.setpoint.nose_down_limits_deg, {low} to {high}, into which the set-point turns at once"
            )
        });
        warning.into_iter().collect()
    }

    /// Those, and what the configuration itself says.
    fn all_warnings(&self, config: &ScenarioConfig) -> Result<Vec<String>, BuildError> {
        let of_config = warnings(config, self.plant.robot())?;
        Ok(self.warnings().into_iter().chain(of_config).collect())
    }

    /// Number of ticks after the one at time zero.
    #[must_use]
    pub fn n_ticks(&self) -> usize {
        self.n_ticks
    }
}

/// As [`load_scenario`](crate::load_scenario), with the folder of `shipped` flights, `changes` of dotted keys, and a check
/// that its back end can fly it, which returns [warnings](Scenario::warnings).
///
/// # Errors
/// As [`load_changed`] and [`Scenario::check`].
// Inlined, as the reading of tables is compiled where it is called: for size, not for speed, and once.
#[inline]
pub fn load_flyable(
    path: &Path,
    shipped: Option<&Path>,
    changes: &[(String, Value)],
) -> Result<(ScenarioConfig, Vec<String>), BuildError> {
    let mut warnings = Vec::new();
    let check = |config: &_| Scenario::check(config).map(|found| warnings = found);
    load_changed(path, shipped, changes, check).map(|config| (config, warnings))
}

/// Refuses a flight without ground, or without feet to stand on it.
fn check_ground(config: &ScenarioConfig) -> Result<(), BuildError> {
    if config.simulator.ground.is_none() {
        let expected = "a table, as in configs/experiments/take_off.toml: backend = \"mujoco\" flies nothing that \
                        has no ground under it; \"rust\" and \"jax\" do";
        return Err(BuildError::bad_value("simulator.ground", "absent", expected));
    }
    if config.controller.law.contact.is_none() {
        let expected = "a table: without feet the controller cannot stand on simulator.ground";
        return Err(BuildError::bad_value("controller.contact", "absent", expected));
    }
    Ok(())
}

/// The part of a configuration that this crate simulates of a flight in another world, which has bodies, drives and ground.
///
/// # Errors
/// [`BuildError`] for what neither simulates.
fn of_world(config: &ScenarioConfig, robot: &RobotModel) -> Result<ScenarioConfig, BuildError> {
    let ScenarioConfig { simulator, disturbances, controller, .. } = config;
    simulator.check(robot, config.controller.law.time_step)?;
    let initial = &simulator.initial;
    check_only("simulator.integrator", &simulator.integrator, &Integrator::default())?;
    check_only("simulator.kinematics", &simulator.kinematics, &AeroKinematics::default())?;
    check_only("simulator.initial.base_velocity", &initial.base_velocity, &[0.0; 6])?;
    check_only("simulator.initial.free_fall_tick", &initial.free_fall_tick, &false)?;
    if let Some(motors) = &simulator.motors {
        check_only("simulator.motors.elasticity", &motors.elasticity, &None)?;
    }
    check_only("simulator.ground_height", &simulator.ground_height, &None)?;
    check_only("simulator.fuel", &simulator.fuel, &None)?;
    if simulator.ground.as_ref().is_some_and(|ground| ground.leg_odometry.is_some()) {
        // Legs measure once per tick, and joints that have no errors of their own.
        check_only("simulator.sensors", &simulator.sensors, &None)?;
        check_only("controller.torque.steps", &controller.law.torque.steps, &1)?;
    }
    if let Some(stuck) = disturbances.joints.iter().position(|fault| fault.kind == JointFaultKind::Stuck) {
        let key = format!("disturbances.joints[{stuck}].kind");
        return Err(BuildError::bad_value(key, "stuck", "weak or free: backend = \"mujoco\" holds no joint"));
    }
    let mut of_crate = config.clone();
    (of_crate.simulator.ground, of_crate.simulator.motors) = (None, None);
    Ok(of_crate)
}

/// Refuses every value but the one that another world simulates.
fn check_only<T: PartialEq + Serialize>(key: &str, value: &T, simulated: &T) -> Result<(), BuildError> {
    if value == simulated {
        return Ok(());
    }
    let simulated = match json!(simulated) {
        Value::Null => "none".to_owned(),
        simulated => simulated.to_string(),
    };
    let expected = format!("{simulated}: backend = \"mujoco\" simulates nothing else here");
    Err(BuildError::bad_value(key, json!(value), expected))
}
