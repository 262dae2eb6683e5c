//! Merges links without relative motion into one body.
//!
//! Equation M6 of `docs/model`.

use super::urdf::Link;
use flight_core::error::{BuildError, check as check_number};
use flight_core::robot::{Body, check};
use flight_core::spatial::Pose;
use nalgebra::{Matrix3, Vector3};

/// Mass properties of a link in the axes of its body.
#[derive(Clone)]
pub(super) struct Part {
    mass: f64,
    com_b: Vector3<f64>,
    /// About the part's own centre of mass, body axes.
    inertia_b: Matrix3<f64>,
}

/// Mass properties of a link in the axes of its body; `None` for a link without mass.
///
/// The inertia of a link may be impossible where that of its body is not, which decides: a warning says so.
pub(super) fn part(
    link: &Link,
    body_from_link: &Pose,
    warnings: &mut Vec<String>,
) -> Result<Option<Part>, BuildError> {
    let Some(inertial) = &link.inertial else { return Ok(None) };
    let mass_item = format!("mass of link `{}`", link.name);
    let mass = check_number(&mass_item, inertial.mass, |m| m >= 0.0, "a mass that is not negative, in kg")?;
    let inertia = inertial.inertia;
    let inertia_item = format!("inertia of link `{}`", link.name);
    if mass == 0.0 {
        if inertia != Matrix3::zeros() {
            warnings.push(format!("{inertia_item} is left out, as its mass is 0"));
        }
        return Ok(None);
    }
    let moments = check::moments(&inertia_item, &inertia)?;
    if let Err(impossible) = check::triangle(&inertia_item, &moments) {
        warnings.push(format!("{impossible}; its body as a whole is possible"));
    }
    let body_from_inertial = *body_from_link * inertial.origin;
    let r = body_from_inertial.rotation;
    Ok(Some(Part { mass, com_b: body_from_inertial.position, inertia_b: r * inertia * r.transpose() }))
}

/// Merges parts into one body, which has no mass if none of them has one; the base needs one.
///
/// ```text
/// I = Σ I_k + m_k (d_k² 1 − d_k d_kᵀ),   d_k = c_k − c
/// ```
pub(super) fn merge(name: String, parent: Option<usize>, parts: &[Part]) -> Result<Body, BuildError> {
    if parts.is_empty() && parent.is_some() {
        let (com_b, inertia_b) = (Vector3::zeros(), Matrix3::zeros());
        return Ok(Body { name, parent, mass: 0.0, com_b, inertia_b }); // moves with what hangs from it
    }
    // Starts at 0.0, because `sum` of nothing is −0, which is confusing in an error.
    let total = parts.iter().fold(0.0, |total, part| total + part.mass);
    let mass = check_number(&format!("mass of body `{name}`"), total, |m| m > 0.0, "a positive mass, in kg")?;
    let com_b = parts.iter().map(|part| part.mass * part.com_b).sum::<Vector3<f64>>() / mass;
    let about_com: Matrix3<f64> = parts
        .iter()
        .map(|part| {
            let d = part.com_b - com_b;
            part.inertia_b
                + part.mass * (Matrix3::from_diagonal_element(d.norm_squared()) - d * d.transpose())
        })
        .sum();
    // Rotation of a part causes an asymmetry in the last digit.
    let inertia_b = 0.5 * (about_com + about_com.transpose());
    check::inertia_of_moving_body(&format!("inertia of body `{name}`"), &inertia_b, mass)?;
    Ok(Body { name, parent, mass, com_b, inertia_b })
}
