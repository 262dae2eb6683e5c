//! The quadratic programs of the controller: one problem, one certificate, three methods, one chain.
//!
//! ```text
//! minimise  ½ xᵀ H x + gᵀ x   subject to   lower ≤ x ≤ upper,   Cᵀ x ≤ limit,     H symmetric positive definite
//! ```
//!
//! Without rows `C` this is the box-constrained problem of flight; standing adds rows for the feet.
//!
//! * [`PrimalActiveSet`]: boxes; warm started, exact, without allocation. Used in flight.
//! * [`DualActiveSet`]: boxes and rows; cold start, exact, without allocation. Used while standing, and second
//!   for boxes.
//! * `ClarabelSolver` (feature `clarabel`): an interior-point method, independent of the other two. It
//!   allocates; tests compare with it, and a configuration may select it.
//!
//! Every answer is checked: each [`QpAnswer`] has its [`kkt_residual`], computed from the problem alone, and a
//! [`QpChain`] tries its methods in order until one gives a certified answer.

mod certificate;
mod chain;
#[cfg(feature = "clarabel")]
mod clarabel;
mod dual;
mod primal;
mod problem;
mod scaled;

pub use certificate::{KKT_TOLERANCE, QpAnswer, QpStatus, kkt_residual};
pub use chain::QpChain;
#[cfg(feature = "clarabel")]
pub use clarabel::ClarabelSolver;
pub use dual::DualActiveSet;
pub use primal::{PASSES_PER_VARIABLE, PrimalActiveSet, WarmStart};
pub use problem::QpProblem;

use std::fmt::Debug;

/// A solver for problems of one size.
pub trait QpSolver: Debug + Send + Sync {
    /// Solves `qp`; the minimiser is then in [`QpSolver::x`].
    ///
    /// Any data result in a status without a panic. `x` keeps its value if the status says that there is no
    /// answer.
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer;

    /// As [`QpSolver::solve`], from a starting point that is updated for the next solve. Methods other than
    /// [`PrimalActiveSet`] ignore it and start from scratch.
    fn solve_from(&mut self, start: &mut WarmStart, qp: &QpProblem) -> QpAnswer {
        let _ = start;
        self.solve(qp)
    }

    /// The last answer, within the bounds of its problem; zero before the first solve.
    fn x(&self) -> &[f64];

    /// Multipliers of the rows in the last answer.
    fn multipliers(&self) -> &[f64];
}
