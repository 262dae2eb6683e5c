//! Forces on all links of the robot, with the axes, points and velocities at which a model is evaluated.
//!
//! The published code misplaces the points (`docs/deviations.md`). Each way of doing so has an enum here,
//! whose default is physically correct.
//!
//! Equations M18 and M27 of `docs/model`.

use super::{AeroModel, LinksInAir};
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use nalgebra::{DVector, Vector3};
use serde::{Deserialize, Serialize};

/// Point at which a link's force acts when its moment is formed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeverArm {
    /// At the aerodynamic centre, `p + R c`.
    #[default]
    Rotated,
    /// At `p + c`: the offset is added without rotation into inertial axes (published).
    Unrotated,
}

/// Point whose Jacobian maps a link's force in the controller's `Λ_a` and torque law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JacobianOffset {
    /// The aerodynamic centre, `p + R c`.
    #[default]
    LinkRotation,
    /// `p + R_B c`: the offset is rotated with the base instead of the link (published).
    BaseRotation,
}

/// Point whose velocity the controller subtracts from the wind to get a link's relative wind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinkVelocity {
    /// The aerodynamic centre.
    #[default]
    AtCentre,
    /// The point of [`JacobianOffset`] shifted once more by the unrotated offset (published).
    ShiftedTwice,
}

/// Conventions for these points: one value for the simulator, one for the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkConventions {
    /// Point at which the moment is formed.
    pub lever_arm: LeverArm,
    /// Point whose Jacobian maps the force to the joints.
    pub jacobian_offset: JacobianOffset,
    /// Point whose velocity enters the relative wind.
    pub link_velocity: LinkVelocity,
    /// Place of the aerodynamic link whose rotation turns the axes of all links (as flown); `None`: each its own.
    pub axes_of: Option<usize>,
}

/// Aerodynamic state of every link in one tick; preallocated, recomputed by [`LinkForces::update`].
#[derive(Debug, Clone)]
pub struct LinkForces {
    /// Symmetry axes (unit, inertial axes).
    pub axes_i: Vec<Vector3<f64>>,
    /// Velocity of the air relative to each link \[m/s, inertial axes\], see [`LinkVelocity`].
    pub v_air_i: Vec<Vector3<f64>>,
    /// Points at which moments are formed \[m, inertial axes\], see [`LeverArm`].
    pub arm_points_i: Vec<Vector3<f64>>,
    /// Points whose Jacobians map the forces \[m, inertial axes\], see [`JacobianOffset`].
    pub jacobian_points_i: Vec<Vector3<f64>>,
    /// Forces \[N, inertial axes\].
    pub forces_i: Vec<Vector3<f64>>,
}

impl LinkForces {
    /// Allocates for the links of `robot`; all forces are zero.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let zeros = vec![Vector3::zeros(); robot.aero_links.len()];
        Self {
            axes_i: zeros.clone(),
            v_air_i: zeros.clone(),
            arm_points_i: zeros.clone(),
            jacobian_points_i: zeros.clone(),
            forces_i: zeros,
        }
    }

    /// Recomputes axes, points and relative wind of every link, and evaluates the model.
    pub fn update(
        &mut self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        conventions: LinkConventions,
        model: &mut AeroModel,
        wind_i: &Vector3<f64>,
    ) {
        let base_rotation = &kinematics.bodies[0].i_from_b.rotation;
        let turning = conventions.axes_of.and_then(|place| robot.aero_links.get(place));
        let rotation_of_all = turning.map(|link| kinematics.frame_pose(&link.frame).rotation);
        for (index, link) in robot.aero_links.iter().enumerate() {
            let pose = kinematics.frame_pose(&link.frame);
            let origin = pose.position;
            let centre = pose.transform_point(&link.centre_l);
            let arm_point = match conventions.lever_arm {
                LeverArm::Rotated => centre,
                LeverArm::Unrotated => origin + link.centre_l,
            };
            let jacobian_point = match conventions.jacobian_offset {
                JacobianOffset::LinkRotation => centre,
                JacobianOffset::BaseRotation => origin + base_rotation * link.centre_l,
            };
            let velocity_point = match conventions.link_velocity {
                LinkVelocity::AtCentre => centre,
                LinkVelocity::ShiftedTwice => jacobian_point + link.centre_l,
            };
            self.axes_i[index] = rotation_of_all.unwrap_or(pose.rotation) * link.axis_l.into_inner();
            self.v_air_i[index] = wind_i - kinematics.bodies[link.frame.body].velocity_at(&velocity_point);
            self.arm_points_i[index] = arm_point;
            self.jacobian_points_i[index] = jacobian_point;
        }
        let Self { axes_i, v_air_i, forces_i, .. } = self;
        model.link_forces(&LinksInAir { robot, kinematics, axes_i, v_air_i, wind_i }, forces_i);
    }

    /// Sum of the forces \[N\] and of their moments about `point_i` \[N m\], inertial axes.
    #[must_use]
    pub fn wrench_about(&self, point_i: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let zero = (Vector3::zeros(), Vector3::zeros());
        self.forces_i
            .iter()
            .zip(&self.arm_points_i)
            .fold(zero, |(force, moment), (f, p)| (force + f, moment + (p - point_i).cross(f)))
    }

    /// Adds `Σ J_jᵀ f_j` with the Jacobians of [`Self::jacobian_points_i`].
    pub fn add_generalised_force(
        &self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        generalised: &mut DVector<f64>,
    ) {
        for (index, link) in robot.aero_links.iter().enumerate() {
            kinematics.add_generalised_force(
                link.frame.body,
                &self.jacobian_points_i[index],
                &self.forces_i[index],
                generalised,
            );
        }
    }
}
