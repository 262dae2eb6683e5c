//! Single values of a URDF, checked.

use flight_core::error::{BuildError, check as check_number};
use flight_core::robot::{JointKind, check};
use flight_core::spatial::{Pose, rotation_from_rpy};
use nalgebra::{Unit, Vector3};
use quick_xml::Reader;
use quick_xml::events::Event;
use urdf_rs::JointType;

/// Deepest nesting of tags: a parser calls itself once a level, and a stack is finite.
const MAX_DEPTH: u32 = 64;

/// Refuses tags that nest too deeply, and says why; also for a text that is no XML.
pub(super) fn check_depth(text: &str) -> Result<(), String> {
    let mut reader = Reader::from_str(text);
    let mut depth = 0;
    loop {
        match reader.read_event().map_err(|error| error.to_string())? {
            Event::Start(_) if depth == MAX_DEPTH => {
                return Err(format!("tags nest more than {MAX_DEPTH} deep"));
            }
            Event::Start(_) => depth += 1,
            Event::End(_) => depth -= 1,
            Event::Eof => return Ok(()),
            _ => {}
        }
    }
}

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

/// How a joint moves its child; `None` for one that does not.
pub(super) fn kind(joint: &urdf_rs::Joint) -> Result<Option<JointKind>, BuildError> {
    match joint.joint_type {
        JointType::Fixed => Ok(None),
        JointType::Revolute | JointType::Continuous => Ok(Some(JointKind::Revolute)),
        JointType::Prismatic => Ok(Some(JointKind::Prismatic)),
        ref other => {
            let value = format!("{other:?}").to_lowercase();
            let expected = "revolute, continuous, prismatic or fixed";
            Err(BuildError::bad_value(format!("type of joint `{}`", joint.name), value, expected))
        }
    }
}

/// A limit of a joint's effort or velocity; `None` where the URDF says 0 or nothing.
pub(super) fn greatest(joint: &urdf_rs::Joint, key: &str, value: f64) -> Result<Option<f64>, BuildError> {
    let item = format!("URDF {key} limit of joint `{}`", joint.name);
    check_number(&item, value, |x| x >= 0.0, "a number ≥ 0").map(|x| (x > 0.0).then_some(x))
}

/// The limits of a joint \[rad, m\]; a continuous one has none.
pub(super) fn limits(joint: &urdf_rs::Joint) -> Result<Option<(f64, f64)>, BuildError> {
    if joint.joint_type == JointType::Continuous {
        return Ok(None);
    }
    let item = format!("URDF limit of joint `{}`", joint.name);
    check::interval(&item, joint.limit.lower, joint.limit.upper).map(Some)
}
