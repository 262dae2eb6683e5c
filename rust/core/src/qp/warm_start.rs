//! Starting point of a solve.

/// Whether and at which bound a variable is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// Not held; it may touch a bound by chance.
    Free,
    /// At its lower bound.
    Lower,
    /// At its upper bound.
    Upper,
}

/// Starting point of a solve: the last answer and its working set.
#[derive(Debug, Clone, PartialEq)]
pub struct WarmStart {
    pub(super) x: Vec<f64>,
    pub(super) side: Vec<Side>,
}

impl WarmStart {
    /// Start at `clamp(0)` with no variable held, in `n` variables.
    #[must_use]
    pub fn cold(n: usize) -> Self {
        Self { x: vec![0.0; n], side: vec![Side::Free; n] }
    }

    /// Number of variables.
    #[must_use]
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there are no variables.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Copies a warm start; does not allocate. No effect if the sizes differ.
    pub(super) fn copy_from(&mut self, other: &Self) {
        if other.len() == self.len() {
            self.x.copy_from_slice(&other.x);
            self.side.copy_from_slice(&other.side);
        }
    }
}
