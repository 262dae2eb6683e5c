//! A chain of solvers, tried in order until one has a certified solution.

use super::{QpAnswer, QpProblem, QpSolver, QpStatus, WarmStart};

/// Solvers in the order in which they are tried until one gives a certified answer.
#[derive(Debug)]
pub struct QpChain {
    methods: Vec<Box<dyn QpSolver>>,
    /// Index of the method that answered last.
    answered: usize,
}

impl QpChain {
    /// A chain of `methods`, in this order.
    #[must_use]
    pub fn new(methods: Vec<Box<dyn QpSolver>>) -> Self {
        Self { methods, answered: 0 }
    }

    fn solve_in_order(&mut self, mut solve: impl FnMut(&mut dyn QpSolver) -> QpAnswer) -> QpAnswer {
        let mut answer = QpAnswer::from_status(QpStatus::SizeMismatch);
        for (place, method) in self.methods.iter_mut().enumerate() {
            answer = solve(method.as_mut());
            self.answered = place;
            if answer.status == QpStatus::Solved {
                break;
            }
        }
        answer
    }
}

impl QpSolver for QpChain {
    fn solve(&mut self, qp: &QpProblem) -> QpAnswer {
        self.solve_in_order(|method| method.solve(qp))
    }

    fn solve_from(&mut self, start: &mut WarmStart, qp: &QpProblem) -> QpAnswer {
        self.solve_in_order(|method| method.solve_from(start, qp))
    }

    fn x(&self) -> &[f64] {
        self.methods.get(self.answered).map_or(&[], |method| method.x())
    }

    fn multipliers(&self) -> &[f64] {
        self.methods.get(self.answered).map_or(&[], |method| method.multipliers())
    }
}
