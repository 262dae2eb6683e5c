//! What every method offers.

use super::{QpAnswer, QpProblem, WarmStart};
use std::fmt::Debug;

/// A solver for problems of one size.
pub trait QpSolver: Debug + Send + Sync {
    /// Solves `qp`; the minimiser is then in [`QpSolver::x`].
    ///
    /// Any data result in a status without a panic. `x` keeps its value if the status says that there is no
    /// answer.
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer;

    /// As [`QpSolver::solve`], from a starting point that is updated for the next solve. Methods other than
    /// [`PrimalActiveSet`](super::PrimalActiveSet) ignore it and start from scratch.
    fn solve_from(&mut self, start: &mut WarmStart, qp: &QpProblem) -> QpAnswer {
        let _ = start;
        self.solve(qp)
    }

    /// The last answer, within the bounds of its problem; zero before the first solve.
    fn x(&self) -> &[f64];

    /// Multipliers of the rows in the last answer.
    fn multipliers(&self) -> &[f64];
}
