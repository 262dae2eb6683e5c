"""Tables of sweeps, as pyarrow holds them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jax_aero.base.files import read_bytes
from jax_aero.base.terminal import Refused

MAX_TABLE = 1 << 30
"""Greatest size of a table of a sweep in memory [bytes]: a million flights."""


def read_parquet(content: bytes) -> Any:
    """Return a file (pyarrow) that starts no threads if it is read without: they abort some processes at their end."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    return pq.ParquetFile(pa.BufferReader(content))


def read_table(path: Path) -> Any:
    """Read a table (pyarrow), whose size is known before reading; a damaged one is refused by name."""
    try:
        file = read_parquet(read_bytes(path, MAX_TABLE))
        parts = [file.metadata.row_group(index) for index in range(file.metadata.num_row_groups)]
        size = sum(max(part.total_byte_size, 8 * part.num_rows * part.num_columns) for part in parts)
        table = file.read(use_threads=False) if size <= MAX_TABLE else None
    except Exception as reason:  # the readers raise many types
        raise Refused(f"{path} is damaged ({reason})") from None
    if table is None:
        raise Refused(f"{path} holds {size} bytes; expected at most {MAX_TABLE}")
    return table
