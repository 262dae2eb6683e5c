//! Resolves a TOML file and its base files to one table.
//!
//! A table may name another file as its `base`: that file's table is read first, and the keys beside
//! `base` are laid over it, table by table. A key that may be absent is removed by `false`. In a table whose keys are
//! names of the robot's parts, `base` is such a name unless its value is a text; in one that has a key `base` of its own,
//! it is that.
//!
//! Paths start at the file that names them. Where that leads nowhere, they start at the folder of the shipped files of this
//! kind, if the program has one: a file reads there as if it stood among them. `base = "test2"` is `test2.toml`.
//!
//! ```toml
//! controller = { base = "../control/observer.toml", momentum = { c0 = 60.0 }, engines = false }
//! ```
//!
//! A program changes a resolved table by [`set_keys`], under the same rules.

mod order;

use crate::files::{absolute_path, exists, read_text};
use flight_core::BuildError;
use flight_core::schema::{Node, Schema, join, refusal, shorten};
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use std::borrow::Cow;
use std::path::{Path, PathBuf};

pub use order::to_json;

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

/// As [`load`], with the folder of the `shipped` files of this kind, after setting `changes` of dotted keys, which
/// [`set_keys`] describes; `check` checks the whole.
///
/// # Errors
/// As [`load`], or naming the keys that cannot be set.
pub fn load_changed<T: Serialize + DeserializeOwned + JsonSchema>(
    path: &Path,
    shipped: Option<&Path>,
    changes: &[(String, Value)],
    mut check: impl FnMut(&T) -> Result<(), BuildError>,
) -> Result<T, BuildError> {
    let checked = |table| typed(table).and_then(|config| check(&config).map(|()| config));
    let schema = Schema::of_type::<T>();
    changed(path, &resolve_beside(path, shipped, &schema)?, changes, &schema, checked)
}

/// As [`load_changed`], for a table whose type only its schema states.
///
/// # Errors
/// As [`load_changed`].
pub fn load_by(path: &Path, changes: &[(String, Value)], schema: &Schema) -> Result<Value, BuildError> {
    let table = resolve(path, schema)?;
    changed(path, &table, changes, schema, |table| schema.check(&table).map(|()| table))
}

/// The `table` that was read from a file, with changes.
fn changed<T: Serialize>(
    path: &Path,
    table: &Value,
    changes: &[(String, Value)],
    schema: &Schema,
    mut checked: impl FnMut(Value) -> Result<T, BuildError>,
) -> Result<T, BuildError> {
    let of_file = |error: BuildError| error.in_file(path.display());
    let mut changed = |changes: &[(String, Value)]| {
        set_keys(table.clone(), changes.iter().cloned(), Path::new(""), schema).and_then(&mut checked)
    };
    changed(changes).map_err(|error| match changed(&[]) {
        Err(without_changes) => of_file(without_changes),
        Ok(config) => {
            // One change may be to blame by itself.
            let mut alone = changes.iter().map(std::slice::from_ref);
            let culprit = alone.find_map(|change| changed(change).err().map(|error| (error, change)));
            let (error, changes) = culprit.unwrap_or((error, changes));
            of_changes(error, changes, &config, schema)
        }
    })
}

/// An error of changed keys: what was probably meant by an unknown one, or else what was to be set.
fn of_changes(
    error: BuildError,
    changes: &[(String, Value)],
    config: &impl Serialize,
    schema: &Schema,
) -> BuildError {
    if let Some(error) = changes.iter().find_map(|change| of_kind(&error, change, schema)) {
        return error;
    }
    if let BuildError::UnknownKey { key, suggestions, known } = &error {
        let is_in_it =
            |(changed, _): &&(String, Value)| format!("{changed}.").starts_with(&format!("{key}."));
        if let Some((changed, _)) = changes.iter().find(is_in_it) {
            let suggestions = if suggestions.is_empty() {
                keys_like(changed, &json!(config))
            } else {
                suggestions.iter().map(|near| near.clone() + &changed[key.len()..]).collect()
            };
            return BuildError::UnknownKey { key: changed.clone(), suggestions, known: known.clone() };
        }
    }
    let key = error.parts().key;
    if changes.iter().any(|(changed, _)| Some(changed) == key.as_ref()) {
        return error; // which names key and value
    }
    let listed = changes.iter().map(|(key, value)| format!("`{key}` = {}", shorten(value)));
    error.in_context(format!("cannot set {}", listed.collect::<Vec<_>>().join(", ")))
}

/// The error of a change that makes a table one of another kind, which has other keys.
fn of_kind(error: &BuildError, (key, value): &(String, Value), schema: &Schema) -> Option<BuildError> {
    let (BuildError::UnknownKey { key: bad, .. } | BuildError::MissingKey { key: bad }) = error else {
        return None;
    };
    let (table, discriminant) = key.rsplit_once('.')?;
    let node = table.split('.').try_fold(schema.root(), Node::key)?;
    let keys = node.keys_of_kind(discriminant, value).filter(|_| bad.starts_with(&format!("{table}.")))?;
    let expected = format!(
        "the whole table, since it has other keys: {table}={{{discriminant}={value}, …}} with {}",
        keys.join(", ")
    );
    Some(BuildError::BadEntry { key: key.clone(), value: shorten(value), expected })
}

/// Up to three dotted keys of a table whose last part is that of `key`.
fn keys_like(key: &str, table: &Value) -> Vec<String> {
    let last = key.rsplit('.').next();
    let mut found = Vec::new();
    visit(table, None, "", &mut |place, _, _| {
        if place.rsplit('.').next() == last && found.len() < 3 {
            found.push(place.to_owned());
        }
    });
    found
}

/// Calls `see` with key, value and node of everything in a table.
fn visit<'a>(
    value: &Value,
    node: Option<Node<'a>>,
    key: &str,
    see: &mut impl FnMut(&str, &Value, Option<Node<'a>>),
) {
    see(key, value, node);
    for (name, value) in value.as_object().into_iter().flatten() {
        visit(value, node.and_then(|node| node.key(name)), &join(key, name), see);
    }
}

/// Converts a resolved table to a typed configuration; `origin` is named in errors.
///
/// # Errors
/// [`BuildError`] naming `origin`, the key, its value and what was expected.
pub fn from_value<T: DeserializeOwned + JsonSchema>(value: Value, origin: &str) -> Result<T, BuildError> {
    typed(value).map_err(|error| error.in_file(origin))
}

/// Converts a resolved table to a typed configuration.
///
/// # Errors
/// [`BuildError`] naming the key, its value and what was expected.
pub fn typed<T: DeserializeOwned + JsonSchema>(value: Value) -> Result<T, BuildError> {
    Schema::of_type::<T>().check(&value)?;
    serde_json::from_value(value).map_err(|error| BuildError::malformed("the table", error))
}

/// Converts the JSON text of a resolved table to a typed configuration; `origin` is named in errors.
///
/// # Errors
/// As [`typed`], or naming the position at which the text is not JSON.
pub fn from_json<T: DeserializeOwned + JsonSchema>(text: &str, origin: &str) -> Result<T, BuildError> {
    let value = serde_json::from_str(text).map_err(|error| BuildError::malformed(origin, error))?;
    typed(value).map_err(|error| error.in_context(origin))
}

/// Parses a TOML text; numbers that are not finite are refused.
///
/// # Errors
/// [`BuildError`] naming `origin`, and the line or the key.
pub fn parse(text: &str, origin: &str) -> Result<Map<String, Value>, BuildError> {
    let table: ::toml::Table =
        ::toml::from_str(text).map_err(|error| BuildError::malformed(origin, in_one_line(&error, text)))?;
    json_table(table, "").map_err(|error| error.in_file(origin))
}

/// A parser's error, with its place, without the line of the text, which may be long.
fn in_one_line(error: &::toml::de::Error, text: &str) -> String {
    let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
    let (line, column) =
        (before.split('\n').count(), before.chars().rev().take_while(|c| *c != '\n').count() + 1);
    format!("no TOML at line {line}, column {column}: {}", error.message().replace('\n', ", "))
}

fn json_table(table: ::toml::Table, key: &str) -> Result<Map<String, Value>, BuildError> {
    table.into_iter().map(|(name, value)| Ok((name.clone(), json(value, &join(key, &name))?))).collect()
}

fn json(value: ::toml::Value, key: &str) -> Result<Value, BuildError> {
    let refuse = |value: String, expected: &str| {
        Err(BuildError::BadEntry { key: key.to_owned(), value, expected: expected.to_owned() })
    };
    Ok(match value {
        ::toml::Value::Table(table) => Value::Object(json_table(table, key)?),
        ::toml::Value::Array(list) => {
            let items = list.into_iter().enumerate();
            Value::Array(items.map(|(i, item)| json(item, &format!("{key}[{i}]"))).collect::<Result<_, _>>()?)
        }
        ::toml::Value::Float(number) => match serde_json::Number::from_f64(number) {
            Some(number) => Value::Number(number),
            None => return refuse(number.to_string(), "a finite number"),
        },
        ::toml::Value::Integer(number) => number.into(),
        ::toml::Value::Boolean(flag) => flag.into(),
        ::toml::Value::String(text) => text.into(),
        ::toml::Value::Datetime(date) => {
            return refuse(date.to_string(), "a number, text, list or table, as no key is a date");
        }
    })
}

/// Reads a TOML file and resolves every `base` and path in it, as declared by a schema. Keys are not checked.
///
/// # Errors
/// [`BuildError`] naming the file that cannot be read or parsed, or that refers to itself, or the key whose file is not
/// there.
pub fn resolve(path: &Path, schema: &Schema) -> Result<Value, BuildError> {
    resolve_beside(path, None, schema)
}

/// As [`resolve`], with the folder of the `shipped` files of this kind.
fn resolve_beside(path: &Path, shipped: Option<&Path>, schema: &Schema) -> Result<Value, BuildError> {
    let table = Reader { files: 0, shipped }.read(path, Some(schema.root()), "", 0);
    table.map(|table| without_absent(table, schema))
}

/// As [`resolve`], for a table that is not in a file; its paths start at `folder`.
///
/// # Errors
/// As [`resolve`].
pub fn resolve_table(table: Map<String, Value>, folder: &Path, schema: &Schema) -> Result<Value, BuildError> {
    let resolved = Reader::default().resolve_table(table, Some(schema.root()), "", folder, 0);
    resolved.map(|table| without_absent(table, schema))
}

/// Sets dotted keys of a resolved table, in order: paths and base files in values start at `folder`, `false` removes
/// a key that may be absent, and a number in a key is an index into a list. Keys are not checked.
///
/// # Errors
/// As [`resolve`], or [`BuildError`] naming the part of a key that is no table.
pub fn set_keys(
    table: Value,
    changes: impl IntoIterator<Item = (String, Value)>,
    folder: &Path,
    schema: &Schema,
) -> Result<Value, BuildError> {
    let mut changed = table;
    for (key, mut value) in changes {
        let (mut place, mut node, mut parent) = (&mut changed, Some(schema.root()), String::new());
        for part in key.split('.') {
            if place.is_object() {
                node = node.and_then(|node| node.key(part));
                place = &mut place[part]; // inserts a key that is absent
            } else {
                node = node.and_then(Node::item);
                let shown = refusal(&parent, place, &format!("a table or list that has `{part}`"));
                let index = part.parse::<usize>().ok();
                place = index.and_then(move |index| place.get_mut(index)).ok_or(shown)?;
            }
            if place.is_null() {
                *place = Map::new().into();
            }
            parent = join(&parent, part);
        }
        Reader::default().resolve_value(&mut value, node, &key, folder, 0)?;
        *place = value;
    }
    if let Value::Object(table) = &mut changed {
        drop_absent(table, schema.root());
    }
    Ok(changed)
}

/// Dotted keys of all paths in a resolved table.
#[must_use]
pub fn path_keys(table: &Value, schema: &Schema) -> Vec<String> {
    let mut found = Vec::new();
    visit(table, Some(schema.root()), "", &mut |key, value, node| {
        if value.is_string() && node.is_some_and(Node::is_path) {
            found.push(key.to_owned());
        }
    });
    found
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
#[derive(Default)]
struct Reader<'s> {
    files: usize,
    /// Folder in which files are looked for that are not where the file that names them says.
    shipped: Option<&'s Path>,
}

impl Reader<'_> {
    fn read(
        &mut self,
        path: &Path,
        node: Option<Node<'_>>,
        key: &str,
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
        let resolved = self.resolve_table(table, node, key, path.parent().unwrap_or(Path::new(".")), depth);
        resolved.map_err(|error| match error {
            // That of a base file names it already.
            BuildError::BadEntry { .. } => error.in_file(origin),
            _ => error,
        })
    }

    fn resolve_value(
        &mut self,
        value: &mut Value,
        node: Option<Node<'_>>,
        key: &str,
        folder: &Path,
        depth: usize,
    ) -> Result<(), BuildError> {
        match value {
            Value::Object(table) => {
                *table = self.resolve_table(std::mem::take(table), node, key, folder, depth)?;
            }
            Value::String(text) if node.is_some_and(Node::is_path) => {
                *text = absolute_path(&self.find(text, key, folder)?)?.display().to_string();
            }
            Value::Array(list) => {
                let item = node.and_then(Node::item);
                for (index, value) in list.iter_mut().enumerate() {
                    self.resolve_value(value, item, &format!("{key}[{index}]"), folder, depth)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn resolve_table(
        &mut self,
        mut table: Map<String, Value>,
        node: Option<Node<'_>>,
        key: &str,
        folder: &Path,
        depth: usize,
    ) -> Result<Map<String, Value>, BuildError> {
        let is_key = |base: &Value| {
            node.is_some_and(|node| node.has("base") || !base.is_string() && node.is_of_names())
        };
        let base = if table.get("base").is_some_and(is_key) { None } else { table.remove("base") };
        for (name, value) in &mut table {
            self.resolve_value(value, node.and_then(|node| node.key(name)), &join(key, name), folder, depth)?;
        }
        let Some(base) = base else { return Ok(table) };
        let Value::String(file) = base else {
            let expected = "the path of a TOML file";
            return Err(refusal(&join(key, "base"), &base, expected));
        };
        let is_path = file.contains('/')
            || Path::new(&file).extension().is_some_and(|end| end.eq_ignore_ascii_case("toml"));
        let file = if is_path { Cow::Borrowed(&file) } else { Cow::Owned(format!("{file}.toml")) };
        let base = self.find(&file, &join(key, "base"), folder)?;
        let mut merged = self.read(&base, node, key, depth + 1)?;
        lay_over(&mut merged, table, node);
        Ok(merged)
    }

    /// The file that a path leads to from a folder or, where that is nowhere, from that of the shipped files.
    fn find(&self, file: &str, key: &str, folder: &Path) -> Result<PathBuf, BuildError> {
        let folders = [folder].into_iter().chain(self.shipped);
        let mut tried: Vec<_> = folders.map(|folder| folder.join(file)).collect();
        tried.dedup();
        if let Some(place) = tried.iter().position(|path| exists(path)) {
            return Ok(tried.swap_remove(place));
        }
        let where_from = |path: &Path| if path.is_relative() { " in the current folder" } else { "" };
        let place = |path: &PathBuf| format!("no {}{}", path.display(), where_from(path));
        let places: Vec<_> = tried.iter().map(place).collect();
        let expected = format!("the path of a file that exists; there is {}", places.join(", and "));
        Err(refusal(key, &file.into(), &expected))
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
