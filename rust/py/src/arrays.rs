//! Conversion between NumPy arrays and vectors; shape and dtype are checked only here.

use flight_core::BuildError;
use nalgebra::{Dim, Matrix, Matrix3, RawStorage, Vector3};
use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{Element, IntoPyArray, PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// A float64 array argument of any shape.
pub type Input<'py> = PyReadonlyArrayDyn<'py, f64>;
/// A float64 array result.
pub type Output<'py> = Bound<'py, PyArrayDyn<f64>>;

/// Converts an error of construction to Python's `ConfigError`, with the same text and its parts as attributes.
pub fn value_error(error: BuildError) -> PyErr {
    let convert = |py: Python<'_>| -> PyResult<PyErr> {
        let (parts, attributes) = (error.parts(), PyDict::new(py));
        for (name, text) in
            [("file", parts.file), ("key", parts.key), ("value", parts.value), ("expected", parts.expected)]
        {
            attributes.set_item(name, text)?;
        }
        attributes.set_item("suggestions", PyTuple::new(py, parts.suggestions)?)?;
        let class = py.import("jax_aero.base.terminal")?.getattr("ConfigError")?;
        Ok(PyErr::from_value(class.call((error.to_string(),), Some(&attributes))?))
    };
    Python::attach(convert).unwrap_or_else(|failed| failed)
}

/// Converts another error to a `ValueError` with the same text.
pub fn plain_error(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Entries of `array` in row-major order, if it has the given shape.
pub fn entries(name: &str, array: &Input<'_>, shape: &[usize]) -> PyResult<Vec<f64>> {
    let view = array.as_array();
    if view.shape() != shape {
        return Err(PyValueError::new_err(format!(
            "`{name}` has shape {:?}; expected {shape:?}",
            view.shape()
        )));
    }
    Ok(view.iter().copied().collect())
}

/// As [`entries`]; all entries must be finite.
pub fn finite_entries(name: &str, array: &Input<'_>, shape: &[usize]) -> PyResult<Vec<f64>> {
    let values = entries(name, array, shape)?;
    match values.iter().find(|value| !value.is_finite()) {
        None => Ok(values),
        Some(value) => Err(value_error(BuildError::bad_value(format!("`{name}`"), value, "finite numbers"))),
    }
}

/// Converts to a vector with three entries.
pub fn vector3(name: &str, array: &Input<'_>) -> PyResult<Vector3<f64>> {
    Ok(Vector3::from_column_slice(&entries(name, array, &[3])?))
}

/// Converts to a 3 × 3 matrix.
pub fn matrix3(name: &str, array: &Input<'_>) -> PyResult<Matrix3<f64>> {
    Ok(Matrix3::from_row_slice(&entries(name, array, &[3, 3])?))
}

/// Row-major array of the given shape, whose size must be the length of `data`.
pub fn array<'py, T: Element>(
    py: Python<'py>,
    shape: &[usize],
    data: Vec<T>,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let array = ArrayD::from_shape_vec(IxDyn(shape), data).map_err(plain_error)?;
    Ok(array.into_pyarray(py))
}

/// Converts a matrix of any storage to a two-dimensional array.
pub fn matrix<'py, R: Dim, C: Dim, S: RawStorage<f64, R, C>>(
    py: Python<'py>,
    matrix: &Matrix<f64, R, C, S>,
) -> PyResult<Output<'py>> {
    let rows = matrix.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<f64>>()).collect();
    array(py, &[matrix.nrows(), matrix.ncols()], rows)
}

/// Converts a slice to a one-dimensional array.
pub fn vector<'py>(py: Python<'py>, values: &[f64]) -> PyResult<Output<'py>> {
    array(py, &[values.len()], values.to_vec())
}

/// Array whose rows are the given vectors.
pub fn vectors<'py>(py: Python<'py>, values: &[Vector3<f64>]) -> PyResult<Output<'py>> {
    array(py, &[values.len(), 3], values.iter().flatten().copied().collect())
}
