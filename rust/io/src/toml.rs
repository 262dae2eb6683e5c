//! Resolves a TOML file and its base files to one table.
//!
//! A table may name another file as its `base`: that file's table is read first, and the keys beside
//! `base` are laid over it, table by table. A key that may be absent is removed by `false`. Paths start at the file
//! that names them. In a table whose keys are names of the robot's parts, `base` is such a name unless its value is a
//! text.
//!
//! ```toml
//! controller = { base = "../control/observer.toml", momentum = { c0 = 60.0 }, engines = false }
//! ```

use crate::files::{absolute_path, read_text};
use crate::schema::{Node, Schema, join};
use flight_core::BuildError;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use std::path::Path;

/// Greatest depth of references between `base` files.
const MAX_DEPTH: usize = 16;
/// Greatest number of files of one configuration.
const MAX_FILES: usize = 256;

/// Reads a file of one kind with its base files.
///
/// # Errors
/// [`BuildError`] naming the file that cannot be read or parsed, or the key, its value and what was expected.
pub fn load<T: DeserializeOwned + JsonSchema>(path: &Path) -> Result<T, BuildError> {
    from_value(resolve(path, &Schema::of_type::<T>())?, &path.display().to_string())
}

/// Converts a resolved table to a typed configuration; `origin` is named in errors.
///
/// # Errors
/// [`BuildError::Malformed`] naming the key, its value and what was expected.
pub fn from_value<T: DeserializeOwned + JsonSchema>(value: Value, origin: &str) -> Result<T, BuildError> {
    Schema::of_type::<T>().check(&value, origin)?;
    serde_json::from_value(value).map_err(|error| BuildError::malformed(origin, error))
}

/// Converts the JSON text of a resolved table to a typed configuration; `origin` is named in errors.
///
/// # Errors
/// As [`from_value`], or naming the position at which the text is not JSON.
pub fn from_json<T: DeserializeOwned + JsonSchema>(text: &str, origin: &str) -> Result<T, BuildError> {
    from_value(serde_json::from_str(text).map_err(|error| BuildError::malformed(origin, error))?, origin)
}

/// Parses a TOML text; numbers that are not finite are refused.
///
/// # Errors
/// [`BuildError::Malformed`] naming `origin`, and the line or the key.
pub fn parse(text: &str, origin: &str) -> Result<Map<String, Value>, BuildError> {
    let table: ::toml::Table =
        ::toml::from_str(text).map_err(|error| BuildError::malformed(origin, error))?;
    json_table(table, "").map_err(|message| BuildError::malformed(origin, message))
}

fn json_table(table: ::toml::Table, key: &str) -> Result<Map<String, Value>, String> {
    table.into_iter().map(|(name, value)| Ok((name.clone(), json(value, &join(key, &name))?))).collect()
}

fn json(value: ::toml::Value, key: &str) -> Result<Value, String> {
    Ok(match value {
        ::toml::Value::Table(table) => Value::Object(json_table(table, key)?),
        ::toml::Value::Array(list) => {
            let items = list.into_iter().enumerate();
            Value::Array(items.map(|(i, item)| json(item, &format!("{key}[{i}]"))).collect::<Result<_, _>>()?)
        }
        ::toml::Value::Float(number) => match serde_json::Number::from_f64(number) {
            Some(number) => Value::Number(number),
            None => return Err(format!("`{key}` is {number}; expected a finite number")),
        },
        ::toml::Value::Integer(number) => number.into(),
        ::toml::Value::Boolean(flag) => flag.into(),
        ::toml::Value::String(text) => text.into(),
        ::toml::Value::Datetime(date) => return Err(format!("`{key}` is {date}; no key is a date")),
    })
}

/// Reads a TOML file and resolves every `base` and path in it, as declared by a schema. Keys are not checked.
///
/// # Errors
/// [`BuildError`] naming the file that cannot be read or parsed, or that refers to itself.
pub fn resolve(path: &Path, schema: &Schema) -> Result<Value, BuildError> {
    Reader { files: 0 }.read(path, Some(schema.root()), 0).map(|table| without_absent(table, schema))
}

/// As [`resolve`], for a table that is not in a file; its paths start at `folder`.
///
/// # Errors
/// As [`resolve`].
pub fn resolve_table(table: Map<String, Value>, folder: &Path, schema: &Schema) -> Result<Value, BuildError> {
    let resolved = Reader { files: 0 }.resolve_table(table, Some(schema.root()), folder, 0);
    resolved.map(|table| without_absent(table, schema))
}

/// A resolved table without the keys that are to be absent.
fn without_absent(mut table: Map<String, Value>, schema: &Schema) -> Value {
    drop_absent(&mut table, schema.root());
    Value::Object(table)
}

fn drop_absent(table: &mut Map<String, Value>, node: Node<'_>) {
    table.retain(|key, value| *value != false || !node.may_lack(key));
    for (key, value) in table {
        if let (Value::Object(inner), Some(node)) = (value, node.key(key)) {
            drop_absent(inner, node);
        }
    }
}

/// Reader of the files of one configuration.
struct Reader {
    files: usize,
}

impl Reader {
    fn read(
        &mut self,
        path: &Path,
        node: Option<Node<'_>>,
        depth: usize,
    ) -> Result<Map<String, Value>, BuildError> {
        let origin = path.display().to_string();
        if depth > MAX_DEPTH {
            let message = format!("`base` files refer to one another more than {MAX_DEPTH} deep");
            return Err(BuildError::malformed(origin, message));
        }
        self.files += 1;
        if self.files > MAX_FILES {
            return Err(BuildError::malformed(
                origin,
                format!("more than {MAX_FILES} `base` files are read"),
            ));
        }
        let table = parse(&read_text(path)?, &origin)?;
        self.resolve_table(table, node, path.parent().unwrap_or(Path::new(".")), depth)
    }

    fn resolve_table(
        &mut self,
        mut table: Map<String, Value>,
        node: Option<Node<'_>>,
        folder: &Path,
        depth: usize,
    ) -> Result<Map<String, Value>, BuildError> {
        let is_name = |base: &Value| !base.is_string() && node.is_some_and(Node::is_of_names);
        let base = if table.get("base").is_some_and(is_name) { None } else { table.remove("base") };
        for (key, value) in &mut table {
            let node = node.and_then(|node| node.key(key));
            match value {
                Value::Object(inner) => {
                    *inner = self.resolve_table(std::mem::take(inner), node, folder, depth)?;
                }
                Value::String(text) if node.is_some_and(Node::is_path) => {
                    *text = absolute_path(&folder.join(&*text))?.display().to_string();
                }
                _ => {}
            }
        }
        let Some(base) = base else { return Ok(table) };
        let Value::String(file) = base else {
            let item = format!("`base` in {}", folder.display());
            return Err(BuildError::bad_value(item, base, "the path of a TOML file"));
        };
        let mut merged = self.read(&folder.join(file), node, depth + 1)?;
        lay_over(&mut merged, table, node);
        Ok(merged)
    }
}

/// Merges `over` into `under`: tables are merged, other values are replaced.
///
/// A table with its own discriminant replaces the one below it, because keys of another alternative would be unknown.
fn lay_over(under: &mut Map<String, Value>, over: Map<String, Value>, node: Option<Node<'_>>) {
    let discriminant = node.and_then(Node::discriminant);
    let kinds = discriminant.map(|key| (under.get(key), over.get(key)));
    if matches!(kinds, Some((Some(below), Some(above))) if below != above) {
        under.clear();
    }
    for (key, value) in over {
        let node = node.and_then(|node| node.key(&key));
        match (under.get_mut(&key), value) {
            (Some(Value::Object(below)), Value::Object(above)) => lay_over(below, above, node),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}
