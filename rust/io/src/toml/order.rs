//! JSON of a TOML text with its keys in the order of the text, which the tables of this crate sort.

use super::parse;
use ::toml::de::{DeTable, DeValue};
use flight_core::BuildError;
use serde_json::{Map, Value};

/// Converts a TOML text to the JSON of its table, with its keys in the order of the text.
///
/// # Errors
/// As [`parse`].
pub fn to_json(text: &str, origin: &str) -> Result<String, BuildError> {
    let table = parse(text, origin)?;
    let written = DeTable::parse(text).map_err(|error| BuildError::malformed(origin, error.message()))?;
    Ok(of_table(&table, written.get_ref()))
}

fn of_table(table: &Map<String, Value>, written: &DeTable<'_>) -> String {
    let mut entries: Vec<_> = written.iter().collect();
    entries.sort_by_key(|(key, _)| key.span().start);
    let entry = |(key, place): (&str, _)| format!("{}:{}", Value::from(key), of_value(&table[key], place));
    let entries = entries.iter().map(|(key, place)| entry((key.get_ref(), place.get_ref())));
    format!("{{{}}}", entries.collect::<Vec<_>>().join(","))
}

fn of_value(value: &Value, written: &DeValue<'_>) -> String {
    match (value, written) {
        (Value::Object(table), DeValue::Table(written)) => of_table(table, written),
        (Value::Array(list), DeValue::Array(written)) => {
            let items = list.iter().zip(written.iter()).map(|(item, place)| of_value(item, place.get_ref()));
            format!("[{}]", items.collect::<Vec<_>>().join(","))
        }
        (value, _) => value.to_string(),
    }
}
