//! A chain of solvers, tried in order until one has a certified solution.

#[cfg(feature = "clarabel")]
use super::ClarabelSolver;
use super::{DualActiveSet, PrimalActiveSet, QpAnswer, QpProblem, QpSolver, QpStatus, WarmStart};

/// A solver of the chain.
#[derive(Debug, Clone)]
pub enum Method {
    /// Boxes only.
    Primal(PrimalActiveSet),
    /// Boxes and rows.
    Dual(DualActiveSet),
    /// Boxes and rows; allocates.
    #[cfg(feature = "clarabel")]
    Clarabel(ClarabelSolver),
}

impl QpSolver for Method {
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer {
        match self {
            Self::Primal(solver) => solver.solve(qp),
            Self::Dual(solver) => solver.solve(qp),
            #[cfg(feature = "clarabel")]
            Self::Clarabel(solver) => solver.solve(qp),
        }
    }

    fn x(&self) -> &[f64] {
        match self {
            Self::Primal(solver) => solver.x(),
            Self::Dual(solver) => solver.x(),
            #[cfg(feature = "clarabel")]
            Self::Clarabel(solver) => solver.x(),
        }
    }

    fn multipliers(&self) -> &[f64] {
        match self {
            Self::Primal(solver) => solver.multipliers(),
            Self::Dual(solver) => solver.multipliers(),
            #[cfg(feature = "clarabel")]
            Self::Clarabel(solver) => solver.multipliers(),
        }
    }
}

/// Solvers in the order in which they are tried until one gives a certified answer.
#[derive(Debug, Clone)]
pub struct QpChain {
    methods: Vec<Method>,
    /// Index of the method that answered last.
    answered: usize,
}

impl QpChain {
    /// A chain of `methods`, in this order.
    #[must_use]
    pub fn new(methods: Vec<Method>) -> Self {
        Self { methods, answered: 0 }
    }

    /// Solves `qp`. A primal method in the first place starts from `start` and updates it for its next solve; the other
    /// methods start from scratch.
    pub fn solve_from(&mut self, start: &mut WarmStart, qp: &QpProblem) -> QpAnswer {
        if let Some(Method::Primal(solver)) = self.methods.first_mut() {
            solver.set_start(start);
        }
        let answer = self.solve(qp);
        if let Some(Method::Primal(solver)) = self.methods.first() {
            solver.store_start(start);
        }
        answer
    }
}

impl QpSolver for QpChain {
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer {
        let mut answer = QpAnswer::from_status(QpStatus::SizeMismatch);
        for (place, method) in self.methods.iter_mut().enumerate() {
            answer = method.solve(qp);
            self.answered = place;
            if answer.status == QpStatus::Solved {
                break;
            }
        }
        answer
    }

    fn x(&self) -> &[f64] {
        self.methods.get(self.answered).map_or(&[], QpSolver::x)
    }

    fn multipliers(&self) -> &[f64] {
        self.methods.get(self.answered).map_or(&[], QpSolver::multipliers)
    }
}
