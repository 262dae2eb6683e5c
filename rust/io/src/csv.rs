//! Numbers in a CSV file: a header, and a line of numbers for each row. Empty lines and `#` comments are left out.
//! Where semicolons or tabs separate the columns, a comma is decimal.

use crate::read_text;
use flight_core::BuildError;
use std::path::Path;

/// Rows of numbers, with the lines on which they stand.
#[derive(Debug)]
pub struct Csv {
    /// The numbers, row by row; all rows have the length of the header.
    pub rows: Vec<Vec<f64>>,
    /// Name of the file in errors, e.g. `wind file gust.csv`.
    pub file: String,
    lines: Vec<usize>,
}

impl Csv {
    /// Reads a file, as [`Csv::parse`]; `kind` is named in errors, e.g. `wind file`.
    ///
    /// # Errors
    /// [`BuildError`] naming the file, the line and what was expected.
    pub fn read(
        path: &Path,
        kind: &str,
        header: &str,
        accept: impl Fn(&[&str]) -> bool,
    ) -> Result<Self, BuildError> {
        Self::parse(&read_text(path)?, &format!("{kind} {}", path.display()), header, accept)
    }

    /// Parses the text of `file`, whose columns are named as `accept` decides; `header` describes them.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming `file`, the line, the column and what was expected.
    pub fn parse(
        text: &str,
        file: &str,
        header: &str,
        accept: impl Fn(&[&str]) -> bool,
    ) -> Result<Self, BuildError> {
        let mut csv = Self { rows: Vec::new(), file: file.to_owned(), lines: Vec::new() };
        // Spreadsheets begin a file with a byte order mark.
        let lines = text.trim_start_matches('\u{feff}').lines().enumerate();
        let mut lines = lines.filter(|(_, line)| {
            let line = line.trim();
            !line.is_empty() && !line.starts_with('#')
        });
        let (number, first) = lines.next().unwrap_or((0, "empty"));
        let split = |separator| first.split(separator).map(str::trim).collect::<Vec<_>>();
        let Some(separator) = [',', ';', '\t'].into_iter().find(|separator| accept(&split(*separator)))
        else {
            return Err(BuildError::bad_value(csv.line(number), first, header));
        };
        let names = split(separator);
        for (number, line) in lines {
            let fields: Vec<&str> = line.split(separator).map(str::trim).collect();
            if fields.len() != names.len() {
                let hint = if separator == ',' { "; with decimal commas, `;` between them" } else { "" };
                let expected = format!("{} numbers: {}{hint}", names.len(), names.join(", "));
                return Err(BuildError::bad_value(csv.line(number), line, expected));
            }
            let mut row = Vec::with_capacity(names.len());
            for (name, field) in names.iter().zip(fields) {
                let parsed = if separator == ',' { field.parse() } else { field.replace(',', ".").parse() };
                let item = || format!("column {name} in {}", csv.line(number));
                row.push(parsed.map_err(|_| BuildError::bad_value(item(), field, "a number"))?);
            }
            csv.rows.push(row);
            csv.lines.push(number);
        }
        Ok(csv)
    }

    /// Name of a row in errors.
    #[must_use]
    pub fn place(&self, row: usize) -> String {
        self.line(self.lines[row])
    }

    fn line(&self, number: usize) -> String {
        format!("line {} of {}", number + 1, self.file)
    }
}
