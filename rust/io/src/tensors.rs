//! Parser for safetensors files: eight bytes of length, a JSON table of tensors, then their bytes.

use flight_core::BuildError;
use flight_core::aero::network::{Tensor, Tensors};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Greatest length of the header \[bytes\].
const MAX_HEADER: usize = 1 << 24;

/// Entry of the table for one tensor.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    /// First byte, and one past the last, relative to the end of the table.
    data_offsets: [usize; 2],
}

/// Reads float32 tensors from `bytes`, the content of `path`.
///
/// # Errors
/// [`BuildError`] for bytes that are not a safetensors file; for tensors that overlap, leave gaps,
/// or do not end with the file; and for a tensor of another type than float32, or whose size does
/// not match its shape.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Tensors, BuildError> {
    let origin = path.display().to_string();
    let malformed = |message: String| BuildError::malformed(&origin, message);
    let (length, rest) = bytes
        .split_first_chunk::<8>()
        .ok_or_else(|| malformed(format!("{} bytes are no safetensors file", bytes.len())))?;
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    if length > rest.len().min(MAX_HEADER) {
        return Err(malformed(format!(
            "announces a table of {length} bytes; the file is shorter, or the table exceeds 16 MiB"
        )));
    }
    let (table, data) = rest.split_at(length);
    let mut table: BTreeMap<String, serde_json::Value> =
        serde_json::from_slice(table).map_err(|error| malformed(format!("its table: {error}")))?;
    table.remove("__metadata__");
    let mut entries = BTreeMap::new();
    for (name, value) in table {
        let entry =
            serde_json::from_value(value).map_err(|error| malformed(format!("tensor `{name}`: {error}")))?;
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
    let mut tensors = BTreeMap::new();
    for (name, Entry { dtype, shape, data_offsets: [first, last] }) in entries {
        let item = |what: &str| format!("{what} of tensor `{name}` in {origin}");
        if dtype != "F32" {
            return Err(BuildError::bad_value(item("dtype"), dtype, "F32"));
        }
        let bytes = &data[first..last];
        let expected = shape.iter().try_fold(4_usize, |size, length| size.checked_mul(*length));
        if expected != Some(bytes.len()) {
            let expected = format!("{} for the shape {shape:?}", expected.unwrap_or(usize::MAX));
            return Err(BuildError::bad_value(item("bytes"), bytes.len(), expected));
        }
        let values = bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        tensors.insert(name, Tensor { shape, values });
    }
    Ok(Tensors::new(origin, tensors))
}
