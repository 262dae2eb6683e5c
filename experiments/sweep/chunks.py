"""Finished chunks of an incomplete sweep, each in a file with a checksum.

A file is a table (Parquet), sealed with the sweep's digest, the code's and the chunk's number. A file that is
truncated, empty, changed, or of another chunk, sweep or code, is therefore ignored.
"""

from __future__ import annotations

import io
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

    def path(self, chunk: int) -> Path:
        """Return the file of a chunk."""
        return self.folder / f"{chunk:06}.chunk"

    def write(self, chunk: int, table: pa.Table) -> None:
        """Write a chunk to the disk."""
        write_bytes(self.path(chunk), seal(parquet(table), self._label(chunk)))

    def read(self, chunk: int) -> pa.Table:
        """Read a complete chunk."""
        content = self._content(chunk)
        if content is None:
            raise Refused(f"{self.path(chunk)} has changed meanwhile; the same command flies it again")
        return read_parquet(content)

    def find_whole(self, count: int) -> set[int]:
        """Return which of the first `count` chunks are complete."""
        return {chunk for chunk in range(count) if self._content(chunk) is not None}

    def remove(self, but: Iterable[int] = ()) -> list[str]:
        """Remove the files of all chunks except `but`; return their names."""
        kept = {self.path(chunk) for chunk in but}
        others = sorted(set(self.folder.glob("*.chunk")) - kept)
        for path in others:
            path.unlink()
        return [path.name for path in others]

    def clear(self) -> None:
        """Remove the files of all chunks, and the folder if it is then empty."""
        self.remove()
        with suppress(OSError):
            self.folder.rmdir()

    def _content(self, chunk: int) -> bytes | None:
        path = self.path(chunk)
        return unseal(path.read_bytes(), self._label(chunk)) if path.is_file() else None

    def _label(self, chunk: int) -> str:
        return f"{self.identity} {chunk} "


def parquet(table: pa.Table) -> bytes:
    """Return a table as a Parquet file."""
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd")
    return stream.getvalue()
