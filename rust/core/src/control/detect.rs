//! Fault detection: each detector compares what a tick measures with what was commanded, and says what it finds.
//!
//! A detector is a file here, with its configuration, its state, its modes and its `impl` of [`Detector`], and a line of the
//! list below: the name of its table in `controller.fault_detection`, and its type. It reads the tick's [`Evidence`], and
//! writes what the law may use into [`Limits`] and the rest into [`Findings`].

pub(crate) mod detector;
pub mod engines;
pub mod joints;
pub mod latency;
pub mod tracking_error;
pub mod unmeasured_engines;

use super::command::Command;
use super::engine_condition::EngineFinding;
use super::limits::Limits;
use super::measure::measurement::Estimate;
use super::modes::{Mode, Modes, OF_TICK, listed};
use detector::{Detector, Evidence, Findings, Setup};
use serde::{Deserialize, Serialize};

/// Makes the set of detectors, their configurations, states and modes from one list, whose order has no meaning: none reads
/// what another one finds in the same tick.
macro_rules! detectors {
    ($($(#[doc = $doc:literal])+ $name:ident: $detector:ty;)*) => {
        /// When a fault counts as found; without its table a detector looks for nothing.
        #[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct FaultDetectionConfig {
            $($(#[doc = $doc])+
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub $name: Option<<$detector as Detector>::Config>,)*
        }

        impl Modes {
            /// All modes with their names and meanings, in the order of their bits.
            pub const NAMES: [Mode; OF_TICK.len() $(+ <$detector as Detector>::MODES.len())*] =
                listed(&[&OF_TICK, $(<$detector as Detector>::MODES),*]);
        }

        /// Sizes of the states of those that are configured.
        pub(crate) type DetectorSizes = [Option<[usize; 3]>; [$(stringify!($name)),*].len()];

        /// The configured detectors.
        #[derive(Debug)]
        pub(crate) struct Detectors {
            $($(#[doc = $doc])+ pub $name: Option<$detector>,)*
        }

        /// What detectors keep from tick to tick; of one that is not configured, nothing.
        #[derive(Debug, Clone, PartialEq)]
        pub(crate) struct DetectorStates {
            $($(#[doc = $doc])+ pub $name: Option<<$detector as Detector>::State>,)*
        }

        impl Detectors {
            /// Builds those that are configured.
            #[must_use]
            pub(crate) fn new(config: &FaultDetectionConfig, setup: &Setup) -> Self {
                Self { $($name: config.$name.as_ref().map(|of| <$detector>::build(of, setup)),)* }
            }

            /// States at the start of a flight.
            #[must_use]
            pub(crate) fn start(&self, estimate: &Estimate) -> DetectorStates {
                DetectorStates { $($name: self.$name.as_ref().map(|of| of.start(estimate)),)* }
            }

            /// Sizes of their states.
            #[must_use]
            pub(crate) fn sizes(&self) -> DetectorSizes {
                [$(self.$name.as_ref().map(Detector::sizes)),*]
            }

            /// Takes in what was measured, before an estimator replaces it.
            pub(crate) fn measure(&self, states: &mut DetectorStates, measured: &Estimate) {
                $(if let Some((of, state)) = self.$name.as_ref().zip(states.$name.as_mut()) {
                    of.measure(state, measured);
                })*
            }

            /// Compares a tick with what was commanded.
            pub(crate) fn detect(
                &mut self,
                states: &mut DetectorStates,
                tick: &Evidence,
                limits: &mut Limits,
                findings: &mut Findings,
            ) {
                (findings.modes, findings.torque_latency) = <_>::default();
                findings.unmodelled = None;
                findings.engines.fill(EngineFinding::Nothing);
                $(if let Some((of, state)) = self.$name.as_mut().zip(states.$name.as_mut()) {
                    of.detect(state, tick, limits, findings);
                })*
            }

            /// Takes in the command of the tick.
            pub(crate) fn command(&self, states: &mut DetectorStates, command: &Command) {
                $(if let Some((of, state)) = self.$name.as_ref().zip(states.$name.as_mut()) {
                    of.command(state, command);
                })*
            }
        }
    };
}

detectors! {
    /// Engines that stop while their thrusts are not measured.
    unmeasured_engines: unmeasured_engines::UnmeasuredEngines;
    /// Engines that do not follow their commands, and wrong thrust sensors.
    engines: engines::Engines;
    /// Joints that do not follow their torques.
    joints: joints::Joints;
    /// Commands that act late.
    latency: latency::LatencyMonitor;
    /// A flight that is too far from its set-point.
    tracking_error: tracking_error::TrackingErrorConfig;
}
