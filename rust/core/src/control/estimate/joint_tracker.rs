//! The joints between two ticks of the law: predicted under their torques, corrected by their own measurements.
//!
//! The torque law can run faster than the momentum law (`controller.torque.steps`). In a tick of the torques only joint
//! positions and velocities are new; what the torque QP takes from the model is that of the last tick of the law.
//!
//! Equation M152 of `docs/model`.

use super::estimator::EstimatorConfig;
use crate::control::measure::channels::ChannelsConfig;
use crate::control::measure::greatest::{Jumps, MAGNITUDES};
use crate::control::modes::Modes;
use crate::control::state::Origin;
use crate::kinematics::RobotState;
use crate::timing::share;
use nalgebra::{DVector, DVectorView};

/// What a tick of the torques receives: the joints in the robot's order. Entries that are not finite are not measured.
#[derive(Debug, Clone, Copy)]
pub struct JointMeasurement<'a> {
    /// Positions \[rad, m\].
    pub position: &'a [f64],
    /// Velocities \[rad/s, m/s\].
    pub velocity: &'a [f64],
}

/// Joints at the last tick of law or torques; a part of the controller's state.
#[derive(Debug, Clone, PartialEq)]
pub struct InnerLoop {
    /// Positions \[rad, m\].
    pub position: DVector<f64>,
    /// Velocities \[rad/s, m/s\].
    pub velocity: DVector<f64>,
    /// Acting torques \[N m, N\].
    pub torque: DVector<f64>,
    /// Accelerations under them \[rad/s², m/s²\].
    pub acceleration: DVector<f64>,
    /// Modes of the last tick of the law, without its torques.
    pub modes: Modes,
    /// Ticks of the torques since the last tick of the law.
    pub ticks: u32,
    /// Which tick that was.
    pub origin: Origin,
}

impl InnerLoop {
    /// Joints of a controller that has not ticked.
    #[must_use]
    pub fn new(joints: usize) -> Self {
        let zero = DVector::zeros(joints);
        Self {
            position: zero.clone(),
            velocity: zero.clone(),
            torque: zero.clone(),
            acceleration: zero,
            modes: Modes::default(),
            ticks: 0,
            origin: Origin::default(),
        }
    }

    /// Begins at a tick of the law, with what it used and predicts.
    pub fn begin(
        &mut self,
        origin: Origin,
        robot: &RobotState,
        torque: &[f64],
        acceleration: DVectorView<f64>,
    ) {
        self.position.copy_from(&robot.joint_position);
        self.velocity.as_mut_slice().copy_from_slice(robot.joint_velocity());
        self.replace_torque(torque, acceleration);
        (self.ticks, self.origin) = (0, origin);
    }

    /// Other torques act, with these accelerations.
    pub fn replace_torque(&mut self, torque: &[f64], acceleration: DVectorView<f64>) {
        self.torque.copy_from_slice(torque);
        self.acceleration.copy_from(&acceleration);
    }
}

/// Predicts and corrects the joints.
#[derive(Debug, Clone)]
pub struct JointTracker {
    /// Time between two ticks of the torques \[s\].
    period: f64,
    /// Share of the innovation of the position that corrects it.
    position: f64,
    /// Shares of the innovations of position \[1/s\] and velocity that correct the velocity.
    velocity: [f64; 2],
    /// Greatest accepted position and velocity.
    greatest: [f64; 2],
    /// Greatest accepted differences from the prediction.
    jump: Option<[f64; 2]>,
}

impl JointTracker {
    /// A tracker for ticks every `period` \[s\], which corrects as the estimator does, and accepts what channels accept.
    #[must_use]
    pub fn new(estimator: Option<&EstimatorConfig>, channels: ChannelsConfig, period: f64) -> Self {
        let share = |time: f64| share(period / time);
        let of =
            |time_of: fn(&EstimatorConfig) -> f64| estimator.map_or(1.0, |config| share(time_of(config)));
        let (position, velocity) = match estimator.and_then(|config| config.joint_observer) {
            // Two poles at e^(-h/T).
            Some(time) => {
                let left = share(time);
                (left * (2.0 - left), [left * left / period, 0.0])
            }
            None => (
                of(|config| config.joint_position.time_constant),
                [0.0, of(|config| config.joint_velocity.time_constant)],
            ),
        };
        let of_jumps = |jump: &Jumps| [jump.joint_position, jump.joint_velocity];
        Self {
            period,
            position,
            velocity,
            greatest: of_jumps(&MAGNITUDES),
            jump: channels.jump.then(|| of_jumps(&Jumps::GREATEST)),
        }
    }

    /// Advances the joints to a measurement of them. Numbers that are not accepted correct nothing.
    pub fn update(&self, joints: &mut InnerLoop, measured: &JointMeasurement) {
        let InnerLoop { position, velocity, acceleration, .. } = joints;
        velocity.axpy(self.period, acceleration, 1.0);
        position.axpy(self.period, velocity, 1.0);
        let innovation = |quantity: usize, measured: f64, predicted: f64| {
            let difference = measured - predicted;
            let is_near = self.jump.is_none_or(|jump| difference.abs() <= jump[quantity]);
            if measured.abs() <= self.greatest[quantity] && is_near { difference } else { 0.0 }
        };
        let joints = position.iter_mut().zip(velocity.iter_mut());
        for ((position, velocity), (at, speed)) in joints.zip(measured.position.iter().zip(measured.velocity))
        {
            let (of_position, of_velocity) =
                (innovation(0, *at, *position), innovation(1, *speed, *velocity));
            *position += self.position * of_position;
            *velocity += self.velocity[0] * of_position + self.velocity[1] * of_velocity;
        }
    }
}
