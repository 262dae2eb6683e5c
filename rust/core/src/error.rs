//! Errors of construction, and checks of numbers that return them.
//!
//! Every module refuses bad input when it is *built*, with an error that names the item, its value and what was
//! expected. A tick does not return these errors; it has a status.

use std::collections::BTreeMap;
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
    /// A key has a value that no table of its kind accepts.
    #[error("`{key}` is {value}; expected {expected}")]
    BadEntry {
        /// Full dotted key, e.g. `wind.velocity[1]`.
        key: String,
        /// The value as read.
        value: String,
        /// What is accepted.
        expected: String,
    },
    /// A key that its table does not have.
    #[error("unknown key `{key}`{} (known: {known})", suggest(suggestions))]
    UnknownKey {
        /// Full dotted key.
        key: String,
        /// Full keys that were probably meant.
        suggestions: Vec<String>,
        /// Comma-separated keys of the table.
        known: String,
    },
    /// A key that has no default is absent.
    #[error("`{key}` is missing")]
    MissingKey {
        /// Full dotted key.
        key: String,
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
    /// An error in a file.
    #[error("{file}: {reason}")]
    InFile {
        /// The file.
        file: String,
        /// The error.
        reason: Box<Self>,
    },
    /// An error with the circumstance in which it occurred.
    #[error("{context}: {reason}")]
    InContext {
        /// The circumstance, such as the keys that were to be set.
        context: String,
        /// The error.
        reason: Box<Self>,
    },
}

/// Parts of an error, as far as it has them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ErrorParts {
    /// File in which the error is.
    pub file: Option<String>,
    /// Key, or another name of the item.
    pub key: Option<String>,
    /// The value as read.
    pub value: Option<String>,
    /// What is accepted.
    pub expected: Option<String>,
    /// Keys that were probably meant.
    pub suggestions: Vec<String>,
}

fn suggest(keys: &[String]) -> String {
    if keys.is_empty() { String::new() } else { format!("; did you mean `{}`?", keys.join("` or `")) }
}

// Callers pass a number or an error that they do not use afterwards.
#[allow(clippy::needless_pass_by_value)]
impl BuildError {
    /// Shorthand for [`BuildError::BadValue`].
    pub fn bad_value(item: impl Into<String>, value: impl ToString, expected: impl Into<String>) -> Self {
        Self::BadValue { item: item.into(), value: value.to_string(), expected: expected.into() }
    }

    /// Shorthand for [`BuildError::BadEntry`].
    pub fn bad_entry(key: impl Into<String>, value: impl ToString, expected: impl Into<String>) -> Self {
        Self::BadEntry { key: key.into(), value: value.to_string(), expected: expected.into() }
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

    /// This error, in `file`.
    #[must_use]
    pub fn in_file(self, file: impl ToString) -> Self {
        Self::InFile { file: file.to_string(), reason: Box::new(self) }
    }

    /// This error, in a circumstance.
    #[must_use]
    pub fn in_context(self, context: impl Into<String>) -> Self {
        Self::InContext { context: context.into(), reason: Box::new(self) }
    }

    /// The parts of this error.
    #[must_use]
    pub fn parts(&self) -> ErrorParts {
        let none = ErrorParts::default;
        let some = |text: &String| Some(text.clone());
        match self {
            Self::BadValue { item: key, value, expected } | Self::BadEntry { key, value, expected } => {
                ErrorParts { key: some(key), value: some(value), expected: some(expected), ..none() }
            }
            Self::UnknownKey { key, suggestions, known } => ErrorParts {
                key: some(key),
                expected: Some(format!("one of {known}")),
                suggestions: suggestions.clone(),
                ..none()
            },
            Self::MissingKey { key } => ErrorParts { key: some(key), ..none() },
            Self::UnknownName { item, name, known } => ErrorParts {
                key: some(item),
                value: some(name),
                expected: Some(format!("one of {known}")),
                ..none()
            },
            Self::Unreadable { path, .. } => ErrorParts { file: Some(path.display().to_string()), ..none() },
            Self::Malformed { origin, .. } => ErrorParts { file: some(origin), ..none() },
            Self::InFile { file, reason } => {
                let parts = reason.parts();
                ErrorParts { file: parts.file.clone().or_else(|| some(file)), ..parts }
            }
            Self::InContext { reason, .. } => reason.parts(),
        }
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

/// Checks that a table has exactly one number for each of some names.
///
/// # Errors
/// [`BuildError`] naming the key.
pub fn check_values_by_name<'a>(
    table: &str,
    values: &BTreeMap<String, f64>,
    names: impl Iterator<Item = &'a str> + Clone,
) -> Result<(), BuildError> {
    for name in values.keys() {
        place_of(table, name, names.clone())?;
    }
    for name in names {
        if !values.contains_key(name) {
            return Err(BuildError::bad_value(format!("{table}.{name}"), "absent", "a number ≥ 0"));
        }
    }
    Ok(())
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
}
