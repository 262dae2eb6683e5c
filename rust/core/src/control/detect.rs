//! Fault detection: each detector compares what a tick measures with what was commanded, and says what it finds.
//!
//! A detector is a file here with its configuration, its state and its `impl` of [`Detector`], and an entry in the list below:
//! name, type and how it is built. It reads the tick's [`Evidence`], and writes what the law may use into [`Limits`] and the
//! rest into [`Findings`].

pub mod detector;
pub mod engines;
pub mod joints;
pub mod latency;
pub mod supervisor;

use super::command::Command;
use super::config::ControllerConfig;
use super::limits::Limits;
use super::measure::measurement::Estimate;
use crate::robot::RobotModel;
use detector::{Detector, Evidence, Findings};
use engines::Engines;
use joints::Joints;
use latency::LatencyMonitor;
use supervisor::SupervisorConfig;

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

/// Makes the set of detectors, and their states, from one list, in whose order they run.
macro_rules! detectors {
    ($($(#[doc = $doc:literal])+ $name:ident: $detector:ty = $build:expr;)*) => {
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
                $(let $name: fn(&Setup) -> Option<$detector> = $build;)*
                Self { $($name: $name(setup),)* }
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
    engines: Engines = |of| {
        let dynamics = of.config.jet_dynamics;
        of.config.engines.map(|engines| Engines::new(&engines, of.usual, of.robot, of.momentum_shares, dynamics))
    };
    /// Joints that do not follow their torques.
    joints: Joints = |of| of.config.joints.map(|joints| Joints::new(joints, of.robot, of.time_step));
    /// Commands that act late.
    latency: LatencyMonitor = |of| {
        let (estimator, steps) = (of.config.estimator.as_ref(), of.config.torque.steps);
        let sizes = (of.robot.joints.len(), of.robot.jets.len());
        let monitor = |config| LatencyMonitor::new(config, estimator, steps, sizes.0, sizes.1, of.time_step);
        of.config.latency_monitor.map(monitor)
    };
    /// A flight that strays from its set-point.
    supervisor: SupervisorConfig = |of| of.config.supervisor;
}
