//! NumPy arrays to vectors and back: shape and dtype are checked here and nowhere else.

use nalgebra::{Dim, Matrix, Matrix3, RawStorage, Vector3};
use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{IntoPyArray, PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A float64 array argument of any shape.
pub type Input<'py> = PyReadonlyArrayDyn<'py, f64>;
/// A float64 array result.
pub type Output<'py> = Bound<'py, PyArrayDyn<f64>>;

/// Errors of the crates are `ValueError`s with the same text.
pub fn value_error(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The entries in row-major order, if the array has `shape`.
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

/// A vector of three.
pub fn vector3(name: &str, array: &Input<'_>) -> PyResult<Vector3<f64>> {
    Ok(Vector3::from_column_slice(&entries(name, array, &[3])?))
}

/// A 3 × 3 matrix.
pub fn matrix3(name: &str, array: &Input<'_>) -> PyResult<Matrix3<f64>> {
    Ok(Matrix3::from_row_slice(&entries(name, array, &[3, 3])?))
}

/// A row-major array of the given shape; `data` must fill it.
pub fn array<'py>(py: Python<'py>, shape: &[usize], data: Vec<f64>) -> PyResult<Output<'py>> {
    let array = ArrayD::from_shape_vec(IxDyn(shape), data).map_err(value_error)?;
    Ok(array.into_pyarray(py))
}

/// A matrix of any storage as a two-dimensional array.
pub fn matrix<'py, R: Dim, C: Dim, S: RawStorage<f64, R, C>>(
    py: Python<'py>,
    matrix: &Matrix<f64, R, C, S>,
) -> PyResult<Output<'py>> {
    let rows = matrix.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<f64>>()).collect();
    array(py, &[matrix.nrows(), matrix.ncols()], rows)
}

/// Numbers as a one-dimensional array.
pub fn vector<'py>(py: Python<'py>, values: &[f64]) -> PyResult<Output<'py>> {
    array(py, &[values.len()], values.to_vec())
}

/// Vectors of three as the rows of an array.
pub fn vectors<'py>(py: Python<'py>, values: &[Vector3<f64>]) -> PyResult<Output<'py>> {
    array(py, &[values.len(), 3], values.iter().flatten().copied().collect())
}
