//! Single values of a URDF, checked.

use flight_core::error::BuildError;
use flight_core::robot::check;
use flight_core::spatial::{Pose, rotation_from_rpy};
use nalgebra::{Unit, Vector3};
use urdf_rs::JointType;

/// A URDF origin; `item` says whose.
pub(super) fn pose(item: &str, origin: &urdf_rs::Pose) -> Result<Pose, BuildError> {
    let position = check::finite(&format!("origin xyz of {item}"), &origin.xyz)?;
    let rpy = check::finite(&format!("origin rpy of {item}"), &origin.rpy)?;
    Ok(Pose { rotation: rotation_from_rpy(&rpy), position })
}

/// The axis of a joint.
pub(super) fn axis(joint: &urdf_rs::Joint) -> Result<Unit<Vector3<f64>>, BuildError> {
    check::unit(&format!("axis of joint `{}`", joint.name), &joint.axis.xyz)
}

/// The limits of a joint \[rad\]; a continuous one has none.
pub(super) fn limits(joint: &urdf_rs::Joint) -> Result<Option<(f64, f64)>, BuildError> {
    if joint.joint_type == JointType::Continuous {
        return Ok(None);
    }
    let item = format!("URDF limit of joint `{}`", joint.name);
    check::interval(&item, joint.limit.lower, joint.limit.upper).map(Some)
}
