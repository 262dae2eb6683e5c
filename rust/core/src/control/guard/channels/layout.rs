//! A measurement as one vector of numbers: their positions, reading and writing, and the channels that own them.

use crate::control::measurement::{Measurement, UsedMeasurement};
use crate::control::modes::Modes;
use crate::kinematics::RobotState;
use crate::spatial::Pose;
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Positions of the channels in the vector of all numbers of a measurement.
#[derive(Debug, Clone)]
pub(super) struct Numbers {
    pub(super) wind: Range<usize>,
    pub(super) thrust: Range<usize>,
    pub(super) joint_position: Range<usize>,
    pub(super) joint_velocity: Range<usize>,
    pub(super) linear_velocity: Range<usize>,
    pub(super) angular_velocity: Range<usize>,
    pub(super) position: Range<usize>,
    pub(super) rotation: Range<usize>,
    pub(super) feet: Range<usize>,
}

impl Numbers {
    pub(super) fn new(jets: usize, joints: usize, feet: usize) -> Self {
        let mut end = 0;
        let mut next = |count: usize| {
            let start = end;
            end += count;
            start..end
        };
        Self {
            wind: next(3),
            thrust: next(jets),
            joint_position: next(joints),
            joint_velocity: next(joints),
            linear_velocity: next(3),
            angular_velocity: next(3),
            position: next(3),
            rotation: next(9),
            feet: next(6 * feet),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.feet.end
    }

    /// Positions and velocities of the joints.
    pub(super) fn joints(&self) -> Range<usize> {
        self.joint_position.start..self.joint_velocity.end
    }

    /// Linear and angular velocity of the base.
    pub(super) fn velocity(&self) -> Range<usize> {
        self.linear_velocity.start..self.angular_velocity.end
    }

    /// Field of the measurement that contains a number.
    pub(super) fn name(&self, index: usize) -> &'static str {
        let names = [
            (self.wind.end, "wind"),
            (self.thrust.end, "thrust"),
            (self.joint_position.end, "joint_position"),
            (self.joint_velocity.end, "joint_velocity"),
            (self.linear_velocity.end, "base_linear_velocity"),
            (self.angular_velocity.end, "base_angular_velocity"),
            (self.position.end, "base_position"),
            (self.rotation.end, "base_rotation"),
        ];
        names.into_iter().find(|(end, _)| index < *end).map_or("foot_wrenches", |(_, name)| name)
    }

    /// Reads the numbers of a measurement of matching size.
    pub(super) fn read(&self, measurement: &Measurement, numbers: &mut [f64]) {
        let RobotState { base, joint_position, velocity } = measurement.state;
        numbers[self.wind.clone()].copy_from_slice(measurement.wind.as_slice());
        numbers[self.thrust.clone()].copy_from_slice(measurement.thrust);
        numbers[self.joint_position.clone()].copy_from_slice(joint_position.as_slice());
        numbers[self.joint_velocity.clone()].copy_from_slice(&velocity.as_slice()[6..]);
        numbers[self.position.clone()].copy_from_slice(base.position.as_slice());
        numbers[self.rotation.clone()].copy_from_slice(base.rotation.as_slice());
        numbers[self.velocity()].copy_from_slice(&velocity.as_slice()[..6]);
        for (to, wrench) in numbers[self.feet.clone()].chunks_exact_mut(6).zip(measurement.foot_wrenches) {
            to.copy_from_slice(wrench.as_slice());
        }
    }

    /// Inverse of `read` for state and thrusts.
    pub(super) fn write_reading(&self, numbers: &[f64], state: &mut RobotState, thrust: &mut [f64]) {
        thrust.copy_from_slice(&numbers[self.thrust.clone()]);
        state.joint_position.copy_from_slice(&numbers[self.joint_position.clone()]);
        state.velocity.as_mut_slice()[6..].copy_from_slice(&numbers[self.joint_velocity.clone()]);
        state.velocity.as_mut_slice()[..6].copy_from_slice(&numbers[self.velocity()]);
        state.base = Pose {
            rotation: rotation_of(&numbers[self.rotation.clone()]),
            position: vector(&numbers[self.position.clone()]),
        };
    }

    /// Inverse of `read` for all channels.
    pub(super) fn write(&self, numbers: &[f64], used: &mut UsedMeasurement) {
        self.write_reading(numbers, &mut used.state, &mut used.thrust);
        used.wind = vector(&numbers[self.wind.clone()]);
        for (to, wrench) in used.foot_wrenches.iter_mut().zip(numbers[self.feet.clone()].chunks_exact(6)) {
            to.copy_from_slice(wrench);
        }
    }
}

/// Converts three numbers to a vector.
pub(super) fn vector(numbers: &[f64]) -> Vector3<f64> {
    Vector3::from_column_slice(numbers)
}

/// Converts nine numbers, column by column, to a matrix.
pub(super) fn rotation_of(numbers: &[f64]) -> Matrix3<f64> {
    Matrix3::from_column_slice(numbers)
}

/// What a channel measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ChannelKind {
    Wind,
    Thrust,
    Joints,
    LinearVelocity,
    AngularVelocity,
    Position,
    Rotation,
    Feet,
}

impl ChannelKind {
    /// Mode of a tick without it.
    pub(super) fn mode(self) -> Modes {
        match self {
            Self::Wind => Modes::WIND_HELD,
            Self::Thrust => Modes::THRUST_MODELLED,
            Self::Joints => Modes::JOINTS_PREDICTED,
            Self::LinearVelocity | Self::AngularVelocity => Modes::VELOCITY_PREDICTED,
            Self::Position => Modes::POSITION_PREDICTED,
            Self::Rotation => Modes::ROTATION_PREDICTED,
            Self::Feet => Modes::FEET_PREDICTED,
        }
    }

    /// Whether the robot descends if it is missing.
    pub(super) fn is_vital(self) -> bool {
        matches!(self, Self::Joints | Self::Position | Self::Rotation) || self.is_velocity()
    }

    /// Whether it is a velocity of the base.
    pub(super) fn is_velocity(self) -> bool {
        matches!(self, Self::LinearVelocity | Self::AngularVelocity)
    }
}

/// A channel: numbers that are accepted or predicted together.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) kind: ChannelKind,
    pub(super) range: Range<usize>,
}
