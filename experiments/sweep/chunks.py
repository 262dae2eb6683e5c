"""Finished chunks of an incomplete sweep, each in a file with a checksum.

A file is a table (Parquet) of consecutive rows, sealed with the digests of sweep and code and the rows' numbers. A file
that is truncated, empty, changed, or of other rows, another sweep or other code, is therefore ignored.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from jax_aero.base.files import seal, unseal, write_bytes
from jax_aero.base.parquet import read_parquet
from jax_aero.base.terminal import Refused


@dataclass(frozen=True)
class Chunks:
    """Chunks of one sweep, flown with one version of the code."""

    folder: Path
    identity: str
    """Digests of sweep and code."""

    def path(self, rows: range) -> Path:
        """Return the file of a chunk."""
        return self.folder / f"{rows.start:07}-{rows.stop:07}.chunk"

    def write(self, rows: range, table: pa.Table) -> None:
        """Write a chunk to the disk."""
        write_bytes(self.path(rows), seal(parquet(table), self._label(rows)))

    def read(self, rows: range) -> pa.Table:
        """Read a complete chunk."""
        content = self._content(rows)
        if content is None:
            raise Refused(f"{self.path(rows)} has changed meanwhile; the same command flies it again")
        return read_parquet(content)

    def find_whole(self, count: int) -> list[range]:
        """Return the complete chunks of the first `count` rows, in their order."""
        names = (re.fullmatch(r"(\d+)-(\d+)", path.stem) for path in sorted(self.folder.glob("*.chunk")))
        found = [range(int(name[1]), int(name[2])) for name in names if name]
        return [rows for rows in found if rows.stop <= count and self._content(rows) is not None]

    def remove(self, but: Iterable[range] = ()) -> list[str]:
        """Remove the files of all chunks except `but`; return their names."""
        kept = {self.path(rows) for rows in but}
        others = sorted(set(self.folder.glob("*.chunk")) - kept)
        for path in others:
            path.unlink()
        return [path.name for path in others]

    def clear(self) -> None:
        """Remove the files of all chunks, and the folder if it is then empty."""
        self.remove()
        with suppress(OSError):
            self.folder.rmdir()

    def _content(self, rows: range) -> bytes | None:
        path = self.path(rows)
        return unseal(path.read_bytes(), self._label(rows)) if path.is_file() else None

    def _label(self, rows: range) -> str:
        return f"{self.identity} {rows.start} {rows.stop} "


def parquet(table: pa.Table) -> bytes:
    """Return a table as a Parquet file."""
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd")
    return stream.getvalue()
