//! From a TOML file to one resolved table.
//!
//! A table may name another file as its `base`: that file's table is read first, and the keys beside
//! `base` are laid over it, table by table. Paths start at the file that names them.
//!
//! ```toml
//! controller = { base = "../control/aero_aware.toml", momentum = { c0 = 60.0 } }
//! ```

use crate::read_text;
use flight_core::BuildError;
use serde_json::{Map, Value};
use std::path::Path;

/// How deep `base` files may refer to one another.
const MAX_DEPTH: usize = 16;

/// Keys whose value is a path, made absolute on reading.
const PATH_KEYS: [&str; 4] = ["robot", "path", "file", "card"];

/// Reads a TOML file and resolves every `base` and path in it. Keys are not judged here.
///
/// # Errors
/// [`BuildError`] naming the file that cannot be read or parsed, or that refers to itself.
pub fn resolve(path: &Path) -> Result<Value, BuildError> {
    read(path, "", 0)
}

/// The table of a file, which stands under the key `name`.
fn read(path: &Path, name: &str, depth: usize) -> Result<Value, BuildError> {
    if depth > MAX_DEPTH {
        return Err(BuildError::malformed(
            path.display().to_string(),
            format!("`base` files refer to one another more than {MAX_DEPTH} deep"),
        ));
    }
    let text = read_text(path)?;
    let table: Map<String, Value> =
        ::toml::from_str(&text).map_err(|error| BuildError::malformed(path.display().to_string(), error))?;
    let folder = path.parent().unwrap_or(Path::new(".")).to_owned();
    resolve_table(table, name, &folder, depth).map(Value::Object)
}

fn resolve_table(
    mut table: Map<String, Value>,
    name: &str,
    folder: &Path,
    depth: usize,
) -> Result<Map<String, Value>, BuildError> {
    let base = table.remove("base");
    for (key, value) in &mut table {
        match value {
            Value::Object(inner) => {
                *inner = resolve_table(std::mem::take(inner), key, folder, depth)?;
            }
            Value::String(text) if PATH_KEYS.contains(&key.as_str()) => {
                *text = absolute(&folder.join(&*text))?;
            }
            _ => {}
        }
    }
    let Some(base) = base else { return Ok(table) };
    let Value::String(file) = base else {
        return Err(BuildError::bad_value(
            format!("`base` in {}", folder.display()),
            base,
            "the path of a TOML file",
        ));
    };
    let Value::Object(mut merged) = read(&folder.join(file), name, depth + 1)? else { return Ok(table) };
    lay_over(&mut merged, name, table);
    Ok(merged)
}

/// Tables of several kinds, with the key that says which kind one is.
const KINDS: [(&str, &str); 4] =
    [("aero", "model"), ("jets", "dynamics"), ("wind", "profile"), ("fictitious_wind", "profile")];

/// Writes `over` onto `under`, both the table `name`; tables merge, everything else is replaced.
///
/// A table of another kind replaces the one below it: keys of that kind would not be understood.
fn lay_over(under: &mut Map<String, Value>, name: &str, over: Map<String, Value>) {
    let changes_kind = KINDS
        .iter()
        .filter(|(table, _)| *table == name)
        .any(|(_, key)| matches!((under.get(*key), over.get(*key)), (Some(a), Some(b)) if a != b));
    if changes_kind {
        under.clear();
    }
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Object(below)), Value::Object(above)) => lay_over(below, &key, above),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}

fn absolute(path: &Path) -> Result<String, BuildError> {
    let full =
        path.canonicalize().map_err(|source| BuildError::Unreadable { path: path.to_owned(), source })?;
    Ok(full.display().to_string())
}
