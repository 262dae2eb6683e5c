//! Tables whose types only Python has: of numbers and texts (CSV), and of keys, checked by their JSON Schemas.

use crate::arrays::{Output, array, plain_error, value_error};
use flight_core::BuildError;
use flight_io::Schema;
use flight_io::csv::{Csv, Kind};
use numpy::PyArrayDyn;
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

/// Names, numbers (row, column), texts (row by row) and lines of a table.
type Table<'py> = (Vec<String>, Output<'py>, Vec<String>, Bound<'py, PyArrayDyn<usize>>);

/// Read columns of a table of text, whose header has the name `key`; `file` names it in errors. A column of readings or
/// signals may be absent. `missing` has texts that are no number, each with its column.
#[pyfunction]
pub fn read_csv<'py>(
    py: Python<'py>,
    content: &[u8],
    file: &str,
    key: &str,
    columns: Vec<(String, String)>,
    missing: Vec<(String, String)>,
) -> PyResult<Table<'py>> {
    let (names, width, rows) = py
        .detach(|| {
            let text = flight_io::decode(content)
                .map_err(|error| BuildError::bad_value(file, error, "text in UTF-8"))?;
            let mut csv =
                Csv::new(&text, file, &format!("a header with `{key}`"), |names| names.contains(&key))?;
            csv.missing = missing;
            let mut wanted: Vec<_> =
                columns.iter().map(|(name, kind)| (name.as_str(), kind_of(kind))).collect();
            wanted.retain(|(name, kind)| {
                matches!(kind, Kind::Number | Kind::Text) || csv.names.iter().any(|other| other == name)
            });
            let width = wanted.iter().filter(|(_, kind)| *kind != Kind::Text).count();
            Ok((csv.names.clone(), width, csv.read(&wanted)?))
        })
        .map_err(value_error)?;
    let shape = [rows.lines.len(), width];
    let lines = array(py, &shape[..1], rows.lines)?;
    Ok((names, array(py, &shape, rows.numbers)?, rows.texts, lines))
}

fn kind_of(word: &str) -> Kind {
    match word {
        "number" => Kind::Number,
        "reading" => Kind::Reading,
        "signal" => Kind::Signal,
        _ => Kind::Text,
    }
}

fn schema(json: &str) -> PyResult<Schema> {
    Ok(Schema::of_json(serde_json::from_str(json).map_err(plain_error)?))
}
