//! Reads all files: from memory if held there, otherwise from the disk.
//!
//! A program without a disk (a web page) holds every file it needs under a relative path.

use flight_core::BuildError;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

/// Greatest length of a file \[bytes\].
const MAX_LENGTH: u64 = 64 * 1024 * 1024;

static HELD: RwLock<BTreeMap<PathBuf, Arc<[u8]>>> = RwLock::new(BTreeMap::new());

/// Holds a file in memory until the program ends; it takes precedence over one on the disk.
pub fn hold(path: &Path, bytes: Vec<u8>) {
    HELD.write().unwrap_or_else(PoisonError::into_inner).insert(normalise(path), bytes.into());
}

fn find_held(path: &Path) -> Option<Arc<[u8]>> {
    HELD.read().unwrap_or_else(PoisonError::into_inner).get(&normalise(path)).cloned()
}

/// Returns the bytes of a regular file.
///
/// # Errors
/// [`BuildError`] naming the file, also for a device, a pipe, or a file of more than 64 MiB.
pub fn read_bytes(path: &Path) -> Result<Arc<[u8]>, BuildError> {
    if let Some(bytes) = find_held(path) {
        return Ok(bytes);
    }
    check_text(path)?;
    let metadata = std::fs::metadata(path).map_err(|source| read_error(path, source))?;
    if !metadata.is_file() || metadata.len() > MAX_LENGTH {
        let message = format!("expected a regular file of at most {MAX_LENGTH} bytes");
        return Err(BuildError::malformed(path.display().to_string(), message));
    }
    std::fs::read(path).map(Arc::from).map_err(|source| read_error(path, source))
}

/// Returns the text of a file, as [`read_bytes`].
///
/// # Errors
/// [`BuildError`] naming the file, also if it is not UTF-8.
pub fn read_text(path: &Path) -> Result<String, BuildError> {
    let bytes = read_bytes(path)?;
    let text = decode(&bytes).map_err(|error| BuildError::malformed(path.display().to_string(), error))?;
    Ok(text.into_owned())
}

/// Decodes text in UTF-8, or in UTF-16 with the byte-order mark that programs of Windows write before it.
///
/// # Errors
/// What is no such text.
pub fn decode(bytes: &[u8]) -> Result<Cow<'_, str>, String> {
    let utf16 = |bytes: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = bytes.as_chunks().0.iter().copied().map(unit).collect();
        String::from_utf16(&units).map(Cow::Owned).map_err(|error| error.to_string())
    };
    match bytes {
        [0xFF, 0xFE, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xFE, 0xFF, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => std::str::from_utf8(bytes).map(Cow::Borrowed).map_err(|error| error.to_string()),
    }
}

/// Whether a path leads to anything.
pub(crate) fn exists(path: &Path) -> bool {
    find_held(path).is_some() || path.exists()
}

/// Canonical path, which identifies a file wherever it is named.
///
/// # Errors
/// [`BuildError`] naming a file that does not exist.
pub(crate) fn absolute_path(path: &Path) -> Result<PathBuf, BuildError> {
    if find_held(path).is_some() {
        return Ok(normalise(path));
    }
    let path = path.canonicalize().map_err(|source| read_error(path, source))?;
    check_text(&path).map(|()| path)
}

/// Refuses a path that no configuration, a text in UTF-8, can name.
fn check_text(path: &Path) -> Result<(), BuildError> {
    let expected = "its name, or that of a folder of it, is not UTF-8; expected one that is, as a configuration names it";
    path.to_str().map(|_| ()).ok_or_else(|| BuildError::malformed(path.display().to_string(), expected))
}

fn read_error(path: &Path, source: std::io::Error) -> BuildError {
    BuildError::Unreadable { path: path.to_owned(), source }
}

/// A path without `.` and `..`.
fn normalise(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if matches!(out.components().next_back(), Some(Component::Normal(_))) => {
                out.pop();
            }
            part => out.push(part),
        }
    }
    out
}
