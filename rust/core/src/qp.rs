//! The quadratic programs of the controller: one problem, one certificate, three methods, one chain.
//!
//! ```text
//! minimise  ½ xᵀ H x + gᵀ x   subject to   lower ≤ x ≤ upper,   Cᵀ x ≤ limit,     H symmetric positive definite
//! ```
//!
//! Without rows `C` this is the box problem of a flying robot; a standing one has rows for its feet.
//!
//! * [`PrimalActiveSet`]: boxes; warm started, exact, without allocation. The method of a flying tick.
//! * [`DualActiveSet`]: boxes and rows; from scratch, exact, without allocation. The method of a standing
//!   tick, and the second one for boxes.
//! * `ClarabelSolver` (feature `clarabel`): an interior-point method that shares nothing with them but the
//!   data. It allocates; tests compare with it, and a configuration may choose it.
//!
//! Every answer is checked: each [`QpAnswer`] carries its [`kkt_residual`], computed from the problem
//! alone, and a [`QpChain`] tries its methods in order until one of them is certified.

mod certificate;
mod chain;
#[cfg(feature = "clarabel")]
mod clarabel;
mod dual;
mod primal;
mod problem;
mod scaled;

pub use certificate::{KKT_TOLERANCE, QpAnswer, QpStatus, kkt_residual};
pub use chain::{Method, QpChain};
#[cfg(feature = "clarabel")]
pub use clarabel::ClarabelSolver;
pub use dual::DualActiveSet;
pub use primal::{PASSES_PER_VARIABLE, PrimalActiveSet, WarmStart};
pub use problem::QpProblem;

/// A method that solves problems of one size.
pub trait QpSolver {
    /// Solves `qp`; the minimiser is then in [`QpSolver::x`].
    ///
    /// Total: any data give a status. `x` keeps its value where the status says that there is no answer.
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer;

    /// The last answer, inside the bounds of its problem. Zero before the first solve.
    fn x(&self) -> &[f64];

    /// Multipliers of the rows in the last answer.
    fn multipliers(&self) -> &[f64];
}
