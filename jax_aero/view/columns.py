"""Columns of numbers in recorded logs, with their times: tables of text, parquet files, JSON messages of MCAP files."""

from __future__ import annotations

import json
import shlex
import warnings
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import sizes, typed_config
from jax_aero.base.files import check_depth, parse_json, read_bytes
from jax_aero.base.parquet import read_table
from jax_aero.base.places import did_you_mean
from jax_aero.base.terminal import ConfigError
from jax_aero.view import Refused, require, stamps
from jax_aero.view.export import METADATA
from jax_aero.view.stamps import Stated

Array = NDArray[np.float64]

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""


class Series(NamedTuple):
    """Rows of a signal, or of an entry of it, with their times [s]."""

    times: Array
    rows: Array


Missing: TypeAlias = Mapping[str, Collection[str]]
"""Texts by column that mean that nothing was measured."""

Table: TypeAlias = tuple[dict[str, Series], Sequence[str], float | None]
"""Wanted columns of a table, its header, and the factor of its times to seconds if they have no unit of their own."""


def read_text(
    path: Path, time: str, scale: float, wanted: Collection[str], missing: Missing, *, is_ours: bool
) -> Table:
    """Return the wanted columns of a table, as far as they are there; an empty cell, or a text of `missing`, is NaN.

    `time` is the name of the column of times, and `scale` their factor to seconds; texts of ISO 8601 need none.
    Where most rows of a log of others have empty cells, each source wrote its own: a column has those that it fills.
    """
    kinds = dict.fromkeys((name for name in wanted if name != time), "signal")
    content, file = read_bytes(path), f"`{path}`"
    factor: float | None = scale
    try:
        parsed = rust.read_csv(content, file, {time: "signal", **kinds}, missing)
        times = parsed.numbers[time]
        times = (times - times[:1]) * scale  # which would be rounded coarsely if they began in 1970
    except ConfigError as refusal:
        parsed, factor = rust.read_csv(content, file, {time: "text", **kinds}, missing), None
        places = [f"column {time} in line {line} of {file}" for line in parsed.lines]
        times = stamps.seconds_of_texts(parsed.texts[time], places, str(refusal))
    numbers = {**parsed.numbers, time: times}
    table = np.column_stack(list(numbers.values()))
    is_filled = ~np.isnan(table)
    is_sparse = not is_ours and 2 * is_filled[:, is_filled.any(axis=0)].all(axis=1).sum() < len(table)
    rows = [is_filled[:, column] if is_sparse else slice(None) for column in range(table.shape[1])]
    series = {name: Series(times[own], numbers[name][own]) for name, own in zip(numbers, rows, strict=True)}
    return series, parsed.header, factor


def read_parquet(
    path: Path, time: str, scale: float, wanted: Collection[str], missing: Missing, *, is_ours: bool
) -> Table:
    """Return the wanted columns of a parquet file, as `read_text`; times of a type with a unit need no factor."""
    import pandas as pd

    del is_ours, missing
    table = read_table(path)
    header = table.column_names
    if time not in header:
        raise Refused(f"`{path}` has no column `{time}` of times{did_you_mean(time, header)}")

    def rows(name: str) -> Array:
        try:
            return np.asarray(table[name].to_numpy(), np.float64)
        except (TypeError, ValueError):
            raise Refused(f"column `{name}` of `{path}` holds no numbers") from None

    column = table[time].to_pandas()
    has_unit = column.dtype.kind not in "iuf"
    if not has_unit:
        times = rows(time)
        times = (times - times[:1]) * scale
    elif column.dtype.kind in "mM":
        times = stamps.seconds(column)
    else:
        places = [f"column `{time}` in row {row + 1} of `{path}`" for row in range(len(column))]
        texts = ["" if pd.isna(text) else str(text) for text in column]
        times = stamps.seconds_of_texts(texts, places, f"column `{time}` of `{path}` holds no times; expected numbers")
    series = {name: Series(times, times if name == time else rows(name)) for name in header if name in wanted}
    return series, header, None if has_unit else scale


TABLES = {".csv": read_text, ".tsv": read_text, ".txt": read_text, ".parquet": read_parquet}
"""Readers of tables, by suffix."""


def read_mcap(
    path: Path, named: Mapping[str, float] | None = None, *, is_ours: bool
) -> tuple[dict[str, Series], rust.Config | None, Mapping[str, Stated]]:
    """Return the numbers in the JSON messages of an MCAP file, and the configuration if `jax-aero export` wrote it.

    The time of a message is that of its recording, or that of its stamp named in `named`, with the factor to seconds of
    numbers; the stamps of every topic are returned too. Warns about messages without any.
    """
    require(["mcap"], f"reading `{path}`", "logs")
    from mcap.records import Channel, Message, Metadata

    _check_whole(path)
    ours = {f"/signals/{name}" for name in rust.signals()}
    columns: dict[str, tuple[array[float], array[float]]] = {}
    stated: dict[str, Stated] = {}
    channels: dict[int, Channel] = {}
    config, others, size = None, set(), 0
    first: int | None = None
    for record in _records(path):
        if isinstance(record, Metadata) and record.name == METADATA and "config" in record.metadata:
            config = typed_config.make_paths_absolute(parse_json(record.metadata["config"].encode()))
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            if (channel := channels.get(record.channel_id)) is None:
                raise Refused(_damaged(path, "a message without channel"))
            topic = channel.topic
            if is_ours and topic not in ours:
                continue
            if channel.message_encoding != "json":
                others.add(channel.message_encoding)
                continue
            messages = stated.setdefault(topic, Stated())
            message = _parse(record.data, f"message {messages.count + 1} of `{topic}` in `{path}`")
            time, stamp = _stamp(message, topic, named) if named else (record.log_time, None)
            if time is not None and first is None:
                first = time
            # Whole numbers of up to 104 days are exact.
            since = None if time is None else float(time - (first or 0))
            messages.add(stamp, since)
            if since is None:
                continue
            for name, number in _flatten(message, topic):
                if name not in columns:
                    columns[name] = array("d"), array("d")
                    size += 500 + len(name)
                columns[name][0].append(since)
                columns[name][1].append(number)
                size += 16
            sizes.expect("bytes of numbers", size, sizes.MAX_NUMBERS)
    if not stated:
        held = f", but in {', '.join(sorted(others))}, which PlotJuggler exports as CSV" if others else ""
        raise Refused(f"`{path}` has no message in JSON{held}; expected those of `jax-aero export`, or others in JSON")
    for topic, messages in stated.items() if named else ():
        messages.check(topic, f"`{path}`")
        if messages.times and (text := messages.describe(topic, f"`{path}`")):
            warnings.warn(f"{text}; they are left out", stacklevel=2)
    start = min((min(times) for times, _ in columns.values()), default=0.0)
    return {name: _in_order(times, numbers, start) for name, (times, numbers) in columns.items()}, config, stated


def _parse(content: bytes, what: str) -> Any:
    """Return a message in JSON, in which NaN and Infinity may be as Python's own writer has them."""
    try:
        return parse_json(content)
    except ValueError as reason:
        with suppress(ValueError, RecursionError):
            message = json.loads(content)
            check_depth(message)
            return message
        raise Refused(f"{what} is no JSON ({reason})") from None


def _stamp(message: Any, topic: str, named: Mapping[str, float]) -> tuple[int | None, Any]:
    """Return the time that a message states [ns], and the stamp, the first of those named that is one."""
    stamp = None
    for name, scale in named.items():
        if name.startswith(f"{topic}/"):
            part = stamps.find(message, name.removeprefix(f"{topic}/").split("/"))
            stamp = part if stamp is None else stamp
            if (time := stamps.nanoseconds(part, scale)) is not None:
                return time, part
    return None, stamp


def _in_order(stamps: array[float], numbers: array[float], start: float) -> Series:
    """Return a series from the stamps of messages [ns], in the order of their times."""
    times = np.asarray(stamps)
    order = np.argsort(times, kind="stable")
    return Series((times[order] - start) * 1e-9, np.asarray(numbers)[order])


def _records(path: Path) -> Iterator[Any]:
    """Yield the records of an MCAP file, whose chunks are decompressed one by one, of known size."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    try:
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=sizes.MAX_TABLE).records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                sizes.expect("bytes in a chunk", _size_of_chunk(record), sizes.MAX_PART)
                yield from breakup_chunk(record, validate_crc=True)
    except Refused as reason:
        raise Refused(f"`{path}`: {reason}") from None
    except Exception as reason:  # the package raises many types for damaged files
        raise Refused(_damaged(path, f"{type(reason).__name__}: {reason}")) from None


def _damaged(path: Path, reason: str) -> str:
    return f"`{path}` is damaged ({reason}); {_recovery(path)}"


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
