//! Reading a safetensors file: eight bytes of length, a JSON table of tensors, then their bytes.

use crate::error::BuildError;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// A header longer than this is no header.
const MAX_HEADER: usize = 1 << 24;

/// What the table says of one tensor.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    /// First byte, and one past the last, counted from the end of the table.
    data_offsets: [usize; 2],
}

/// The tensors of one file, by name, until each is taken.
pub struct Tensors<'a> {
    origin: String,
    entries: BTreeMap<String, Entry>,
    data: &'a [u8],
}

impl<'a> Tensors<'a> {
    /// Reads the table of `bytes`, the content of `path`.
    ///
    /// # Errors
    /// [`BuildError::Malformed`] for bytes that are no safetensors file, or where tensors overlap,
    /// leave gaps, or end elsewhere than the file.
    pub fn parse(path: &Path, bytes: &'a [u8]) -> Result<Self, BuildError> {
        let origin = path.display().to_string();
        let malformed = |message: String| BuildError::malformed(&origin, message);
        let (length, rest) = bytes
            .split_first_chunk::<8>()
            .ok_or_else(|| malformed(format!("{} bytes are no safetensors file", bytes.len())))?;
        let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
        if length > rest.len().min(MAX_HEADER) {
            return Err(malformed(format!("announces a table of {length} bytes; the file is shorter")));
        }
        let (table, data) = rest.split_at(length);
        let mut table: BTreeMap<String, serde_json::Value> =
            serde_json::from_slice(table).map_err(|error| malformed(format!("its table: {error}")))?;
        table.remove("__metadata__");
        let mut entries = BTreeMap::new();
        for (name, value) in table {
            let entry = serde_json::from_value(value)
                .map_err(|error| malformed(format!("tensor `{name}`: {error}")))?;
            entries.insert(name, entry);
        }
        let mut spans: Vec<(&String, [usize; 2])> =
            entries.iter().map(|(name, entry): (_, &Entry)| (name, entry.data_offsets)).collect();
        spans.sort_by_key(|(_, span)| *span);
        let mut end = 0;
        for (name, [first, last]) in spans {
            if first != end || last < first || last > data.len() {
                return Err(malformed(format!(
                    "tensor `{name}` fills bytes {first} to {last}; expected it to begin at {end} and to end \
                     within {}",
                    data.len()
                )));
            }
            end = last;
        }
        if end != data.len() {
            return Err(malformed(format!("tensors end at byte {end} of {}", data.len())));
        }
        Ok(Self { origin, entries, data })
    }

    /// Takes a float32 tensor of the given shape, row-major, every number finite.
    ///
    /// # Errors
    /// [`BuildError`] naming file and tensor, for one that is absent, of another type or shape, or
    /// that holds a number that is not finite.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, BuildError> {
        let item = |what: &str| format!("{what} of tensor `{name}` in {}", self.origin);
        let Some(entry) = self.entries.remove(name) else {
            let known = self.entries.keys();
            return Err(BuildError::unknown_name(format!("the card of {}", self.origin), name, known));
        };
        if entry.dtype != "F32" {
            return Err(BuildError::bad_value(item("dtype"), entry.dtype, "F32"));
        }
        let count = shape.iter().product::<usize>();
        if entry.shape != shape {
            let (found, expected) = (format!("{:?}", entry.shape), format!("{shape:?}"));
            return Err(BuildError::bad_value(item("shape"), found, expected));
        }
        let [first, last] = entry.data_offsets;
        let bytes = &self.data[first..last];
        if bytes.len() != 4 * count {
            return Err(BuildError::bad_value(item("bytes"), bytes.len(), (4 * count).to_string()));
        }
        let numbers: Vec<f32> = bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        if let Some((index, value)) = numbers.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            return Err(BuildError::bad_value(item(&format!("entry {index}")), value, "a finite number"));
        }
        Ok(numbers)
    }

    /// Refuses tensors that nobody took.
    ///
    /// # Errors
    /// [`BuildError::Malformed`] naming the first of them.
    pub fn finish(self) -> Result<(), BuildError> {
        match self.entries.keys().next() {
            None => Ok(()),
            Some(name) => Err(BuildError::malformed(
                self.origin,
                format!("tensor `{name}` belongs to no layer of the architecture on the card"),
            )),
        }
    }
}
