//! Errors of construction, and checks of numbers that return them.
//!
//! Every module refuses bad input when it is *built*, with an error that names the item, its value and what was
//! expected. A tick does not return these errors; it has a status.

use std::path::PathBuf;
use thiserror::Error;

/// Reason why something that was read or passed in cannot be used.
#[derive(Debug, Error)]
pub enum BuildError {
    /// A value is physically or numerically invalid.
    #[error("{item} is {value}; expected {expected}")]
    BadValue {
        /// Full name of the item, e.g. ``mass of link `chest` ``.
        item: String,
        /// The value as read.
        value: String,
        /// What is accepted.
        expected: String,
    },
    /// A name that does not exist.
    #[error("{item} names `{name}`, which does not exist; known: {known}")]
    UnknownName {
        /// The item that contains the name.
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
    /// A file or text cannot be parsed, or has unknown or missing keys.
    #[error("{origin}: {message}")]
    Malformed {
        /// File or section from which the text was read.
        origin: String,
        /// The parser's message, with line or key.
        message: String,
    },
}

// Callers pass a number or an error that they do not use afterwards.
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

/// Checks that a value is finite and accepted by `accept`.
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

/// Index of a name in the list of known names.
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

/// Checks of the numbers in one table of a configuration; errors name table and key.
#[derive(Debug, Clone, Copy)]
pub struct Table<'a>(pub &'a str);

impl Table<'_> {
    /// As [`check`], for the value of a key.
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

    /// Checks that a number is positive and finite.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check_positive(self, key: &str, value: f64) -> Result<(), BuildError> {
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
    pub fn check_non_negative(self, key: &str, value: f64) -> Result<(), BuildError> {
        self.check(key, value, |x| x >= 0.0, "a number ≥ 0")
    }
}
