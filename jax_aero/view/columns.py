"""Columns of numbers in recorded logs, with their times: CSV and parquet files, and JSON messages of MCAP files."""

from __future__ import annotations

import csv
import io
import shlex
from array import array
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import sizes, typed
from jax_aero.base.files import parse_json, read_bytes
from jax_aero.base.parquet import read_table
from jax_aero.base.places import did_you_mean
from jax_aero.view import Refused, require
from jax_aero.view.export import METADATA

Array = NDArray[np.float64]

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""

EMPTY = ("", "na", "n/a", "nan", "null", "none")
"""Cells of a table where nothing was measured."""

MAX_LINE = 1 << 22
"""Greatest length of a line of a table [letters]."""

SEPARATORS = ",;\t"
"""Separators of columns; after the comma, in that order, those of tables with decimal commas."""


class Series(NamedTuple):
    """Rows of a signal, or of an entry of it, with their times [s]."""

    times: Array
    rows: Array


def read_csv(
    path: Path, time: str, scale: float, wanted: Collection[str], *, is_ours: bool
) -> tuple[dict[str, Series], Sequence[str]]:
    """Return the wanted columns of a table, as far as they are there, and its header; an empty cell is NaN.

    `time` is the name of the column of times, and `scale` their factor to seconds.
    Where most rows of a log of others have empty cells, each source wrote its own: a column has those that it fills.
    """
    content = read_bytes(path)
    try:
        # The separator by which the header has the column of times.
        headers = ((mark, next(_rows(path, content, mark), (0, []))[1]) for mark in SEPARATORS)
        separator = next((mark for mark, header in headers if time in header), ",")
        numbered = _rows(path, content, separator)
        header = next(numbered, (0, []))[1]
        if time not in header:
            raise Refused(f"`{path}` has no column `{time}` of times{did_you_mean(time, header)}")
        places = [place for place, word in enumerate(header) if word in wanted or word == time]
        numbers = array("d")
        for line, cells in numbered:
            if len(cells) != len(header):
                is_split = separator == "," and len(cells) > len(header)
                hint = "; with decimal commas, `;` between them" if is_split else ""
                what = f"line {line} of `{path}` has {len(cells)} cells"
                raise Refused(f"{what}; expected {len(header)}, as its header{hint}")
            for place in places:
                number = _number(cells[place], separator)
                if number is None:
                    what = f"line {line} of `{path}`: column `{header[place]}` is `{cells[place]}`"
                    raise Refused(f"{what}; expected a number")
                numbers.append(number)
    except UnicodeDecodeError:
        raise Refused(f"`{path}` is no text in UTF-8; expected a table with a header") from None
    except csv.Error as reason:
        raise Refused(f"`{path}` is no table of numbers with a header ({reason})") from None
    table = np.reshape(numbers, (-1, len(places)))
    times = table[:, places.index(header.index(time))]
    times = (times - times[:1]) * scale  # which would be rounded coarsely if they began in 1970
    is_filled = ~np.isnan(table)
    is_sparse = not is_ours and 2 * is_filled[:, is_filled.any(axis=0)].all(axis=1).sum() < len(table)
    found = {}
    for column, place in enumerate(places):
        own = is_filled[:, column] if is_sparse else slice(None)
        found[header[place]] = Series(times[own], table[own, column])
    return found, header


def read_parquet(
    path: Path, time: str, scale: float, wanted: Collection[str], *, is_ours: bool
) -> tuple[dict[str, Series], Sequence[str]]:
    """Return the wanted columns of a parquet file of numbers, as `read_csv`; a missing number is NaN."""
    del is_ours
    table = read_table(path)
    header = table.column_names
    if time not in header:
        raise Refused(f"`{path}` has no column `{time}` of times{did_you_mean(time, header)}")

    def rows(name: str) -> Array:
        try:
            return np.asarray(table[name].to_numpy(), np.float64)
        except (TypeError, ValueError):
            raise Refused(f"column `{name}` of `{path}` holds no numbers") from None

    times = rows(time)
    times = (times - times[:1]) * scale
    return {name: Series(times, rows(name)) for name in header if name in wanted}, header


TABLES = {".csv": read_csv, ".parquet": read_parquet}
"""Readers of tables, by suffix."""


def _rows(path: Path, content: bytes, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of every row that is not empty, with the number of its line."""
    text = io.TextIOWrapper(io.BytesIO(content), "utf-8-sig", newline="")
    reader = csv.reader(_bounded_lines(path, text), delimiter=separator)
    for row in reader:
        cells = [cell.strip() for cell in row]
        if any(cells):
            yield reader.line_num, cells


def _bounded_lines(path: Path, text: Iterable[str]) -> Iterator[str]:
    for line in text:
        if len(line) > MAX_LINE:
            raise Refused(f"`{path}` has a line of {len(line)} letters; expected at most {MAX_LINE}")
        yield line


def _number(cell: str, separator: str) -> float | None:
    """Return the number of a cell; a comma that does not separate is decimal, and no number is `None`."""
    if cell.lower() in EMPTY:
        return np.nan
    try:
        return float(cell if separator == "," else cell.replace(",", "."))
    except ValueError:
        return None


def read_mcap(path: Path, *, is_ours: bool) -> tuple[dict[str, Series], rust.Config | None]:
    """Return the numbers in the JSON messages of an MCAP file, and the configuration if `jax-aero export` wrote it."""
    require(["mcap"], f"reading `{path}`", "logs")
    from mcap.records import Channel, Message, Metadata

    _check_whole(path)
    topics = {f"/signals/{name}" for name in rust.signals()}
    found: dict[str, tuple[array[int], array[float]]] = {}
    channels: dict[int, Channel] = {}
    config, others, size = None, set(), 0
    try:
        for record in _records(path):
            if isinstance(record, Metadata) and record.name == METADATA and "config" in record.metadata:
                config = typed.make_paths_absolute(parse_json(record.metadata["config"].encode()))
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                if is_ours and channel.topic not in topics:
                    continue
                if channel.message_encoding != "json":
                    others.add(channel.message_encoding)
                    continue
                for name, number in _flatten(parse_json(record.data), channel.topic):
                    if name not in found:
                        found[name] = array("Q"), array("d")
                        size += 500 + len(name)
                    found[name][0].append(record.log_time)
                    found[name][1].append(number)
                    size += 16
                sizes.expect("bytes of numbers", size, sizes.MAX_NUMBERS)
    except Exception as reason:  # the package raises many types for damaged files
        what = f"({type(reason).__name__}: {reason})"
        raise Refused(f"`{path}` is damaged {what}; {_recovery(path)}") from None
    if not found:
        held = f", but in {', '.join(sorted(others))}" if others else ""
        raise Refused(f"`{path}` has no message in JSON{held}; expected those of `jax-aero export`, or others in JSON")
    start = min(min(stamps) for stamps, _ in found.values())
    return {name: _in_order(stamps, numbers, start) for name, (stamps, numbers) in found.items()}, config


def _in_order(stamps: array[int], numbers: array[float], start: int) -> Series:
    """Return a series from the stamps of messages [ns], in the order of their times."""
    times = np.asarray(stamps, np.uint64)
    order = np.argsort(times, kind="stable")
    return Series((times[order] - np.uint64(start)).astype(np.float64) * 1e-9, np.asarray(numbers)[order])


def _records(path: Path) -> Iterator[Any]:
    """Yield the records of an MCAP file, whose chunks are decompressed one by one, of known size."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=sizes.MAX_TABLE).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            sizes.expect("bytes in a chunk", _size_of_chunk(record), sizes.MAX_PART)
            yield from breakup_chunk(record, validate_crc=True)


def _size_of_chunk(chunk: Any) -> int:
    """Return the size of a chunk when it is decompressed [bytes], which its frame states or which is counted."""
    if chunk.compression == "zstd":
        import zstandard

        stated = zstandard.frame_content_size(chunk.data)  # −1 if it is not: then the record's size is the limit
        return int(max(stated, chunk.uncompressed_size))
    if chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        stream, size, left = LZ4FrameDecompressor(), 0, chunk.data
        while not stream.eof and size <= sizes.MAX_PART:
            part = stream.decompress(left, max_length=1 << 20)
            left, size = b"", size + len(part)
            if not part and stream.needs_input:
                break
        return size
    return len(chunk.data)


def _check_whole(path: Path) -> None:
    """Refuse a file that does not begin and end as an MCAP file."""
    with path.open("rb") as file:
        first = file.read(len(MAGIC))
        file.seek(max(len(MAGIC), path.stat().st_size - len(MAGIC)))
        last = file.read()
    if first != MAGIC:
        raise Refused(f"`{path}` {'does not begin as an MCAP file' if first else 'is empty'}; expected an MCAP file")
    if last != MAGIC:
        raise Refused(f"`{path}` has no end: the recording was cut off; {_recovery(path)}")


def _recovery(path: Path) -> str:
    command = shlex.join(["mcap", "recover", str(path), "-o", f"{path.stem}_recovered.mcap"])
    return f"`{command}` saves what is sound (the program is at mcap.dev)"


def _flatten(part: Any, name: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message with their paths; null is NaN."""
    if isinstance(part, dict | list):
        for key, inner in part.items() if isinstance(part, dict) else enumerate(part):
            yield from _flatten(inner, f"{name}/{key}")
    elif part is None or isinstance(part, int | float):
        yield name, np.nan if part is None else float(part)
