"""Tables of sweeps, as pyarrow holds them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jax_aero.base import sizes
from jax_aero.base.files import read_bytes
from jax_aero.base.terminal import Refused


def read_parquet(content: bytes, most: int | None = None) -> Any:
    """Return a table (pyarrow) of flat columns and of at most so many values; its size is known before it is decoded.

    No threads are started, which abort some processes at their end.

    Raises
    ------
    ValueError
        If it is damaged, too large, or has nested columns.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(pa.BufferReader(content))
    about, schema = file.metadata, file.schema_arrow
    columns = [file.schema.column(place) for place in range(about.num_columns)]
    for column in columns:
        if column.max_repetition_level:
            raise ValueError(f"column `{column.path}` has lists; expected numbers and texts")
    # A number of a column has 8 bytes or the fixed length of its text; texts become numbers, of their dictionary.
    widths = sum(max(8, column.length or 0) for column in columns)
    sizes.expect("bytes of numbers", about.num_rows * widths, sizes.MAX_TABLE)
    sizes.expect("values", about.num_rows * about.num_columns, most or sizes.MAX_TABLE)
    groups = [about.row_group(index) for index in range(about.num_row_groups)]
    sizes.expect("bytes", sum(group.total_byte_size for group in groups), sizes.MAX_TABLE)
    texts = [column.path for column in columns if column.physical_type == "BYTE_ARRAY"]
    for group in groups:
        for column in map(group.column, range(about.num_columns)):
            if "DELTA_BYTE_ARRAY" in column.encodings:  # whose texts share beginnings of any length
                raise ValueError(f"column `{column.path_in_schema}` is encoded by differences; expected a dictionary")
    table = pq.ParquetFile(pa.BufferReader(content), read_dictionary=texts).read(use_threads=False)
    chunks = [chunk for name in texts for chunk in table[name].chunks]
    sizes.expect("bytes of texts", sum(map(_size_of_texts, chunks)), sizes.MAX_TABLE)
    return table.cast(schema)


def _size_of_texts(chunk: Any) -> int:
    """Return the size of the texts of a column that is encoded by a dictionary [bytes]."""
    import pyarrow.compute as pc

    lengths = np.asarray(pc.binary_length(chunk.dictionary).fill_null(0).to_numpy(zero_copy_only=False), np.int64)
    used = chunk.indices.drop_null().to_numpy(zero_copy_only=False)
    return int(lengths[used].sum()) if used.size else 0


def read_table(path: Path, most: int | None = None) -> Any:
    """Read a table (pyarrow) with the limits of `read_parquet`; what is refused is named.

    A folder has parts of one table, in the order of their names, each within these limits.
    """
    import pyarrow as pa

    if path.is_dir():
        return pa.concat_tables(read_table(part, most) for part in sorted(path.glob("*.parquet")))
    try:
        return read_parquet(read_bytes(path, sizes.MAX_TABLE), most)
    except Exception as reason:  # the readers raise many types
        raise Refused(f"{path} is damaged ({reason})") from None
