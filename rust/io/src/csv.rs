//! Numbers in a CSV file: a header, and a line of numbers for each row. Empty lines and `#` comments are left out.

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
    /// [`BuildError::BadValue`] naming `file`, the line and what was expected.
    pub fn parse(
        text: &str,
        file: &str,
        header: &str,
        accept: impl Fn(&[&str]) -> bool,
    ) -> Result<Self, BuildError> {
        let mut csv = Self { rows: Vec::new(), file: file.to_owned(), lines: Vec::new() };
        let mut lines = text.lines().enumerate().filter(|(_, line)| {
            let line = line.trim();
            !line.is_empty() && !line.starts_with('#')
        });
        let (number, first) = lines.next().unwrap_or((0, "empty"));
        let names: Vec<&str> = first.split(',').map(str::trim).collect();
        if !accept(&names) {
            return Err(BuildError::bad_value(csv.line(number), first, header));
        }
        for (number, line) in lines {
            let fields: Result<Vec<f64>, _> = line.split(',').map(|field| field.trim().parse()).collect();
            let row = fields.ok().filter(|row| row.len() == names.len());
            let expected = || format!("{} numbers: {}", names.len(), names.join(", "));
            csv.rows.push(row.ok_or_else(|| BuildError::bad_value(csv.line(number), line, expected()))?);
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
