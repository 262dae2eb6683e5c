//! Errors of construction, and the checks of numbers that return them.
//!
//! Every module refuses bad input when it is *built*, with an error that names the item, its value and what was
//! expected. Nothing in flight returns these: a tick has a status.

use std::path::PathBuf;
use thiserror::Error;

/// Something that was read or passed in cannot be used.
#[derive(Debug, Error)]
pub enum BuildError {
    /// A value is outside what is physically or numerically meaningful.
    #[error("{item} is {value}; expected {expected}")]
    BadValue {
        /// Full name of the offending item, e.g. ``mass of link `chest` ``.
        item: String,
        /// The value as it was read.
        value: String,
        /// What would have been accepted.
        expected: String,
    },
    /// A name is not one of those that exist.
    #[error("{item} names `{name}`, which does not exist; known: {known}")]
    UnknownName {
        /// The item that holds the reference.
        item: String,
        /// The unknown name.
        name: String,
        /// Comma-separated names that exist.
        known: String,
    },
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// A file or text does not parse, or has unknown or missing keys.
    #[error("{origin}: {message}")]
    Malformed {
        /// File or section the text came from.
        origin: String,
        /// The parser's message, with line or key.
        message: String,
    },
}

// Callers hand over a number or an error they have no further use for.
#[allow(clippy::needless_pass_by_value)]
impl BuildError {
    /// Shorthand for [`BuildError::BadValue`].
    pub fn bad_value(item: impl Into<String>, value: impl ToString, expected: impl Into<String>) -> Self {
        Self::BadValue { item: item.into(), value: value.to_string(), expected: expected.into() }
    }

    /// Shorthand for [`BuildError::UnknownName`].
    pub fn unknown_name<S: AsRef<str>>(
        item: impl Into<String>,
        name: impl Into<String>,
        known: impl IntoIterator<Item = S>,
    ) -> Self {
        let known: Vec<String> = known.into_iter().map(|k| k.as_ref().to_owned()).collect();
        Self::UnknownName { item: item.into(), name: name.into(), known: known.join(", ") }
    }

    /// Shorthand for [`BuildError::Malformed`].
    pub fn malformed(origin: impl Into<String>, message: impl ToString) -> Self {
        Self::Malformed { origin: origin.into(), message: message.to_string() }
    }
}

/// Refuses a value that is not finite or not accepted by `accept`.
///
/// # Errors
/// [`BuildError::BadValue`] naming `item` and `expected`.
pub fn check(
    item: &str,
    value: f64,
    accept: impl Fn(f64) -> bool,
    expected: &str,
) -> Result<f64, BuildError> {
    if value.is_finite() && accept(value) {
        Ok(value)
    } else {
        Err(BuildError::bad_value(item, value, expected))
    }
}

/// Place of a name among those that are known.
///
/// # Errors
/// [`BuildError::UnknownName`] naming `item`.
pub fn place_of<S: AsRef<str>>(
    item: impl Into<String>,
    name: &str,
    known: impl IntoIterator<Item = S> + Clone,
) -> Result<usize, BuildError> {
    let place = known.clone().into_iter().position(|known| known.as_ref() == name);
    place.ok_or_else(|| BuildError::unknown_name(item, name, known))
}

/// A table of a configuration, by its full name: checks of its numbers, which errors name by their keys.
#[derive(Debug, Clone, Copy)]
pub struct Table<'a>(pub &'a str);

impl Table<'_> {
    /// As [`check`], for the number of a key.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key and `expected`.
    pub fn check(
        self,
        key: &str,
        value: f64,
        accept: impl Fn(f64) -> bool,
        expected: &str,
    ) -> Result<(), BuildError> {
        check(&format!("{}.{key}", self.0), value, accept, expected).map(|_| ())
    }

    /// Refuses a number that is not positive and finite.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn positive(self, key: &str, value: f64) -> Result<(), BuildError> {
        self.check(key, value, |x| x > 0.0, "a positive number")
    }

    /// Refuses a gain \[1/s\] that is negative, or so high that a single tick of `time_step` \[s\] decides.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn gain(self, key: &str, gain: f64, time_step: f64) -> Result<(), BuildError> {
        let greatest = 1.0 / time_step;
        let expected = format!("a number from 0 to {greatest}, 1 / time step of {time_step} s");
        self.check(key, gain, |gain| (0.0..=greatest * (1.0 + 1e-9)).contains(&gain), &expected)
    }

    /// Refuses a number that is negative or not finite.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn non_negative(self, key: &str, value: f64) -> Result<(), BuildError> {
        self.check(key, value, |x| x >= 0.0, "a number ≥ 0")
    }
}
