//! Configuration of the simulator and of a whole flight.

use crate::actuation::ActuationConfig;
use crate::disturbances::Disturbances;
use crate::fuel::FuelConfig;
use crate::ground::GroundConfig;
use crate::jets::JetsConfig;
use crate::motors::MotorsConfig;
use crate::sensors::SensorsConfig;
use crate::wind::WindConfig;
use flight_core::Controller;
use flight_core::aero::LeverArm;
use flight_core::control::config::ControllerConfig;
use flight_core::control::mpc::config::MpcConfig;
use flight_core::error::{BuildError, Table, check};
use flight_core::jets::{RATE_GAIN, ShaftConfig};
use flight_core::kinematics::RobotState;
use flight_core::robot::RobotModel;
use flight_core::spatial::{Pose, rotation_from_rpy};
use flight_io::{
    AeroConfig, ControllerSection, MissionConfig, OnboardConfig, RobotFile, Schema, from_value, load,
    load_aero, load_controller, load_robot,
};
use nalgebra::{DVector, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// One flight: robot, simulator, controller, mission, wind and disturbances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenarioConfig {
    /// Title in tables and figures.
    #[serde(default)]
    pub title: String,
    /// Purpose of the flight.
    #[serde(default)]
    pub description: String,
    /// Back end that simulates the flight. This crate is one of them and reads the files of all.
    #[serde(default)]
    pub backend: Backend,
    /// The robot's TOML file.
    #[schemars(extend("format" = "path"))]
    pub robot: PathBuf,
    /// The simulated robot and its environment.
    pub simulator: SimulatorConfig,
    /// The controller.
    pub controller: ControllerSection,
    /// What commands in place of the controller, which then follows the mission, by which the flight is judged, and is
    /// given what acts. Flown from Python.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own_controller: Option<OwnController>,
    /// Commands of the autopilot, or a recorded reference.
    pub mission: MissionConfig,
    /// The simulated wind; the controller also receives it, unless `disturbances` states otherwise.
    pub wind: WindConfig,
    /// Disturbances of robot and controller.
    #[serde(default)]
    pub disturbances: Disturbances,
}

impl ScenarioConfig {
    /// Number of ticks after the one at time zero.
    #[must_use]
    pub fn n_ticks(&self) -> usize {
        self.simulator.n_ticks(self.controller.law.time_step)
    }

    /// Checks that the simulated robot has the drives of the controller's model: joints whose torques contain the inertia
    /// of rotors, or compensate friction, that the robot lacks are not stabilised.
    ///
    /// # Errors
    /// [`BuildError`] naming the part of the controller's model that the robot lacks.
    pub(crate) fn check_drives(&self) -> Result<(), BuildError> {
        const IDEAL: &str = "; for ideal drives the recommended controllers are control/robot_ideal.toml, mk3_robot_ideal.toml";
        let (torque, motors) = (&self.controller.law.torque, self.simulator.motors.as_ref());
        if motors.is_none_or(|motors| motors.inertia == 0.0) {
            let expected =
                format!("0, as simulator.motors.inertia: the simulated robot has no rotors{IDEAL}");
            check(
                "controller.torque.rotor_inertia",
                torque.rotor_inertia,
                |inertia| inertia == 0.0,
                &expected,
            )?;
        }
        let frictions = torque.friction.iter().flatten().filter(|_| motors.is_none());
        for (group, &friction) in frictions {
            let expected = format!("0: the simulated robot has no drives, simulator.motors{IDEAL}");
            check(
                &format!("controller.torque.friction.{group}"),
                friction,
                |friction| friction == 0.0,
                &expected,
            )?;
        }
        Ok(())
    }

    /// Builds the controller of this flight for `robot`, with the errors that `disturbances` gives its models.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part of the configuration.
    pub fn controller(&self, robot: RobotModel) -> Result<Controller, BuildError> {
        if let Some(own) = &self.own_controller {
            let expected = "none: only Python flies it (`jax_aero.rust.Flight`)";
            return Err(BuildError::bad_value("own_controller", own.file.display(), expected));
        }
        let robot = self.disturbances.controller_robot(robot)?;
        let factors = &self.disturbances.aero_estimate;
        let aero = |robot: &RobotModel| {
            load_aero(&self.controller.aero, robot)?.weight_forces(
                factors,
                robot,
                "disturbances.aero_estimate",
            )
        };
        self.controller.build(robot, aero, &self.mission)
    }
}

/// Builds the controller of a resolved table: one of `configs/onboard/`, or an experiment with the errors that `disturbances`
/// gives the models of its controller. Returns its robot and its law too; `origin` is named in errors.
///
/// # Errors
/// [`BuildError`] naming the invalid part.
#[inline]
pub fn onboard(table: Value, origin: &str) -> Result<(RobotModel, ControllerConfig, Controller), BuildError> {
    if table.get("simulator").is_some() {
        let config: ScenarioConfig = from_value(table, origin)?;
        config.check_drives()?;
        let robot = load_robot(&config.robot)?;
        return Ok((robot.clone(), config.controller.law.clone(), config.controller(robot)?));
    }
    let OnboardConfig { robot, controller, mission } = from_value(table, origin)?;
    let robot = load_robot(&robot)?;
    Ok((robot.clone(), controller.law.clone(), load_controller(robot, &controller, &mission)?))
}

/// Reads a flight configuration file.
///
/// # Errors
/// As [`load`], for unknown, missing or mistyped keys.
#[inline]
pub fn load_scenario(path: &Path) -> Result<ScenarioConfig, BuildError> {
    load(path)
}

/// The schemas of all files, by folder of `configs/`.
#[must_use]
pub fn schemas() -> [(&'static str, Schema); 10] {
    [
        ("aero", Schema::of_type::<AeroConfig>()),
        ("control", Schema::of_type::<ControllerSection>()),
        ("engines", Schema::of_type::<ShaftConfig>()),
        ("law", Schema::of_type::<MpcConfig>()),
        ("mission", Schema::of_type::<MissionConfig>()),
        ("onboard", Schema::of_type::<OnboardConfig>()),
        ("experiments", Schema::of_type::<ScenarioConfig>()),
        ("robot", Schema::of_type::<RobotFile>()),
        ("simulator", Schema::of_type::<SimulatorConfig>()),
        ("wind", Schema::of_type::<WindConfig>()),
    ]
}

/// A controller in Python, from measurement and set-point to thrust rates and torques.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OwnController {
    /// Python file.
    #[schemars(extend("format" = "path"))]
    pub file: PathBuf,
    /// Name of a function in it, or of a class that is made for each flight.
    pub name: String,
}

/// The program that simulates a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// This crate.
    #[default]
    Rust,
    /// The batched, differentiable simulation in Python.
    Jax,
    /// MuJoCo, in Python; the only back end with ground.
    Mujoco,
}

/// Configuration of the simulated robot and its environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulatorConfig {
    /// Length of the flight \[s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub duration: f64,
    /// Physics steps in a tick; state-dependent forces are evaluated in each, commands are constant.
    #[serde(default = "default_one")]
    #[schemars(range(min = 1, max = 1000))]
    pub substeps: u32,
    /// Integrator of a physics step.
    #[serde(default)]
    pub integrator: Integrator,
    /// Implementation that computes mass matrix and bias.
    #[serde(default)]
    pub dynamics: DynamicsBackend,
    /// Simulated aerodynamic model.
    pub aero: AeroConfig,
    /// Point at which link forces act.
    #[serde(default)]
    pub lever_arm: LeverArm,
    /// Kinematics used for the aerodynamic forces.
    #[serde(default)]
    pub kinematics: AeroKinematics,
    /// Dynamics of the thrust under a commanded thrust rate.
    pub jets: JetsConfig,
    /// Sensors of the robot's own state; without them the controller receives the true state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensors: Option<SensorsConfig>,
    /// Delay and loss of commands; without it they act at once and until the next tick.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub actuation: Option<ActuationConfig>,
    /// The ground, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground: Option<GroundConfig>,
    /// Height of the ground on which the robot lands above that from which it starts \[m\], in back ends without contact:
    /// in a descent it touches down where its centre of mass is as high above this ground as it was above the other. By
    /// default they are one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -1e3, max = 1e3))]
    pub ground_height: Option<f64>,
    /// The drives of the joints; without them torques are ideal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motors: Option<MotorsConfig>,
    /// Fuel that leaves the robot; without it the mass is constant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fuel: Option<FuelConfig>,
    /// Whether joints have the stops of the URDF, widened to the range of the controller.
    #[serde(default = "default_true")]
    pub joint_stops: bool,
    /// Initial state.
    pub initial: InitialConfig,
    /// Limits beyond which a robot counts as fallen.
    pub fall: FallConfig,
}

fn default_one() -> u32 {
    1
}

/// Implementation that computes mass matrix and bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DynamicsBackend {
    /// The tree of bodies of this project.
    #[default]
    Tree,
    /// MuJoCo's JAX implementation, for `backend = "jax"` only.
    Mjx,
}

/// Integrator of a physics step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Velocity first, then the pose with the new velocity: adds no energy to fast joint motion.
    #[default]
    SemiImplicitEuler,
    /// Pose and velocity both advance with the velocity and acceleration at the start of the step (published).
    ExplicitEuler,
}

/// Kinematics used for the aerodynamic forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AeroKinematics {
    /// Those of the present state.
    #[default]
    Current,
    /// Those of the first tick for the whole flight (published): axes, points and Jacobians are constant, only
    /// velocities are current.
    Frozen,
}

/// Initial state of a flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitialConfig {
    /// Position of the base origin \[m\]; far away, rounding would lose micrometres.
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub base_position: [f64; 3],
    /// Roll, pitch, yaw of the base \[deg\].
    pub base_rpy_deg: [f64; 3],
    /// Joint positions in the robot's order \[rad\].
    pub joint_position: Vec<f64>,
    /// Velocity of the base origin, then angular velocity, inertial axes \[m/s, rad/s\].
    #[serde(default)]
    pub base_velocity: [f64; 6],
    /// Thrusts in the robot's order, each at most the jet's greatest \[N\].
    #[schemars(inner(range(min = 0)))]
    pub thrust: Vec<f64>,
    /// Whether the first physics step has neither thrust nor torque, as with the delays of the published model:
    /// the controller starts with a robot that has fallen for one tick.
    #[serde(default)]
    pub free_fall_tick: bool,
}

fn default_true() -> bool {
    true
}

/// Limits beyond which a robot counts as fallen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FallConfig {
    /// Greatest rotation between base and set-point \[deg\].
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 180))]
    pub rotation_error_deg: f64,
    /// Greatest distance between centre of mass and set-point \[m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub com_error: f64,
}

impl SimulatorConfig {
    /// Checks that the values are valid for `robot`, and for ticks of `time_step` \[s\].
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming key, value and expectation.
    pub fn check(&self, robot: &RobotModel, time_step: f64) -> Result<(), BuildError> {
        let table = Table("simulator");
        flight_core::schema::check(self, "simulator")?;
        if let JetsConfig::Throttled(_) = &self.jets {
            let expected = format!("below 2 / ({RATE_GAIN}/s), for the throttle loops of the jets");
            check("controller.time_step", time_step, |step| step * RATE_GAIN < 2.0, &expected)?;
        }
        if let JetsConfig::Measured(map) = &self.jets {
            map.check()?;
        }
        if let Some(actuation) = &self.actuation {
            actuation.check(self.physics_step(time_step))?;
        }
        if let Some(motors) = &self.motors {
            motors.check(robot)?;
        }
        if let Some(fuel) = &self.fuel {
            fuel.check(robot)?;
        }
        if self.n_ticks(time_step) > 10_000_000 {
            return Err(BuildError::bad_value(
                "simulator.duration / controller.time_step",
                self.n_ticks(time_step),
                "at most ten million ticks",
            ));
        }
        let initial = &self.initial;
        let length = |name: &str, found: usize, expected: usize, of: &str| {
            if found == expected {
                Ok(())
            } else {
                Err(BuildError::bad_value(
                    format!("length of simulator.initial.{name}"),
                    found,
                    format!("{expected}, one entry per {of} of {}", robot.name),
                ))
            }
        };
        length("joint_position", initial.joint_position.len(), robot.joints.len(), "joint")?;
        length("thrust", initial.thrust.len(), robot.jets.len(), "jet")?;
        initial.thrust.iter().zip(&robot.jets).try_for_each(|(thrust, jet)| {
            let (name, range) = (&jet.name, jet.thrust_min..=jet.thrust_max);
            let expected =
                format!("newtons from {} to {}, the range of jet `{name}`", range.start(), range.end());
            table.check("initial.thrust", *thrust, |thrust| range.contains(&thrust), &expected)
        })
    }

    /// Duration of a physics step in ticks of `time_step` \[s\].
    #[must_use]
    pub fn physics_step(&self, time_step: f64) -> f64 {
        time_step / f64::from(self.substeps)
    }

    /// Number of ticks of `time_step` \[s\] after the one at time zero.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: positive, at most 1e7
    pub fn n_ticks(&self, time_step: f64) -> usize {
        (self.duration / time_step).round() as usize
    }
}

impl InitialConfig {
    /// The robot's state before the first physics step.
    #[must_use]
    pub fn state(&self) -> RobotState {
        let mut state = RobotState::zero(self.joint_position.len());
        state.base = Pose {
            rotation: rotation_from_rpy(&Vector3::from(self.base_rpy_deg.map(f64::to_radians))),
            position: Vector3::from(self.base_position),
        };
        state.joint_position = DVector::from_column_slice(&self.joint_position);
        state.velocity.as_mut_slice()[..6].copy_from_slice(&self.base_velocity);
        state
    }
}
