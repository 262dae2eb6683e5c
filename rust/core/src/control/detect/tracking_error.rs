//! Whether the tracking errors of the flight are so large that it may be lost.
//!
//! ```text
//! φ̂ = log(R_dᵀ R) + T (R_dᵀ ω − ω_d)        rotation error in the horizon T
//! p̂ = p_G − p_d + T (ṗ_G − ṗ_d)              error of the centre of mass in it
//! ```
//!
//! They are too large if one of their lengths, or the speed of a joint, exceeds its limit for a confirmation time, whatever
//! the cause is. Equations M148 and M149 of `docs/model`.

use super::detector::{Detector, Evidence, Findings, Setup};
use crate::control::law::setpoint::Setpoint;
use crate::control::limits::Limits;
use crate::control::measure::measurement::Estimate;
use crate::control::modes::{Mode, Modes, modes};
use crate::dynamics::Dynamics;
use crate::kinematics::{Kinematics, RobotState};
use crate::spatial::{log_so3, parts};
use crate::timing::Exceeded;
use serde::{Deserialize, Serialize};

modes! {
    MODES:
    /// The flight is too far from its set-point, or its joints are too fast.
    TRACKING_ERROR = 14, "tracking_error";
}

/// Time `T` by which errors are extrapolated with their rates \[s\].
const HORIZON: f64 = 0.3;

/// Time for which a limit has to be exceeded \[s\].
const CONFIRMATION: f64 = 0.03;

/// When tracking errors count as too large.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrackingErrorConfig {
    /// Greatest extrapolated angle between the base and its set-point \[rad\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub rotation: f64,
    /// Greatest extrapolated distance of the centre of mass from its set-point \[m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub position: f64,
    /// Greatest velocity of a joint \[rad/s, m/s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_velocity: f64,
}

/// What is compared with the limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// `|φ̂|` \[rad\].
    pub rotation: f64,
    /// `|p̂|` \[m\].
    pub position: f64,
    /// Greatest speed of a joint \[rad/s, m/s\].
    pub joint_velocity: f64,
}

impl Errors {
    /// The errors of a robot with respect to a set-point, extrapolated by `horizon` \[s\] (M148).
    #[must_use]
    pub fn ahead(
        horizon: f64,
        robot: &RobotState,
        kinematics: &Kinematics,
        dynamics: &Dynamics,
        setpoint: &Setpoint,
    ) -> Self {
        let to_desired = setpoint.rotation.transpose();
        let turning = to_desired * robot.base_angular_velocity() - setpoint.angular_velocity_b;
        let (momentum, _) = parts(&dynamics.momentum);
        let rate = momentum / kinematics.mass() - setpoint.com_velocity;
        let speeds = robot.joint_velocity().iter().map(|speed| speed.abs());
        Self {
            rotation: (log_so3(&(to_desired * robot.base.rotation)) + turning * horizon).norm(),
            position: (kinematics.com - setpoint.com_position + rate * horizon).norm(),
            joint_velocity: speeds.fold(0.0, f64::max),
        }
    }
}

impl TrackingErrorConfig {
    /// Takes in the errors of a tick, `elapsed` \[s\] after the last one; returns whether they are too large.
    pub fn update(&self, exceeded: &mut Exceeded, elapsed: f64, errors: &Errors) -> bool {
        let is_beyond = errors.rotation > self.rotation
            || errors.position > self.position
            || errors.joint_velocity > self.joint_velocity;
        exceeded.update(is_beyond, elapsed);
        exceeded.has_lasted(CONFIRMATION, elapsed)
    }
}

impl Detector for TrackingErrorConfig {
    type Config = Self;
    type State = Exceeded;
    const MODES: &'static [Mode] = &MODES;

    fn build(config: &Self, _: &Setup) -> Self {
        *config
    }

    fn start(&self, _: &Estimate) -> Exceeded {
        Exceeded::default()
    }

    fn detect(&mut self, exceeded: &mut Exceeded, tick: &Evidence, _: &mut Limits, findings: &mut Findings) {
        let Evidence { estimate, kinematics, dynamics, setpoint, .. } = *tick;
        let errors = Errors::ahead(HORIZON, &estimate.robot.state, kinematics, dynamics, setpoint);
        if self.update(exceeded, estimate.elapsed, &errors) {
            findings.modes.insert(Modes::TRACKING_ERROR);
        }
    }
}
