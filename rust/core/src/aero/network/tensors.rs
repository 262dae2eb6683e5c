//! The weights of a network: tensors by name, each of which is taken once.

use crate::error::BuildError;
use std::collections::BTreeMap;

/// A row-major array.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Length of every axis.
    pub shape: Vec<usize>,
    /// Values; their number is the product of the shape.
    pub values: Vec<f32>,
}

/// Tensors that have not been taken yet, by name.
#[derive(Debug, Clone)]
pub struct Tensors {
    origin: String,
    entries: BTreeMap<String, Tensor>,
}

impl Tensors {
    /// Tensors by name; `origin` is named in errors.
    #[must_use]
    pub fn new(origin: String, entries: BTreeMap<String, Tensor>) -> Self {
        Self { origin, entries }
    }

    /// Removes and returns a tensor of the given shape whose numbers are all finite.
    ///
    /// # Errors
    /// [`BuildError`] naming the tensor, if it is absent, has another shape or contains a number that is not
    /// finite.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, BuildError> {
        let item = |what: &str| format!("{what} of tensor `{name}` in {}", self.origin);
        let Some(Tensor { shape: found, values }) = self.entries.remove(name) else {
            let known = self.entries.keys();
            return Err(BuildError::unknown_name(format!("the card of {}", self.origin), name, known));
        };
        if found != shape || values.len() != shape.iter().product::<usize>() {
            let found = format!("{found:?} with {} numbers", values.len());
            return Err(BuildError::bad_value(item("shape"), found, format!("{shape:?}")));
        }
        if let Some((index, value)) = values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            return Err(BuildError::bad_value(item(&format!("entry {index}")), value, "a finite number"));
        }
        Ok(values)
    }

    /// Checks that every tensor has been taken.
    ///
    /// # Errors
    /// [`BuildError::Malformed`] naming the first tensor that was not taken.
    pub fn finish(self) -> Result<(), BuildError> {
        match self.entries.keys().next() {
            None => Ok(()),
            Some(name) => Err(BuildError::malformed(
                self.origin,
                format!("tensor `{name}` belongs to no layer of the architecture on the card"),
            )),
        }
    }
}
