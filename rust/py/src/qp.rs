//! Solvers for box-constrained QPs.

use crate::arrays::{Input, Output, entries, vector};
#[cfg(feature = "clarabel")]
use flight_core::qp::ClarabelSolver;
use flight_core::qp::{DualActiveSet, PrimalActiveSet, QpAnswer, QpProblem, QpSolver, WarmStart};
use nalgebra::{DMatrix, DVector};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Greatest number of variables; the matrices then take some hundred megabytes.
const MAX_VARIABLES: usize = 4096;

/// A box QP solver for problems of one size: `min ½ xᵀHx + gᵀx`, `lower ≤ x ≤ upper`.
///
/// `solver` is "active_set" (warm started from the last answer), "dual_active_set" or "clarabel".
#[pyclass(module = "jax_aero._core")]
pub struct BoxQpSolver {
    n: usize,
    method: Box<dyn QpSolver>,
    start: WarmStart,
}

fn problem(
    n: usize,
    h: &Input<'_>,
    g: &Input<'_>,
    lower: &Input<'_>,
    upper: &Input<'_>,
) -> PyResult<QpProblem> {
    let mut problem = QpProblem::new(n, 0);
    problem.h = DMatrix::from_row_slice(n, n, &entries("h", h, &[n, n])?);
    problem.g = DVector::from_vec(entries("g", g, &[n])?);
    problem.lower = DVector::from_vec(entries("lower", lower, &[n])?);
    problem.upper = DVector::from_vec(entries("upper", upper, &[n])?);
    Ok(problem)
}

/// Answer of a solver as a dict: status (text), status_code, iterations, kkt, active.
pub fn answer<'py>(py: Python<'py>, answer: &QpAnswer) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("status", format!("{:?}", answer.status))?;
    out.set_item("status_code", answer.status.code())?;
    out.set_item("iterations", answer.iterations)?;
    out.set_item("kkt", answer.kkt)?;
    out.set_item("active", answer.active)?;
    Ok(out)
}

#[pymethods]
impl BoxQpSolver {
    #[new]
    #[pyo3(signature = (n, solver = "active_set"))]
    fn new(n: usize, solver: &str) -> PyResult<Self> {
        if n > MAX_VARIABLES {
            return Err(PyValueError::new_err(format!("n is {n}; expected at most {MAX_VARIABLES}")));
        }
        let method: Box<dyn QpSolver> = match solver {
            "active_set" => Box::new(PrimalActiveSet::new(n)),
            "dual_active_set" => Box::new(DualActiveSet::new(n, 0)),
            #[cfg(feature = "clarabel")]
            "clarabel" => Box::new(ClarabelSolver::new(n, 0)),
            _ => {
                let clarabel =
                    if cfg!(feature = "clarabel") { " or clarabel" } else { "; this build lacks clarabel" };
                return Err(PyValueError::new_err(format!(
                    "solver is `{solver}`; expected active_set, dual_active_set{clarabel}"
                )));
            }
        };
        Ok(Self { n, method, start: WarmStart::cold(n) })
    }

    /// Solve one problem; returns (x, answer).
    fn solve<'py>(
        &mut self,
        py: Python<'py>,
        h: Input<'py>,
        g: Input<'py>,
        lower: Input<'py>,
        upper: Input<'py>,
    ) -> PyResult<(Output<'py>, Bound<'py, PyDict>)> {
        let problem = problem(self.n, &h, &g, &lower, &upper)?;
        let outcome = self.method.solve_from(&mut self.start, &problem);
        Ok((vector(py, self.method.x())?, answer(py, &outcome)?))
    }

    /// Discard the last answer, so that the next solve starts cold.
    fn reset(&mut self) {
        self.start = WarmStart::cold(self.n);
    }
}

/// Scaled KKT residual of `x`, by which every answer is certified.
#[pyfunction]
pub fn kkt_residual(
    h: Input<'_>,
    g: Input<'_>,
    lower: Input<'_>,
    upper: Input<'_>,
    x: Input<'_>,
) -> PyResult<f64> {
    let n = g.as_array().len();
    let problem = problem(n, &h, &g, &lower, &upper)?;
    Ok(flight_core::qp::kkt_residual(&problem, &entries("x", &x, &[n])?, &[]))
}
