//! The box QP solvers.

use crate::arrays::{Input, Output, entries, vector};
use flight_core::control::qp::{ActiveSetSolver, BoxQp, ClarabelSolver, QpAnswer};
use nalgebra::{DMatrix, DVector};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A box QP solver for problems of one size: `min ½ xᵀHx + gᵀx`, `lower ≤ x ≤ upper`.
///
/// `solver` is "active_set" (warm started from the last answer) or "clarabel".
#[pyclass(module = "jax_aero._core")]
pub struct BoxQpSolver {
    n: usize,
    kind: Kind,
}

enum Kind {
    ActiveSet(Box<ActiveSetSolver>),
    Clarabel(Box<ClarabelSolver>),
}

fn problem(n: usize, h: &Input<'_>, g: &Input<'_>, lower: &Input<'_>, upper: &Input<'_>) -> PyResult<BoxQp> {
    let mut problem = BoxQp::new(n);
    problem.h = DMatrix::from_row_slice(n, n, &entries("h", h, &[n, n])?);
    problem.g = DVector::from_vec(entries("g", g, &[n])?);
    problem.lower = DVector::from_vec(entries("lower", lower, &[n])?);
    problem.upper = DVector::from_vec(entries("upper", upper, &[n])?);
    Ok(problem)
}

/// What a solver said, as a dict: status (text), status_code, iterations, kkt, active.
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
        let kind = match solver {
            "active_set" => Kind::ActiveSet(Box::new(ActiveSetSolver::new(n))),
            "clarabel" => Kind::Clarabel(Box::new(ClarabelSolver::new(n))),
            _ => {
                return Err(PyValueError::new_err(format!(
                    "solver is `{solver}`; expected active_set or clarabel"
                )));
            }
        };
        Ok(Self { n, kind })
    }

    /// Solve one problem; returns (x, what the solver said).
    fn solve<'py>(
        &mut self,
        py: Python<'py>,
        h: Input<'py>,
        g: Input<'py>,
        lower: Input<'py>,
        upper: Input<'py>,
    ) -> PyResult<(Output<'py>, Bound<'py, PyDict>)> {
        let problem = problem(self.n, &h, &g, &lower, &upper)?;
        let (said, x) = match &mut self.kind {
            Kind::ActiveSet(solver) => (solver.solve(&problem), solver.x()),
            Kind::Clarabel(solver) => (solver.solve(&problem), solver.x()),
        };
        Ok((vector(py, x)?, answer(py, &said)?))
    }

    /// Forget the last answer: the next solve starts cold.
    fn reset(&mut self) {
        if let Kind::ActiveSet(solver) = &mut self.kind {
            solver.reset();
        }
    }
}

/// Scaled KKT residual of `x`, the certificate that every answer is judged by.
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
    Ok(flight_core::control::qp::kkt_residual(&problem, &entries("x", &x, &[n])?))
}
