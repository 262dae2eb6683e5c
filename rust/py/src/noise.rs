//! Repeatable noise.

use crate::arrays::{Output, vector};
use flight_sim::noise::Noise;
use pyo3::prelude::*;

/// The first `count` numbers of a stream of a seed, uniform in (0, 1).
#[pyfunction]
pub fn uniforms(py: Python<'_>, seed: u64, stream: u64, count: usize) -> PyResult<Output<'_>> {
    let mut noise = Noise::new(seed, stream);
    vector(py, &std::iter::repeat_with(|| noise.uniform()).take(count).collect::<Vec<_>>())
}

/// The first `count` normal numbers of a stream of a seed, with mean 0 and standard deviation 1.
#[pyfunction]
pub fn normals(py: Python<'_>, seed: u64, stream: u64, count: usize) -> PyResult<Output<'_>> {
    let mut noise = Noise::new(seed, stream);
    vector(py, &std::iter::repeat_with(|| noise.normal()).take(count).collect::<Vec<_>>())
}
