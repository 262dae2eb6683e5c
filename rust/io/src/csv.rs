//! The one dialect of tables in text: a header, and a row of cells for each line.
//!
//! Commas, semicolons, tabs or blanks separate the cells; beside the latter three a comma is decimal. Cells may stand in
//! quotation marks (RFC 4180). Blanks around cells, empty lines, comments after `#` or `%` and a byte order mark are nothing; a
//! comment before the rows may be the header, as NumPy's `savetxt` and MATLAB's users write it.

use flight_core::BuildError;
use std::borrow::Cow;
use std::iter::once;

/// Cells in which nothing was measured, but for signs; those with brackets and `1.#` are of Microsoft's C library.
const EMPTY: &str = "|na|n/a|nan|null|none|#n/a|<na>|nat|nan(ind)|nan(snan)|1.#ind|1.#qnan|1.#snan";

/// Infinity of Microsoft's C library, but for signs.
const INFINITE: &str = "1.#inf";

/// Beginnings of comments.
const COMMENT: [char; 2] = ['#', '%'];

/// What the cells of a column hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A finite number.
    Number,
    /// A finite number, or nothing, which is NaN.
    Reading,
    /// Any number, or nothing, which is NaN.
    Signal,
    /// Any text.
    Text,
}

impl Kind {
    fn has(self, number: f64) -> bool {
        number.is_finite() || self == Self::Signal || self == Self::Reading && number.is_nan()
    }

    fn expected(self) -> &'static str {
        match self {
            Self::Number => "a finite number",
            Self::Reading => "a finite number, or nothing",
            Self::Signal => "a number, or nothing",
            Self::Text => "a text",
        }
    }
}

/// A table whose header is read.
#[derive(Debug)]
pub struct Csv<'t> {
    /// Name of every column.
    pub names: Vec<String>,
    /// Name of the file in errors, e.g. `wind file gust.csv`.
    pub file: String,
    /// Texts that mean that nothing was measured, each with its column.
    pub missing: Vec<(String, String)>,
    rest: &'t str,
    line: usize,
    separator: u8,
}

/// The columns of a table that were asked for.
#[derive(Debug, Default)]
pub struct Rows {
    /// Numbers and readings, row by row.
    pub numbers: Vec<f64>,
    /// Texts, row by row.
    pub texts: Vec<String>,
    /// Line on which each row stands, from 1.
    pub lines: Vec<usize>,
}

/// Line and cells of a row.
type Row<'t> = (usize, Vec<Cow<'t, str>>);

impl<'t> Csv<'t> {
    /// Reads the header of `file`: of the separators the first one whose names are accepted; `header` describes them.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming `file`, the line and what was expected.
    pub fn new(
        text: &'t str,
        file: &str,
        header: &str,
        accept: impl Fn(&[&str]) -> bool,
    ) -> Result<Self, BuildError> {
        let whole = text.trim_start_matches('\u{feff}');
        let mut first = None;
        for (line, rest) in once((1, whole)).chain(comments(whole)) {
            for separator in *b",;\t " {
                let (names, missing, file) = (Vec::new(), Vec::new(), file.to_owned());
                let mut csv = Self { names, file, missing, rest, line, separator };
                let row = csv.next_row();
                // A comment is no row that could be wrong.
                let row = if rest.len() < whole.len() { row.unwrap_or_default() } else { row? };
                let Some((line, cells)) = row else { break };
                csv.names = cells.into_iter().map(Cow::into_owned).collect();
                if accept(&csv.names.iter().map(String::as_str).collect::<Vec<_>>()) {
                    return Ok(csv);
                }
                first.get_or_insert((line, csv.names.join(",")));
            }
        }
        let (line, names) = first.unwrap_or((1, "empty".to_owned()));
        Err(BuildError::bad_value(place(file, line), names, header))
    }

    /// Reads these columns of all rows.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the file, the line, the column and what was expected.
    pub fn read(mut self, columns: &[(&str, Kind)]) -> Result<Rows, BuildError> {
        let mut places = Vec::with_capacity(columns.len());
        for &(name, kind) in columns {
            let mut found = self.names.iter().enumerate().filter(|(_, other)| *other == name);
            match (found.next(), found.next()) {
                (Some((place, _)), None) => places.push((place, kind)),
                (first, _) => {
                    let item = format!("column {name} of {}", self.file);
                    let value = if first.is_none() { "absent" } else { "there twice" };
                    let expected = format!("it once among {}", self.names.join(", "));
                    return Err(BuildError::bad_value(item, value, expected));
                }
            }
        }
        let mut rows = Rows::default();
        while let Some((line, mut cells)) = self.next_row()? {
            if cells.len() != self.names.len() {
                let hint =
                    if self.separator == b',' { "; with decimal commas, `;` between them" } else { "" };
                let expected = format!("{}, as its header{hint}", self.names.len());
                let item = format!("number of cells in {}", place(&self.file, line));
                return Err(BuildError::bad_value(item, cells.len(), expected));
            }
            for &(column, kind) in &places {
                let cell = std::mem::take(&mut cells[column]);
                if kind == Kind::Text {
                    rows.texts.push(cell.into_owned());
                    continue;
                }
                let (number, expected) = (self.number(column, &cell), kind.expected());
                rows.numbers.push(number.filter(|number| kind.has(*number)).ok_or_else(|| {
                    let item = format!("column {} in {}", self.names[column], place(&self.file, line));
                    let hint =
                        if cell.starts_with(['[', '(', '{']) { ", each in a column of its own" } else { "" };
                    let value = if cell.is_empty() { "empty" } else { &cell };
                    BuildError::bad_value(item, value, format!("{expected}{hint}"))
                })?);
            }
            rows.lines.push(line);
        }
        Ok(rows)
    }

    fn number(&self, column: usize, cell: &str) -> Option<f64> {
        let number = if self.separator == b',' { cell.parse() } else { cell.replace(',', ".").parse() };
        let bare = cell.strip_prefix(['+', '-']).filter(|bare| !bare.is_empty()).unwrap_or(cell);
        let is_missing = || {
            EMPTY.split('|').any(|empty| empty.eq_ignore_ascii_case(digits(bare)))
                || self.missing.iter().any(|(of, text)| *of == self.names[column] && text == cell)
        };
        let infinity = if cell.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY };
        let number = number.ok().or_else(|| INFINITE.eq_ignore_ascii_case(digits(bare)).then_some(infinity));
        number.or_else(|| is_missing().then_some(f64::NAN))
    }

    /// The line and the cells of the next row; `None` at the end.
    fn next_row(&mut self) -> Result<Option<Row<'t>>, BuildError> {
        while !self.rest.is_empty() {
            let (text, line) = (self.rest, self.line);
            let is_comment = text.trim_start_matches([' ', '\t']).starts_with(COMMENT);
            let (mut cells, mut start, mut end, mut is_quoted) = (Vec::new(), 0, text.len(), false);
            for (place, byte) in text.bytes().enumerate() {
                match byte {
                    b'"' if !is_comment => {
                        let before = text[start..place].trim_start();
                        is_quoted ^= before.is_empty() || before.starts_with('"');
                    }
                    b'\n' | b'\r' if !is_quoted => {
                        end = place;
                        break;
                    }
                    b'\n' => self.line += 1,
                    _ if byte == self.separator && !is_quoted => {
                        cells.push(cell(&text[start..place]));
                        start = place + 1;
                    }
                    _ => {}
                }
            }
            if is_quoted {
                return Err(BuildError::bad_value(
                    place(&self.file, line),
                    "not closed",
                    "a second quotation mark",
                ));
            }
            cells.push(cell(&text[start..end]));
            if self.separator == b' ' {
                cells.retain(|cell| !cell.is_empty());
            }
            let newline = if text[end..].starts_with("\r\n") { 2 } else { 1 };
            self.rest = text.get(end + newline..).unwrap_or_default();
            self.line += 1;
            if !is_comment && cells.iter().any(|cell| !cell.is_empty()) {
                return Ok(Some((line, cells)));
            }
        }
        Ok(None)
    }
}

impl Rows {
    /// Name of a row of a file in errors.
    #[must_use]
    pub fn place(&self, file: &str, row: usize) -> String {
        place(file, self.lines[row])
    }
}

/// The lines of comments before the first row, each with what follows its `#`.
fn comments(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut rest = text;
    (1..).map_while(move |line| {
        let comment = rest.trim_start_matches([' ', '\t']).strip_prefix(COMMENT)?;
        rest = comment.split_once('\n').map_or("", |(_, rest)| rest);
        Some((line, comment.trim_start_matches(COMMENT)))
    })
}

/// A number of Microsoft's C library without the zeros that fill its digits, as in `1.#INF00`.
fn digits(cell: &str) -> &str {
    if cell.contains('#') { cell.trim_end_matches('0') } else { cell }
}

fn place(file: &str, line: usize) -> String {
    format!("line {line} of {file}")
}

/// The text of a cell, without its blanks and quotation marks.
fn cell(text: &str) -> Cow<'_, str> {
    let text = text.trim();
    match text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) {
        None => text.into(),
        Some(inner) => inner.trim().replace("\"\"", "\"").into(),
    }
}
