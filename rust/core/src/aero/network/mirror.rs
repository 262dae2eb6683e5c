//! Mirror symmetry of a robot: the image of every joint and link, determined from the robot's model.
//!
//! Equation M25 of `docs/model`.

use crate::error::{BuildError, place_of};
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use nalgebra::{Matrix3, Vector3};

/// Greatest distance between a mirrored link and its image \[m\]; for joint axes, greatest deviation of the
/// cosine from ±1.
const TOLERANCE: f64 = 0.02;

/// Reflection about the x-z plane of the base.
#[must_use]
pub(crate) fn reflect(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x, -v.y, v.z)
}

/// The mirror image of every joint and link.
#[derive(Debug, Clone)]
pub(crate) struct Mirror {
    /// For every joint that is an input: the index of its image among the inputs, and the sign of the image's
    /// angle.
    pub joints: Vec<(usize, f64)>,
    /// For every link: the index of its image, and the map from the link's axes to those of the image:
    ///
    /// ```text
    /// T_l = R_l'ᵀ S R_l   at zero joints, S = diag(1, −1, 1)
    /// ```
    pub links: Vec<(usize, Matrix3<f64>)>,
}

impl Mirror {
    /// Finds the image of every link, and of every joint in `joints` (indices of the robot's joints).
    ///
    /// Left and right are paired by name. The kinematics at zero joint positions give the signs and verify
    /// the symmetry.
    ///
    /// # Errors
    /// A joint or link whose image is absent, is at another place, or turns about another axis.
    pub(crate) fn new(robot: &RobotModel, joints: &[usize]) -> Result<Self, BuildError> {
        let kinematics = Kinematics::new(robot);
        let names: Vec<&str> = joints.iter().map(|&joint| robot.joints[joint].name.as_str()).collect();
        let joint_images = joints.iter().zip(&names).map(|(&joint, name)| {
            let image = place_of_image(&names, name, "joint")?;
            let motion = &kinematics.bodies[joint + 1];
            let other = &kinematics.bodies[joints[image] + 1];
            // The reflection maps polar vectors; axial vectors, such as axes of rotation, change sign in
            // addition.
            let cosine = other.joint_linear_i.dot(&reflect(&motion.joint_linear_i))
                - other.joint_angular_i.dot(&reflect(&motion.joint_angular_i));
            if cosine.abs() < 1.0 - TOLERANCE {
                let item = format!("axis of joint `{name}`, mirrored, against that of its image");
                return Err(BuildError::bad_value(item, cosine, "a cosine of ±1"));
            }
            Ok((image, cosine.signum()))
        });
        let names: Vec<&str> = robot.aero_links.iter().map(|link| link.name.as_str()).collect();
        let link_images = robot.aero_links.iter().map(|link| {
            let image = place_of_image(&names, &link.name, "aerodynamic link")?;
            let other = &robot.aero_links[image];
            let (pose, image_pose) =
                (kinematics.frame_pose(&link.frame), kinematics.frame_pose(&other.frame));
            let centre = pose.transform_point(&link.centre_l);
            let distance = (image_pose.transform_point(&other.centre_l) - reflect(&centre)).norm();
            if distance > TOLERANCE {
                let item = format!("distance of link `{}`, mirrored, from its image [m]", link.name);
                return Err(BuildError::bad_value(item, distance, format!("at most {TOLERANCE}")));
            }
            let reflection = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
            Ok((image, image_pose.rotation.transpose() * reflection * pose.rotation))
        });
        Ok(Self {
            joints: joint_images.collect::<Result<_, _>>()?,
            links: link_images.collect::<Result<_, _>>()?,
        })
    }
}

/// Index of the image of `name` among `names`: `l` and `r` are exchanged; a name without them is its own
/// image.
fn place_of_image(names: &[&str], name: &str, kind: &str) -> Result<usize, BuildError> {
    let swapped: Vec<&str> = name
        .split('_')
        .map(|part| match part {
            "l" => "r",
            "r" => "l",
            other => other,
        })
        .collect();
    place_of(format!("mirror image of {kind} `{name}`"), &swapped.join("_"), names)
}
