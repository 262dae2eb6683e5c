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
mod solver;
mod status;
mod warm_start;

pub use certificate::{KKT_TOLERANCE, QpAnswer, kkt_residual};
pub use chain::QpChain;
#[cfg(feature = "clarabel")]
pub use clarabel::ClarabelSolver;
pub use dual::DualActiveSet;
pub use primal::{PASSES_PER_VARIABLE, PrimalActiveSet};
pub use problem::QpProblem;
pub use solver::QpSolver;
pub use status::QpStatus;
pub use warm_start::WarmStart;
