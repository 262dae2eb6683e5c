//! What a detector is: what it reads of a tick, and where it says what it finds.

use crate::control::acting::Acting;
use crate::control::command::Command;
use crate::control::engine_condition::{EngineCondition, EngineFinding};
use crate::control::estimate::disturbance_observer::ObserverState;
use crate::control::estimate::estimator::EstimatorConfig;
use crate::control::law::momentum::MomentumModel;
use crate::control::law::setpoint::Setpoint;
use crate::control::limits::Limits;
use crate::control::measure::measurement::Estimate;
use crate::control::modes::{Mode, Modes};
use crate::dynamics::{Dynamics, InverseMass};
use crate::jets::JetDynamics;
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use nalgebra::Vector6;

/// What a detector is built for.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// The controller's robot, with all jets.
    pub robot: &'a RobotModel,
    /// How its thrusts follow their rates.
    pub jet_dynamics: JetDynamics,
    /// The controller's estimator, if it has one.
    pub estimator: Option<&'a EstimatorConfig>,
    /// Fractions of a change of force and moment that appear in the estimated momentum per tick, 1 where it is measured.
    pub momentum_fractions: [f64; 2],
    /// Limits of the law while nothing is found.
    pub usual: &'a Limits,
    /// Time between two ticks \[s\].
    pub time_step: f64,
    /// Ticks of the torques in a tick of the law.
    pub torque_steps: u32,
}

/// What detectors read of a tick.
#[derive(Debug)]
pub struct Evidence<'a> {
    /// The robot as it is known.
    pub estimate: &'a Estimate,
    /// The command since the last tick.
    pub acting: &'a Acting,
    /// Its poses and velocities.
    pub kinematics: &'a Kinematics,
    /// Mass matrix and momentum.
    pub dynamics: &'a Dynamics,
    /// Inverse mass matrix.
    pub inverse_mass: &'a InverseMass,
    /// `A_T`, and the observed wrench.
    pub momentum: &'a MomentumModel,
    /// The disturbance observer, where there is one.
    pub disturbance: Option<&'a ObserverState>,
    /// The set-point of the time of the state.
    pub setpoint: &'a Setpoint,
    /// Time that the measured momentum of this tick covers, since the one before \[s\]; `None` where none is measured.
    pub covered: Option<f64>,
    /// Conditions of the engines before this tick.
    pub engines: &'a [EngineCondition],
    /// Whether the feet carry load.
    pub is_standing: bool,
}

/// What detectors find in a tick, beside the limits of the law.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// Modes of the tick.
    pub modes: Modes,
    /// What is found of each engine in this tick.
    pub engines: Vec<EngineFinding>,
    /// Observed wrench in place of one that has taken in what is found \[N, N m\].
    pub unmodelled: Option<Vector6<f64>>,
    /// Measured latency of torques and thrust rates, as far as it is known \[s\].
    pub latency: [Option<f64>; 2],
    /// Latency of the torques that the estimator is to use from now on: the measured one while it is late, else the known
    /// one; `None` while it is not measured \[s\].
    pub torque_latency: Option<f64>,
}

/// A detector of one kind of fault.
pub trait Detector: Sized {
    /// Its table in `controller.fault_detection`.
    type Config;
    /// What it keeps from tick to tick.
    type State;
    /// Modes that it may find.
    const MODES: &'static [Mode];

    /// The detector for a robot.
    fn build(config: &Self::Config, setup: &Setup) -> Self;

    /// Its state at the start of a flight.
    fn start(&self, estimate: &Estimate) -> Self::State;

    /// Sizes of its state beyond those of the robot.
    fn sizes(&self) -> [usize; 3] {
        [0; 3]
    }

    /// Takes in what was measured, before an estimator replaces it.
    fn measure(&self, _state: &mut Self::State, _measured: &Estimate) {}

    /// Compares a tick with what was commanded.
    fn detect(
        &mut self,
        state: &mut Self::State,
        tick: &Evidence,
        limits: &mut Limits,
        findings: &mut Findings,
    );

    /// Takes in the command of the tick.
    fn command(&self, _state: &mut Self::State, _command: &Command) {}
}
