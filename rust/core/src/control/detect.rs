//! Fault detection: each detector compares what a tick measures with what was commanded, and says what it finds.
//!
//! A detector is a file here with its configuration, its state and its `impl` of [`Detector`], and a line in the list below.
//! It reads the tick's [`Evidence`], and writes what the law may use into [`Limits`] and the rest into [`Findings`].

pub mod engines;
pub mod joints;
pub mod latency;
pub mod supervisor;

use super::acting::Acting;
use super::command::Command;
use super::config::ControllerConfig;
use super::estimate::disturbance_observer::ObserverState;
use super::law::momentum::MomentumModel;
use super::law::setpoint::Setpoint;
use super::limits::Limits;
use super::measure::measurement::Estimate;
use super::modes::Modes;
use crate::dynamics::{Dynamics, InverseMass};
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use engines::Engines;
use joints::Joints;
use latency::LatencyMonitor;
use supervisor::SupervisorConfig;

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
    /// Whether the feet carry load.
    pub is_standing: bool,
}

/// What detectors find in a tick, beside the limits of the law.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// Modes of the tick.
    pub modes: Modes,
    /// Error of each thrust sensor that is found to be wrong in this tick \[N\].
    pub sensor_error: Vec<Option<f64>>,
    /// Whether the robot is to descend.
    pub descends: bool,
    /// Measured latency of torques and thrust rates, as far as it is known \[s\].
    pub latency: [Option<f64>; 2],
    /// Latency of the torques that the estimator is to use in place of the known one \[s\].
    pub torque_latency: Option<f64>,
}

/// What a detector is built for.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// The controller's configuration.
    pub config: &'a ControllerConfig,
    /// Its robot, with all jets.
    pub robot: &'a RobotModel,
    /// Limits of the law while nothing is found.
    pub usual: &'a Limits,
    /// Fractions of a change of force and moment that appear in the estimated momentum per tick, 1 where it is measured.
    pub momentum_shares: [f64; 2],
    /// Time between two ticks \[s\].
    pub time_step: f64,
}

/// A detector of one kind of fault.
pub trait Detector: Sized {
    /// What it keeps from tick to tick.
    type State;

    /// The detector, where it is configured.
    fn build(setup: &Setup) -> Option<Self>;

    /// Its state at the start of a flight.
    fn start(&self, estimate: &Estimate) -> Self::State;

    /// Whether a state has the sizes of this robot.
    fn fits(&self, _state: &Self::State) -> bool {
        true
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

/// Makes the set of detectors, and their states, from one list, in whose order they run.
macro_rules! detectors {
    ($($(#[doc = $doc:literal])+ $name:ident: $detector:ty;)*) => {
        /// The configured detectors.
        #[derive(Debug)]
        pub struct Detectors {
            $($(#[doc = $doc])+ pub $name: Option<$detector>,)*
        }

        /// What detectors keep from tick to tick; of one that is not configured, nothing.
        #[derive(Debug, Clone, PartialEq)]
        pub struct DetectorStates {
            $($(#[doc = $doc])+ pub $name: Option<<$detector as Detector>::State>,)*
        }

        impl Detectors {
            /// Builds those that are configured.
            #[must_use]
            pub fn new(setup: &Setup) -> Self {
                Self { $($name: <$detector>::build(setup),)* }
            }

            /// States at the start of a flight.
            #[must_use]
            pub fn start(&self, estimate: &Estimate) -> DetectorStates {
                DetectorStates { $($name: self.$name.as_ref().map(|of| of.start(estimate)),)* }
            }

            /// Whether states have these parts and sizes.
            #[must_use]
            pub fn fit(&self, states: &DetectorStates) -> bool {
                $(self.$name.is_some() == states.$name.is_some()
                    && self.$name.as_ref().zip(states.$name.as_ref()).is_none_or(|(of, state)| of.fits(state)))&&*
            }

            /// Takes in what was measured, before an estimator replaces it.
            pub fn measure(&self, states: &mut DetectorStates, measured: &Estimate) {
                $(if let Some((of, state)) = self.$name.as_ref().zip(states.$name.as_mut()) {
                    of.measure(state, measured);
                })*
            }

            /// Compares a tick with what was commanded.
            pub fn detect(
                &mut self,
                states: &mut DetectorStates,
                tick: &Evidence,
                limits: &mut Limits,
                findings: &mut Findings,
            ) {
                (findings.modes, findings.descends, findings.torque_latency) = <_>::default();
                findings.sensor_error.fill(None);
                $(if let Some((of, state)) = self.$name.as_mut().zip(states.$name.as_mut()) {
                    of.detect(state, tick, limits, findings);
                })*
            }

            /// Takes in the command of the tick.
            pub fn command(&self, states: &mut DetectorStates, command: &Command) {
                $(if let Some((of, state)) = self.$name.as_ref().zip(states.$name.as_mut()) {
                    of.command(state, command);
                })*
            }
        }
    };
}

detectors! {
    /// Engines that do not follow their commands, and wrong thrust sensors.
    engines: Engines;
    /// Joints that do not follow their torques.
    joints: Joints;
    /// Commands that act late.
    latency: LatencyMonitor;
    /// A flight that strays from its set-point.
    supervisor: SupervisorConfig;
}
