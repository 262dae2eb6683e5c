"""Columns of numbers in recorded logs, with their times: tables of text, parquet files, JSON messages of MCAP files."""

from __future__ import annotations

import shlex
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import sizes, typed_config
from jax_aero.base.files import parse_json, read_bytes
from jax_aero.base.parquet import read_table
from jax_aero.base.places import did_you_mean
from jax_aero.base.terminal import ConfigError
from jax_aero.view import Refused, require
from jax_aero.view.export import METADATA

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
        found = rust.read_csv(content, file, {time: "signal", **kinds}, missing)
        times = found.numbers[time]
        times = (times - times[:1]) * scale  # which would be rounded coarsely if they began in 1970
    except ConfigError as refusal:
        found, factor = rust.read_csv(content, file, {time: "text", **kinds}, missing), None
        times = _seconds(found.texts[time], f"{refusal}, or ISO 8601")
    numbers = {**found.numbers, time: times}
    table = np.column_stack(list(numbers.values()))
    is_filled = ~np.isnan(table)
    is_sparse = not is_ours and 2 * is_filled[:, is_filled.any(axis=0)].all(axis=1).sum() < len(table)
    rows = [is_filled[:, column] if is_sparse else slice(None) for column in range(table.shape[1])]
    series = {name: Series(times[own], numbers[name][own]) for name, own in zip(numbers, rows, strict=True)}
    return series, found.header, factor


def _seconds(moments: Any, refusal: str) -> Array:
    """Return timestamps, durations, or texts of ISO 8601, as times from the first [s]."""
    import pandas as pd

    try:
        column = pd.Series(moments)
        column = column if column.dtype.kind in "mM" else pd.to_datetime(column, format="ISO8601", utc=True)
    except (TypeError, ValueError) as reason:
        raise Refused(f"{refusal} ({str(reason).splitlines()[0]})") from None
    return np.asarray((column - column.iloc[0]).dt.total_seconds())


def read_parquet(
    path: Path, time: str, scale: float, wanted: Collection[str], missing: Missing, *, is_ours: bool
) -> Table:
    """Return the wanted columns of a parquet file, as `read_text`; times of a type with a unit need no factor."""
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
    times = _seconds(column, f"column `{time}` of `{path}` holds no times") if has_unit else rows(time)
    times = times if has_unit else (times - times[:1]) * scale
    series = {name: Series(times, times if name == time else rows(name)) for name in header if name in wanted}
    return series, header, None if has_unit else scale


TABLES = {".csv": read_text, ".tsv": read_text, ".txt": read_text, ".parquet": read_parquet}
"""Readers of tables, by suffix."""

STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Names of seconds and nanoseconds in stamps of ROS 2, Foxglove, ROS 1 and protocol buffers."""

FORMS = f"a number, {', '.join(' with '.join(pair) for pair in STAMPS)}, or a text of ISO 8601"
"""What a stamp may be."""


def read_mcap(
    path: Path, stamps: Mapping[str, float] | None = None, *, is_ours: bool
) -> tuple[dict[str, Series], rust.Config | None, Collection[str]]:
    """Return the numbers in the JSON messages of an MCAP file, and the configuration if `jax-aero export` wrote it.

    The time of a message is that of its recording, or of its number named in `stamps`, with the factor to seconds; the
    topics of messages without any are returned too.
    """
    require(["mcap"], f"reading `{path}`", "logs")
    from mcap.records import Channel, Message, Metadata

    _check_whole(path)
    topics = {f"/signals/{name}" for name in rust.signals()}
    found: dict[str, tuple[array[int], array[float]]] = {}
    unstamped: set[str] = set()
    channels: dict[int, Channel] = {}
    config, others, size = None, set(), 0
    try:
        for record in _records(path):
            if isinstance(record, Metadata) and record.name == METADATA and "config" in record.metadata:
                config = typed_config.make_paths_absolute(parse_json(record.metadata["config"].encode()))
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                if is_ours and channel.topic not in topics:
                    continue
                if channel.message_encoding != "json":
                    others.add(channel.message_encoding)
                    continue
                message = parse_json(record.data)
                numbers = dict(_flatten(message, channel.topic))
                time = next(_stamps(message, channel.topic, numbers, stamps), None) if stamps else record.log_time
                if time is None:
                    unstamped.add(channel.topic)
                    continue
                for name, number in numbers.items():
                    if name not in found:
                        found[name] = array("q"), array("d")
                        size += 500 + len(name)
                    found[name][0].append(time)
                    found[name][1].append(number)
                    size += 16
                sizes.expect("bytes of numbers", size, sizes.MAX_NUMBERS)
    except Exception as reason:  # the package raises many types for damaged files
        what = f"({type(reason).__name__}: {reason})"
        raise Refused(f"`{path}` is damaged {what}; {_recovery(path)}") from None
    if not found and not unstamped:
        held = f", but in {', '.join(sorted(others))}, which PlotJuggler exports as CSV" if others else ""
        raise Refused(f"`{path}` has no message in JSON{held}; expected those of `jax-aero export`, or others in JSON")
    start = min((min(times) for times, _ in found.values()), default=0)
    return {name: _in_order(times, numbers, start) for name, (times, numbers) in found.items()}, config, unstamped


def _stamps(message: Any, topic: str, numbers: Mapping[str, float], stamps: Mapping[str, float]) -> Iterator[int]:
    """Yield the times that a message states [ns], which would be rounded coarsely in seconds since 1970."""
    for name, scale in stamps.items():
        number = numbers.get(name, np.nan)
        if np.isfinite(number):
            yield round(number * scale * 1e9)
        for units in STAMPS:
            whole, part = (numbers.get(f"{name}/{unit}", np.nan) for unit in units)
            if np.isfinite(whole + part):
                yield int(whole) * 10**9 + int(part)
        text = message
        for key in name.removeprefix(f"{topic}/").split("/"):
            text = text.get(key) if isinstance(text, dict) else None
        if isinstance(text, str):
            import pandas as pd

            with suppress(ValueError):
                yield int(pd.Timestamp(text).value)


def _in_order(stamps: array[int], numbers: array[float], start: int) -> Series:
    """Return a series from the stamps of messages [ns], in the order of their times."""
    times = np.asarray(stamps, np.int64)
    order = np.argsort(times, kind="stable")
    return Series((times[order] - start).astype(np.float64) * 1e-9, np.asarray(numbers)[order])


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
