//! Tables whose types only Python has, read and checked by their JSON Schemas.

use crate::arrays::{plain_error, value_error};
use flight_io::Schema;
use pyo3::prelude::*;
use serde_json::{Map, Value};
use std::path::PathBuf;

/// Read a TOML file; return its table as JSON, with its keys in the order of the file.
#[pyfunction]
pub fn read_toml(path: PathBuf) -> PyResult<String> {
    let text = flight_io::read_text(&path).map_err(value_error)?;
    flight_io::toml::to_json(&text, &path.display().to_string()).map_err(value_error)
}

/// Read a TOML file with its base files, set dotted keys (a list of pairs), and check it by a schema; return its table
/// as JSON.
#[pyfunction]
pub fn read_table(path: PathBuf, changes_json: &str, schema_json: &str) -> PyResult<String> {
    let changes: Vec<(String, Value)> = serde_json::from_str(changes_json).map_err(plain_error)?;
    let table = flight_io::load_by(&path, &changes, &schema(schema_json)?);
    Ok(table.map_err(value_error)?.to_string())
}

/// As `read_table`, for a table in JSON whose paths start at `folder`.
#[pyfunction]
pub fn check_table(table_json: &str, folder: PathBuf, schema_json: &str) -> PyResult<String> {
    let (table, schema): (Map<String, Value>, _) =
        (serde_json::from_str(table_json).map_err(plain_error)?, schema(schema_json)?);
    let checked = flight_io::resolve_table(table, &folder, &schema)
        .and_then(|table| schema.check(&table).map(|()| table));
    Ok(checked.map_err(value_error)?.to_string())
}

fn schema(json: &str) -> PyResult<Schema> {
    Ok(Schema::of_json(serde_json::from_str(json).map_err(plain_error)?))
}
