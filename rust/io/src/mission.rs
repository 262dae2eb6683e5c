//! Missions: tables of commands, and recorded references read from CSV files.
//!
//! A file has a header line and one line for each sample: the first 7, 10, 13 or 16 of the names in [`COLUMNS`].
//! Missing derivatives are computed by differences.

use crate::csv::{Csv, Kind};
use crate::read_text;
use flight_core::BuildError;
use flight_core::control::law::mission::{Commands, Mission};
use flight_core::control::law::recorded::{REQUIRED, Recording};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Names of the columns: time, centre of mass, attitude of the base and, optionally, velocity, acceleration and
/// jerk of the centre of mass.
pub const COLUMNS: [&str; 16] =
    ["time", "x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "ax", "ay", "az", "jx", "jy", "jz"];

/// One file of `configs/mission/`: commands, or the file of a recorded reference.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MissionConfig {
    /// Times of the autopilot's commands.
    #[serde(flatten)]
    pub commands: Commands,
    /// CSV file of a recorded reference, in place of commands. Relative paths start at the configuration file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("format" = "path"))]
    pub file: Option<PathBuf>,
}

/// Builds the mission of a table and reads its file, if it names one. Commands are checked by the set-point
/// generator.
///
/// # Errors
/// [`BuildError`] if there are commands and a file, or naming the file, the line and what was expected.
pub fn load_mission(config: &MissionConfig) -> Result<Mission, BuildError> {
    let Some(file) = &config.file else { return Ok(Mission::Commands(config.commands.clone())) };
    let mut lists = config.commands.lists().into_iter();
    if let Some((name, [(start, end), ..])) = lists.find(|(_, intervals)| !intervals.is_empty()) {
        return Err(BuildError::bad_value(
            format!("mission.{name}"),
            format!("[[{start}, {end}], …] beside the recorded reference {}", file.display()),
            "either commands or a file",
        ));
    }
    parse_recording(&read_text(file)?, &file.display().to_string()).map(Mission::Recorded)
}

/// Reads a recorded reference: the rows of the file, and the recording that they make.
///
/// # Errors
/// [`BuildError`] naming the file, the line and what was expected.
pub fn read_recording(file: &Path) -> Result<(Vec<Vec<f64>>, Recording), BuildError> {
    parse_rows(&read_text(file)?, &file.display().to_string())
}

/// Parses the text of a recorded reference; `origin` is named in errors.
///
/// # Errors
/// [`BuildError::BadValue`] naming `origin`, the line and what was expected.
pub fn parse_recording(text: &str, origin: &str) -> Result<Recording, BuildError> {
    Ok(parse_rows(text, origin)?.1)
}

fn parse_rows(text: &str, origin: &str) -> Result<(Vec<Vec<f64>>, Recording), BuildError> {
    let header = format!("the first 7, 10, 13 or 16 names of {}", COLUMNS.join(","));
    let csv = Csv::new(text, &format!("reference file {origin}"), &header, |names| {
        let width = names.len();
        width >= REQUIRED && (width - REQUIRED).is_multiple_of(3) && COLUMNS.get(..width) == Some(names)
    })?;
    let (width, file) = (csv.names.len(), csv.file.clone());
    let found = csv.read(&COLUMNS.map(|name| (name, Kind::Number))[..width])?;
    let rows: Vec<_> = found.numbers.chunks(width).map(<[f64]>::to_vec).collect();
    let recording = Recording::new(&rows, &file, |row| found.place(&file, row))?;
    Ok((rows, recording))
}
