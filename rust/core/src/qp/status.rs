//! Outcome of a solve.

/// Outcome of a solve. The codes of [`QpStatus::code`] are for logs and never change their meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum QpStatus {
    /// `x` is the minimiser: its [`kkt_residual`](super::kkt_residual) is at most [`KKT_TOLERANCE`](super::KKT_TOLERANCE).
    Solved = 0,
    /// Iteration limit reached; `x` is feasible and not worse than the starting point or, after the dual method,
    /// unchanged.
    IterationLimit = 1,
    /// `H` is not positive definite, to working precision, on a set of free variables.
    NotPositiveDefinite = 2,
    /// Some `lower > upper`, or bounds and rows exclude every finite value; `x` is unchanged.
    InfeasibleBounds = 3,
    /// NaN or infinity in the data (infinite bounds are allowed in the unbounded direction), or overflow; do not use
    /// `x`.
    NonFinite = 4,
    /// The solver finished, but its `x` does not meet [`KKT_TOLERANCE`](super::KKT_TOLERANCE).
    Inaccurate = 5,
    /// Problem and solver have different numbers of variables or rows; `x` is unchanged.
    SizeMismatch = 6,
    /// The interior-point method failed for another reason (numerical error, no progress).
    Breakdown = 7,
}

impl QpStatus {
    /// Code for logs; 0 is solved.
    #[must_use]
    pub fn code(self) -> u8 {
        self as u8
    }
}
