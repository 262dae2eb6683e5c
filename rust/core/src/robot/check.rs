//! Conditions on a robot's numbers. Every error names the item and shows the value.

use crate::error::BuildError;
use crate::spatial::unit_vector;
use nalgebra::{Matrix3, Unit, Vector3};

/// How far moments of inertia may stray from what is possible, relative to the largest: published
/// figures carry six digits, so a flat plate's may miss by that much.
const ROUNDING_OF_MOMENTS: f64 = 1e-6;

/// Refuses a name that occurs twice.
///
/// # Errors
/// [`BuildError::BadValue`] naming it.
pub fn unique<'a>(kind: &str, names: impl IntoIterator<Item = &'a str>) -> Result<(), BuildError> {
    let mut seen = std::collections::BTreeSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(BuildError::bad_value(
                format!("{kind} `{name}`"),
                "listed more than once",
                "a name that occurs once",
            ));
        }
    }
    Ok(())
}

/// Refuses a vector that is not finite.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn finite(item: &str, v: &[f64; 3]) -> Result<Vector3<f64>, BuildError> {
    if v.iter().all(|x| x.is_finite()) {
        Ok(Vector3::from(*v))
    } else {
        Err(BuildError::bad_value(item, show(v), "three finite numbers"))
    }
}

/// Refuses a direction that is not of length 1.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn unit(item: &str, v: &[f64; 3]) -> Result<Unit<Vector3<f64>>, BuildError> {
    unit_vector(finite(item, v)?).ok_or_else(|| BuildError::bad_value(item, show(v), "a vector of length 1"))
}

/// Refuses limits that leave nothing between them, or that are not finite.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn interval(item: &str, lower: f64, upper: f64) -> Result<(f64, f64), BuildError> {
    if lower.is_finite() && upper.is_finite() && lower < upper {
        Ok((lower, upper))
    } else {
        Err(BuildError::bad_value(
            item,
            show(&[lower, upper]),
            "a finite lower limit below a finite upper one",
        ))
    }
}

/// Refuses an inertia about a centre of mass that no distribution of mass has.
///
/// Its principal moments must not be negative, and none may exceed the sum of the other two. Symmetry
/// needs no check: a robot's file writes each product of inertia once.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn inertia(item: &str, inertia: &Matrix3<f64>) -> Result<(), BuildError> {
    let moments = principal_moments(item, inertia)?;
    let [least, middle, greatest] = moments;
    let slack = ROUNDING_OF_MOMENTS * greatest.abs();
    if least < -slack {
        return Err(refused_moments(item, &moments, "no negative moment"));
    }
    if greatest > least + middle + slack {
        return Err(refused_moments(item, &moments, "none above the sum of the other two"));
    }
    Ok(())
}

/// As [`inertia`], and refuses a body that does not resist rotation about every axis: a joint could
/// spin it without effort, and the mass matrix would be singular.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn inertia_of_moving_body(item: &str, matrix: &Matrix3<f64>) -> Result<(), BuildError> {
    let moments = principal_moments(item, matrix)?;
    if moments[0] <= 0.0 {
        return Err(refused_moments(item, &moments, "three positive moments"));
    }
    inertia(item, matrix)
}

/// Principal moments in rising order.
fn principal_moments(item: &str, inertia: &Matrix3<f64>) -> Result<[f64; 3], BuildError> {
    // The eigenvalue iteration does not return on NaN.
    if !inertia.iter().all(|x| x.is_finite()) {
        return Err(BuildError::bad_value(item, show(inertia.as_slice()), "finite numbers"));
    }
    let mut moments: [f64; 3] = inertia.symmetric_eigenvalues().into();
    moments.sort_by(f64::total_cmp);
    Ok(moments)
}

fn refused_moments(item: &str, moments: &[f64; 3], expected: &str) -> BuildError {
    BuildError::bad_value(item, format!("principal moments {}", show(moments)), expected)
}

fn show(values: &[f64]) -> String {
    format!("{values:?}")
}
