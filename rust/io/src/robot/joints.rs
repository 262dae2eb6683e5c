//! Limits of each joint: those of the URDF, unless the robot's TOML file overrides them.

use super::tree::{Tree, TreeJoint};
use flight_core::error::{BuildError, check as check_number};
use flight_core::robot::{Joint, JointKind, check};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A joint that moves.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct JointEntry {
    /// Name of the joint in the URDF.
    pub(super) name: String,
    /// Limits of a revolute joint \[deg\]; by default those of the URDF.
    pub(super) limits_deg: Option<[f64; 2]>,
    /// Limits of a prismatic joint \[m\]; by default those of the URDF.
    pub(super) limits: Option<[f64; 2]>,
    /// Greatest torque or force \[N m, N\]; by default the URDF's effort.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub(super) torque_max: Option<f64>,
    /// Greatest rate of the torque or force \[N m/s, N/s\]; unlimited by default.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub(super) torque_rate_max: Option<f64>,
    /// Greatest velocity of a revolute joint \[deg/s\]; by default that of the URDF.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub(super) velocity_max_deg: Option<f64>,
    /// Greatest velocity of a prismatic joint \[m/s\]; by default that of the URDF.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub(super) velocity_max: Option<f64>,
}

/// The joints of these entries, in their order.
pub(super) fn joints<'a>(
    entries: impl Iterator<Item = &'a JointEntry>,
    tree: &Tree<'_>,
) -> Result<Vec<Joint>, BuildError> {
    entries.zip(&tree.joints).map(|(entry, in_urdf)| joint(entry, in_urdf)).collect()
}

fn joint(entry: &JointEntry, in_urdf: &TreeJoint<'_>) -> Result<Joint, BuildError> {
    let motion = in_urdf.motion;
    // Keys of the other kind of joint are refused, so that units cannot be confused.
    let (limits_key, velocity_key, per_unit, given, other) = match motion.kind {
        JointKind::Revolute => (
            "limits_deg",
            "velocity_max_deg",
            1_f64.to_radians(),
            (entry.limits_deg, entry.velocity_max_deg),
            [("limits", entry.limits.is_some()), ("velocity_max", entry.velocity_max.is_some())],
        ),
        JointKind::Prismatic => (
            "limits",
            "velocity_max",
            1.0,
            (entry.limits, entry.velocity_max),
            [
                ("limits_deg", entry.limits_deg.is_some()),
                ("velocity_max_deg", entry.velocity_max_deg.is_some()),
            ],
        ),
    };
    let of = |key: &str| format!("{key} of joint `{}`", entry.name);
    if let Some((key, _)) = other.iter().find(|(_, is_given)| *is_given) {
        let kind = format!("a key of a joint that is not {:?}", motion.kind).to_lowercase();
        return Err(BuildError::bad_value(of(key), kind, format!("{limits_key} and {velocity_key}")));
    }
    let limits = match given.0 {
        Some([lower, upper]) => {
            check::interval(&of(limits_key), lower, upper)?;
            (lower * per_unit, upper * per_unit)
        }
        None => motion.limits.ok_or_else(|| {
            missing_key(&of(limits_key), "limits, as the joint is continuous in the URDF, or its range empty")
        })?,
    };
    // The URDF states no limit by 0; one that is overridden means nothing.
    let greatest = |key: &str, unit: f64, given: Option<f64>, name: &str, urdf: f64| match given {
        Some(value) => Ok(value * unit),
        None if urdf == 0.0 => Err(missing_key(&of(key), "a positive number, as the URDF has none")),
        None => {
            let item = format!("URDF {name} limit of joint `{}`", entry.name);
            check_number(&item, urdf, |x| x > 0.0, "a number > 0; 0, -1 or inf for none")
        }
    };
    let (lower, upper) = motion.limits.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
    Ok(Joint {
        name: entry.name.clone(),
        kind: motion.kind,
        parent_from_child: in_urdf.parent_from_child,
        axis_b: motion.axis,
        limits,
        stops: (lower.min(limits.0), upper.max(limits.1)),
        torque_max: greatest("torque_max", 1.0, entry.torque_max, "effort", motion.effort)?,
        torque_rate_max: entry.torque_rate_max.unwrap_or(f64::INFINITY),
        velocity_max: greatest(velocity_key, per_unit, given.1, "velocity", motion.velocity)?,
        rotor_inertia: 0.0,
    })
}

fn missing_key(item: &str, expected: &str) -> BuildError {
    BuildError::bad_value(item, "missing", expected)
}
