//! Checks of a robot's numbers. Every error names the item and states the value.

use crate::error::BuildError;
use crate::spatial::unit_vector;
use nalgebra::{Matrix3, Unit, Vector3};

/// Tolerance of the conditions on moments of inertia, relative to the largest: published values have six
/// digits, so those of a flat plate may violate them by that much.
const ROUNDING_OF_MOMENTS: f64 = 1e-6;

/// Radius of gyration \[m\] up to which a moment of inertia counts as none: no body is so thin.
const LEAST_GYRATION: f64 = 1e-6;

/// Checks that no name occurs twice.
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

/// Checks that a vector is finite.
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

/// Checks that a direction has length 1.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn unit(item: &str, v: &[f64; 3]) -> Result<Unit<Vector3<f64>>, BuildError> {
    unit_vector(finite(item, v)?).ok_or_else(|| BuildError::bad_value(item, show(v), "a vector of length 1"))
}

/// Checks that limits are finite and that the lower one is less than the upper one.
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

/// Principal moments of an inertia about a centre of mass, in ascending order; none may be negative.
///
/// Symmetry needs no check, because a robot's file states each product of inertia once.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn moments(item: &str, inertia: &Matrix3<f64>) -> Result<[f64; 3], BuildError> {
    let moments = principal_moments(item, inertia)?;
    if moments[0] < -ROUNDING_OF_MOMENTS * moments[2].abs() {
        return Err(moments_error(item, &moments, "no negative moment"));
    }
    Ok(moments)
}

/// Checks that no principal moment, of some in ascending order, exceeds the sum of the other two, as those of masses
/// never do.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn triangle(item: &str, moments: &[f64; 3]) -> Result<(), BuildError> {
    let [least, middle, greatest] = *moments;
    if greatest > least + middle + ROUNDING_OF_MOMENTS * greatest.abs() {
        return Err(moments_error(item, moments, "none above the sum of the other two"));
    }
    Ok(())
}

/// Checks that the inertia of a mass \[kg\] is physically possible, and that the body resists rotation about every axis;
/// otherwise the mass matrix could be singular.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item`.
pub fn inertia_of_moving_body(item: &str, matrix: &Matrix3<f64>, mass: f64) -> Result<(), BuildError> {
    let moments = principal_moments(item, matrix)?;
    if moments[0] <= mass * LEAST_GYRATION * LEAST_GYRATION {
        let expected = format!("three positive moments, with radii of gyration above {LEAST_GYRATION:e} m");
        return Err(moments_error(item, &moments, &expected));
    }
    triangle(item, &moments)
}

/// Principal moments in ascending order.
fn principal_moments(item: &str, inertia: &Matrix3<f64>) -> Result<[f64; 3], BuildError> {
    // The eigenvalue iteration does not terminate for NaN.
    if !inertia.iter().all(|x| x.is_finite()) {
        return Err(BuildError::bad_value(item, show(inertia.as_slice()), "finite numbers"));
    }
    let mut moments: [f64; 3] = inertia.symmetric_eigenvalues().into();
    moments.sort_by(f64::total_cmp);
    Ok(moments)
}

fn moments_error(item: &str, moments: &[f64; 3], expected: &str) -> BuildError {
    BuildError::bad_value(item, format!("principal moments {}", show(moments)), expected)
}

fn show(values: &[f64]) -> String {
    format!("{values:?}")
}
