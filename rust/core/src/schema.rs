//! JSON Schemas of the configuration, derived from its types, and validation against them.
//!
//! The types are the only definition of a configuration: editors complete keys from the schema, the reference pages
//! are generated from it, and [`Schema::check`] names full key, value and expectation of everything that does not
//! match. `format = "path"` marks files. The property that is constant in each alternative determines the
//! alternative of a table.

use crate::error::BuildError;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Schemas of types, each derived once: that takes as long as reading a configuration.
static DERIVED: Mutex<BTreeMap<Cow<'static, str>, Arc<Value>>> = Mutex::new(BTreeMap::new());

/// Greatest magnitude of any number of a file: all SI values of a flight are smaller, and its fourth power, which occurs in
/// the certificate of a QP, does not overflow.
const LARGEST: f64 = 1e9;

/// Keys that are taken for one another.
const SYNONYMS: [&[&str]; 3] =
    [&["velocity", "speed", "direction"], &["time", "start"], &["duration", "end", "length"]];

/// Schema of one kind of file.
#[derive(Debug, Clone)]
pub struct Schema {
    root: Arc<Value>,
}

/// A node of a schema, with references resolved.
#[derive(Debug, Clone, Copy)]
pub struct Node<'a> {
    root: &'a Value,
    here: &'a Value,
    /// Greatest magnitude of any number.
    largest: f64,
}

impl Schema {
    /// Schema of a type.
    #[must_use]
    pub fn of_type<T: JsonSchema>() -> Self {
        let mut derived = DERIVED.lock().unwrap_or_else(PoisonError::into_inner);
        let root =
            derived.entry(T::schema_id()).or_insert_with(|| Arc::new(schemars::schema_for!(T).to_value()));
        Self { root: Arc::clone(root) }
    }

    /// A schema of types that only a program beside the crate has, in the form of [`Self::json`].
    #[must_use]
    pub fn of_json(root: Value) -> Self {
        Self { root: Arc::new(root) }
    }

    /// Schema as JSON.
    #[must_use]
    pub fn json(&self) -> &Value {
        &self.root
    }

    /// Its first node.
    #[must_use]
    pub fn root(&self) -> Node<'_> {
        Node { root: &self.root, here: &self.root, largest: LARGEST }.follow()
    }

    /// Checks that a value matches the schema.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected.
    pub fn check(&self, value: &Value) -> Result<(), BuildError> {
        self.root().check(value, "")
    }
}

impl<'a> Node<'a> {
    /// Resolves references, and removes `null` beside one alternative.
    fn follow(self) -> Self {
        let at = |node| Self { here: node, ..self }.follow();
        if let Some(target) = self.here.get("$ref").and_then(Value::as_str) {
            return self.root.pointer(target.trim_start_matches('#')).map_or(self, at);
        }
        let mut options = self.options();
        match (options.next(), options.next()) {
            (Some(only), None) => at(only),
            _ => self,
        }
    }

    /// Alternatives of `anyOf`, except `null`.
    fn options(self) -> impl Iterator<Item = &'a Value> {
        let options = self.here.get("anyOf").and_then(Value::as_array).into_iter().flatten();
        options.filter(|option| option.get("type").is_none_or(|kind| kind != "null"))
    }

    fn alternatives(self) -> impl Iterator<Item = Self> + Clone {
        let options = self.here.get("oneOf").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let alone = if options.is_empty() { std::slice::from_ref(self.here) } else { options };
        alone.iter().map(move |node| Self { here: node, ..self }.follow())
    }

    fn properties(self) -> Option<&'a Map<String, Value>> {
        self.here.get("properties").and_then(Value::as_object)
    }

    /// Whether a table here has this key.
    #[must_use]
    pub fn has(self, key: &str) -> bool {
        self.alternatives().filter_map(Self::properties).any(|properties| properties.contains_key(key))
    }

    /// Node of a key of this table, in whichever alternative has it.
    #[must_use]
    pub fn key(self, key: &str) -> Option<Self> {
        self.alternatives().find_map(|option| {
            let named = option.properties().and_then(|properties| properties.get(key));
            named.or_else(|| option.others()).map(|node| Self { here: node, ..self }.follow())
        })
    }

    /// Whether a key of this table may be absent and has no default.
    #[must_use]
    pub fn may_lack(self, key: &str) -> bool {
        let is_null = |node: &Value| node == "null" || node["type"] == "null";
        self.alternatives().filter_map(|option| option.properties()?.get(key)).any(|node| {
            let lists = ["type", "anyOf"].into_iter().filter_map(|list| node.get(list)?.as_array());
            lists.flatten().any(is_null)
        })
    }

    /// Whether the keys of the table here are names that the schema does not know.
    #[must_use]
    pub fn is_of_names(self) -> bool {
        self.others().is_some()
    }

    /// Schema of keys that this table does not name; of any, if it says nothing about keys.
    fn others(self) -> Option<&'a Value> {
        static ANY: Value = Value::Bool(true);
        let silent =
            self.properties().is_none() && self.here.get("type").is_some_and(|kind| kind == "object");
        let others = self.here.get("additionalProperties").or(silent.then_some(&ANY));
        others.filter(|others| **others != false)
    }

    /// Node of the items of this list, which have one type.
    #[must_use]
    pub fn item(self) -> Option<Self> {
        let of_tuple = || self.here.get("prefixItems").and_then(|items| items.get(0));
        let items = self.here.get("items").filter(|items| **items != false);
        items.or_else(of_tuple).map(|node| Self { here: node, ..self }.follow())
    }

    /// Whether a text here is a path.
    #[must_use]
    pub fn is_path(self) -> bool {
        self.here.get("format").is_some_and(|format| format == "path")
    }

    /// Key that determines the alternative of a table, if there are several.
    #[must_use]
    pub fn discriminant(self) -> Option<&'a str> {
        let first = self.alternatives().next()?.properties()?;
        self.here.get("oneOf")?;
        first.iter().find(|(_, schema)| schema.get("const").is_some()).map(|(key, _)| key.as_str())
    }

    /// Keys of the alternative with this discriminant, those first that have no default.
    #[must_use]
    pub fn keys_of_kind(self, discriminant: &str, kind: &Value) -> Option<Vec<&'a str>> {
        let is_it = |option: &Self| {
            option.properties().is_some_and(|keys| {
                keys.get(discriminant).is_some_and(|node| node.get("const") == Some(kind))
            })
        };
        let option =
            (self.discriminant() == Some(discriminant)).then(|| self.alternatives().find(is_it))??;
        let required = option.here.get("required").and_then(Value::as_array);
        let is_required = |key: &&str| required.is_some_and(|names| names.iter().any(|name| name == *key));
        let keys = option.properties()?.keys().map(String::as_str).filter(|key| *key != discriminant);
        let (first, rest): (Vec<_>, Vec<_>) = keys.partition(is_required);
        Some([first, rest].concat())
    }

    fn check(self, value: &Value, key: &str) -> Result<(), BuildError> {
        let tried = self.options().map(|node| Self { here: node, ..self }.follow().check(value, key));
        if let Some(found) = tried.reduce(Result::or) {
            return found;
        }
        match self.discriminant() {
            Some(discriminant) => self.choose(discriminant, value, key)?.check_plain(value, key),
            None => self.check_plain(value, key),
        }
    }

    /// Alternative to which a table belongs.
    fn choose(self, discriminant: &str, value: &Value, key: &str) -> Result<Self, BuildError> {
        let Some(table) = value.as_object() else { return Err(refusal(key, value, "a table")) };
        let place = join(key, discriminant);
        let kind = table.get(discriminant).ok_or_else(|| missing(&place))?;
        let constant = |option: &Self| option.properties()?.get(discriminant)?.get("const");
        self.alternatives().find(|option| constant(option) == Some(kind)).ok_or_else(|| {
            let known: Vec<_> =
                self.alternatives().filter_map(|option| constant(&option)).map(show).collect();
            refusal(&place, kind, &format!("one of {}", known.join(", ")))
        })
    }

    fn check_plain(self, value: &Value, key: &str) -> Result<(), BuildError> {
        let names = self.names();
        if names.contains(&value) {
            return Ok(());
        }
        if !names.is_empty() {
            let known: Vec<_> = names.into_iter().map(show).collect();
            return Err(refusal(key, value, &format!("one of {}", known.join(", "))));
        }
        let kinds: Vec<&str> = match self.here.get("type") {
            Some(Value::String(kind)) => vec![kind],
            Some(Value::Array(kinds)) => kinds.iter().filter_map(Value::as_str).collect(),
            _ => return Ok(()),
        };
        let matches = |kind: &&str| match *kind {
            "object" => value.is_object(),
            "array" => value.is_array(),
            "string" => value.is_string(),
            "boolean" => value.is_boolean(),
            "integer" => value.is_i64() || value.is_u64(),
            "number" => value.is_number(),
            _ => false, // `null` beside another type: a key without value is omitted
        };
        if !kinds.iter().any(matches) {
            return Err(refusal(key, value, &self.expectation(kinds[0])));
        }
        match value {
            Value::Object(table) => self.check_table(table, key),
            Value::Array(list) => self.check_list(list, value, key),
            Value::Number(number) => {
                let limit = |name: &str| self.here.get(name).and_then(Value::as_f64);
                let x = number.as_f64().unwrap_or(f64::NAN);
                let accepted = limit("minimum").is_none_or(|limit| x >= limit)
                    && limit("exclusiveMinimum").is_none_or(|limit| x > limit)
                    && limit("maximum").is_none_or(|limit| x <= limit)
                    && limit("exclusiveMaximum").is_none_or(|limit| x < limit);
                if !accepted {
                    Err(refusal(key, value, &self.expectation(kinds[0])))
                } else if kinds[0] == "number" && x.abs() > self.largest {
                    Err(refusal(key, value, "a number from -1e9 to 1e9"))
                } else {
                    Ok(())
                }
            }
            _ => Ok(()),
        }
    }

    /// The allowed texts, if only these are allowed.
    fn names(self) -> Vec<&'a Value> {
        match self.here.get("enum").and_then(Value::as_array) {
            Some(names) => names.iter().collect(),
            None => self.alternatives().filter_map(|option| option.here.get("const")).collect(),
        }
    }

    fn check_table(self, table: &Map<String, Value>, key: &str) -> Result<(), BuildError> {
        let none = Map::new();
        let properties = self.properties().unwrap_or(&none);
        for (name, value) in table {
            let place = join(key, name);
            match self.key(name) {
                _ if value.is_null() && self.may_lack(name) => {}
                Some(node) => node.check(value, &place)?,
                None => return Err(unknown_key(&place, name, properties.keys())),
            }
        }
        let required = self.here.get("required").and_then(Value::as_array).into_iter().flatten();
        match required.filter_map(Value::as_str).find(|name| !table.contains_key(*name)) {
            Some(name) => Err(missing(&join(key, name))),
            None => Ok(()),
        }
    }

    fn check_list(self, list: &[Value], value: &Value, key: &str) -> Result<(), BuildError> {
        let limit = |name: &str| self.here.get(name).and_then(Value::as_u64);
        let length = list.len() as u64;
        if limit("minItems").is_some_and(|limit| length < limit)
            || limit("maxItems").is_some_and(|limit| length > limit)
        {
            return Err(refusal(key, value, &self.expectation("array")));
        }
        let Some(item) = self.item() else { return Ok(()) };
        list.iter().enumerate().try_for_each(|(index, value)| item.check(value, &format!("{key}[{index}]")))
    }

    /// Description of what the schema accepts.
    fn expectation(self, kind: &str) -> String {
        let limit = |name: &str| self.here.get(name).filter(|limit| !limit.is_null());
        let words = match kind {
            "object" => "a table".to_owned(),
            "array" => match (limit("minItems"), limit("maxItems")) {
                (Some(least), Some(greatest)) if least == greatest => format!("a list of {least}"),
                (Some(least), Some(greatest)) => format!("a list of {least} to {greatest}"),
                (Some(least), None) => format!("a list of {least} or more"),
                (None, Some(greatest)) => format!("a list of at most {greatest}"),
                (None, None) => "a list".to_owned(),
            },
            "string" if self.is_path() => "the path of a file".to_owned(),
            "string" => "a text".to_owned(),
            "boolean" => "true or false".to_owned(),
            "integer" => "an integer".to_owned(),
            _ => "a number".to_owned(),
        };
        let limits =
            [("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<")];
        let limits =
            limits.iter().filter_map(|(name, sign)| Some(format!("{sign} {}", limit(name)?.as_f64()?)));
        let limits = limits.collect::<Vec<_>>().join(" and ");
        if limits.is_empty() { words } else { format!("{words} {limits}") }
    }
}

/// A number ≥ 0.
#[derive(JsonSchema)]
#[schemars(inline)]
pub struct NonNegative(#[schemars(range(min = 0))] pub f64);

/// A number > 0.
#[derive(JsonSchema)]
#[schemars(inline)]
pub struct Positive(#[schemars(extend("exclusiveMinimum" = 0))] pub f64);

/// Checks the values of a configuration, which a program may have assigned, as those of a file are checked; errors name
/// its `table`.
///
/// # Errors
/// [`BuildError`] naming the key, its value and what was expected.
pub fn check<T: Serialize + JsonSchema>(config: &T, table: &str) -> Result<(), BuildError> {
    let value = serde_json::to_value(config).map_err(|error| BuildError::malformed(table, error))?;
    check_finite(&value, table)?;
    Node { largest: f64::INFINITY, ..Schema::of_type::<T>().root() }.check(&value, table)
}

/// Refuses what JSON does not have: a number that is not finite is `null`, and an absent key is not written.
fn check_finite(value: &Value, key: &str) -> Result<(), BuildError> {
    match value {
        Value::Null => Err(BuildError::bad_entry(key, "not finite", "a finite number")),
        Value::Object(table) => {
            table.iter().try_for_each(|(name, value)| check_finite(value, &join(key, name)))
        }
        Value::Array(list) => {
            list.iter().enumerate().try_for_each(|(i, value)| check_finite(value, &format!("{key}[{i}]")))
        }
        _ => Ok(()),
    }
}

/// Full name of a key in a table.
#[must_use]
pub fn join(key: &str, name: &str) -> String {
    if key.is_empty() { name.to_owned() } else { format!("{key}.{name}") }
}

fn missing(key: &str) -> BuildError {
    BuildError::MissingKey { key: key.to_owned() }
}

/// That a key, or the whole if it is empty, has a value which is not accepted.
#[must_use]
pub fn refusal(key: &str, value: &Value, expected: &str) -> BuildError {
    let (value, expected) = (shorten(value), expected.to_owned());
    if key.is_empty() {
        return BuildError::bad_value("the whole", value, expected);
    }
    BuildError::BadEntry { key: key.to_owned(), value, expected }
}

fn unknown_key<'a>(place: &str, name: &str, known: impl Iterator<Item = &'a String> + Clone) -> BuildError {
    let synonym = SYNONYMS.iter().find(|names| names.contains(&name));
    let is_synonym = |key: &&String| synonym.is_some_and(|names| names.contains(&key.as_str()));
    let likest = known
        .clone()
        .map(|key| (strsim::jaro_winkler(name, key), key))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(likeness, _)| *likeness > 0.8);
    let near = known.clone().find(is_synonym).or(likest.map(|(_, key)| key));
    let table = &place[..place.len() - name.len()];
    BuildError::UnknownKey {
        key: place.to_owned(),
        suggestions: near.map(|key| format!("{table}{key}")).into_iter().collect(),
        known: known.map(String::as_str).collect::<Vec<_>>().join(", "),
    }
}

fn show(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// A value as displayed in errors.
#[must_use]
pub fn shorten(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() > 80 { text.chars().take(79).chain(['…']).collect() } else { text }
}
