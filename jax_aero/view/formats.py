"""Formats of logs: which are read, and what makes one of them of another."""

from __future__ import annotations

from pathlib import Path

FORMATS = (".mcap", ".mat", ".csv", ".tsv", ".txt", ".parquet")
"""Suffixes of logs other than results."""

CONVERTERS = {
    **dict.fromkeys((".bin", ".tlog"), "; `mavlogdump.py --format csv` makes CSV of it"),
    **dict.fromkeys((".bag", ".db3"), "; PlotJuggler exports CSV, `ros2 bag convert` makes MCAP (JSON is read)"),
    **dict.fromkeys((".gz", ".zip", ".xz", ".zst"), "; unpack it first"),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "; save its sheet as CSV"),
    **dict.fromkeys((".mf4", ".mdf", ".dat"), "; `asammdf` exports CSV, parquet and MATLAB files"),
    **dict.fromkeys((".h5", ".hdf5"), "; write its columns as parquet, e.g. with pandas"),
    ".ulg": "; `ulog2csv` makes CSV of it",
}
"""What makes a log that is read of one of another format, by suffix."""


def instead_of(path: Path) -> str:
    """Return which files are read, and what makes one of this file of another format."""
    return f"a file of {', '.join(FORMATS)}{CONVERTERS.get(path.suffix.lower(), '')}"
