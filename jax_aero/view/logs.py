"""Recorded logs to be replayed: our NetCDF, MCAP and CSV, and those of others with a file that names their columns.

A mapping file is TOML: a table for each signal (`rust.signals`) that the log holds.

    time               = { columns = "stamp", scale = 1e-9 }
    raw_joint_position = { columns = "encoder_{}", scale = 0.0174532925199433 }   # {} is the joint's name
    raw_base_position  = { columns = ["px", "py", "pz"] }
    raw_base_quaternion = { columns = ["qw", "qx", "qy", "qz"] }                  # in place of raw_base_rotation

Columns of an MCAP file are the numbers of its JSON messages, such as `/topic/field/0`, with the times of its topic.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import io, rust, tables
from jax_aero.command import ConfigError
from jax_aero.files import parse_json, read_bytes
from jax_aero.places import did_you_mean
from jax_aero.view import Refused, recording, require
from jax_aero.view.export import METADATA, column_name, entries_of

Array = NDArray[np.float64]

QUATERNION = "raw_base_quaternion"
"""Signal of a mapping, in the place of `raw_base_rotation`: (w, x, y, z)."""

NEEDED = ("raw_base_position", "raw_base_rotation", "raw_base_velocity", "raw_joint_position", "raw_thrust")
"""Signals without which no flight can begin."""

PERIOD_TOLERANCE = 0.01
"""Greatest relative difference between the period of a log and that of its ticks."""

ROUNDING = 5e-7
"""Time that absorbs the rounding of times [s]."""


class Source(tables.Table, frozen=True):
    """Columns of a signal in a log of others."""

    columns: str | tuple[str, ...]
    """Name of every entry, in our order; or one pattern, in which `{}` stands for the name of the entry."""
    scale: float = 1.0
    """Factor from the unit of the log to ours."""


class Series(NamedTuple):
    """Rows of a signal, or of an entry of it, with their times [s]."""

    times: Array
    rows: Array


class Log(NamedTuple):
    """A recorded log.

    Attributes
    ----------
    signals
        Entries of every signal, in order, or one series with all of them.
    config
        Configuration that it was flown with; `None` if the log does not hold it.
    """

    signals: Mapping[str, list[Series]]
    config: rust.Config | None


def read(path: Path, config: rust.Config | None, mapping: Path | None = None) -> Log:
    """Read a log.

    Parameters
    ----------
    path
        A result of `jax-aero fly`, or a `.csv` or `.mcap` file.
    config
        Configuration of the robot that it is of; `None` for that of the log.
    mapping
        File that names the columns; without it they are those of `jax-aero export`.

    Raises
    ------
    Refused
        For a file that cannot be read, or columns that are not there.
    """
    if path.suffix not in (".csv", ".mcap"):
        if mapping is not None:
            raise Refused(f"--map is given for `{path}`; expected it with a .csv or .mcap file, whose columns it names")
        flight = recording.read(path, None if config is None else config["robot"])
        series = {name: [Series(flight.signals["time"], flight.rows(name))] for name in flight.signals}
        return Log(series, flight.config)
    read_columns = {".csv": read_csv, ".mcap": read_mcap}[path.suffix]
    columns, own = read_columns(path, mapping)
    if config is None and own is None:
        raise Refused(f"`{path}` holds no configuration of a flight; expected --experiment NAME")
    robot = rust.Robot((config or own or {})["robot"])
    if mapping is None:
        return Log(_own_signals(columns, robot, path), own)
    return Log(_mapped_signals(columns, robot, path, mapping), own)


def read_csv(path: Path, mapping: Path | None) -> tuple[dict[str, Series], None]:
    """Return the columns of a table with a header; an empty cell is NaN."""
    sources = {} if mapping is None else _load_mapping(mapping)
    time = sources.get("time", Source(columns="time"))
    name = time.columns if isinstance(time.columns, str) else next(iter(time.columns), "")
    try:
        text = read_bytes(path).decode()
        header, *lines = [row for row in csv.reader(text.splitlines()) if row]
        numbers = np.array([[float(cell) if cell.strip() else np.nan for cell in row] for row in lines], dtype=float)
        table = numbers.reshape(len(lines), len(header))
    except (OSError, ValueError, csv.Error) as reason:
        raise Refused(f"`{path}` is no table of numbers with a header ({reason})") from None
    header = [word.strip() for word in header]
    if name not in header:
        raise Refused(f"`{path}` has no column `{name}` of times{did_you_mean(name, header)}")
    times = table[:, header.index(name)]
    times = (times - times[:1]) * time.scale  # which would be rounded coarsely if they began in 1970
    return {word: Series(times, table[:, place]) for place, word in enumerate(header)}, None


def read_mcap(path: Path, mapping: Path | None) -> tuple[dict[str, Series], rust.Config | None]:
    """Return the numbers in the JSON messages of an MCAP file, and the configuration if `jax-aero export` wrote it."""
    require(["mcap"], f"reading `{path}`", "logs")
    from mcap.reader import make_reader

    topics = [f"/signals/{name}" for name in rust.signals()] if mapping is None else None
    found: dict[str, tuple[list[float], list[float]]] = {}
    config, start = None, None
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            for _schema, channel, message in reader.iter_messages(topics):
                if channel.message_encoding != "json":
                    continue
                start = message.log_time if start is None else start
                for name, number in _flatten(parse_json(message.data), channel.topic):
                    times, numbers = found.setdefault(name, ([], []))
                    times.append((message.log_time - start) * 1e-9)
                    numbers.append(number)
            for record in reader.iter_metadata():
                if record.name == METADATA and "config" in record.metadata:
                    config = io.make_paths_absolute(json.loads(record.metadata["config"]))
    except Exception as reason:  # the package raises many types for damaged files
        raise Refused(f"`{path}` cannot be read ({type(reason).__name__}: {reason}); expected an MCAP file") from None
    if not found:
        raise Refused(f"`{path}` has no message in JSON; expected those of `jax-aero export`, or others in JSON")
    return {name: Series(np.array(times), np.array(numbers)) for name, (times, numbers) in found.items()}, config


def _flatten(part: Any, name: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message with their paths; null is NaN."""
    if isinstance(part, dict | list):
        for key, inner in part.items() if isinstance(part, dict) else enumerate(part):
            yield from _flatten(inner, f"{name}/{key}")
    elif part is None or isinstance(part, int | float):
        yield name, np.nan if part is None else float(part)


def _own_signals(columns: Mapping[str, Series], robot: rust.Robot, path: Path) -> dict[str, list[Series]]:
    """Return the signals that `jax-aero export` wrote."""
    found = {}
    for name, signal in rust.signals().items():
        if signal.dims[0] != "time":
            continue
        entries = entries_of(name, robot)
        if path.suffix == ".mcap":
            names = [column_name(f"/signals/{name}", entry or ("value",)) for entry in entries]
        else:
            names = [column_name(name, entry) for entry in entries]
        if names and all(column in columns for column in names):
            found[name] = [columns[column] for column in names]
    return found


def _load_mapping(path: Path) -> dict[str, Source]:
    table = tables.read(path)
    known = [*(name for name, signal in rust.signals().items() if signal.dims[0] == "time"), QUATERNION]
    for name in table:
        if name not in known:
            raise ConfigError(f"{path.name}: there is no signal `{name}`{did_you_mean(name, known)}")
    return tables.convert(table, dict[str, Source], path.name)


def _mapped_signals(
    columns: Mapping[str, Series], robot: rust.Robot, path: Path, mapping: Path
) -> dict[str, list[Series]]:
    """Return the signals that a mapping file names."""
    found = {}
    for name, source in _load_mapping(mapping).items():
        entries = [(letter,) for letter in "wxyz"] if name == QUATERNION else entries_of(name, robot)
        names = source.columns
        if isinstance(names, str):
            names = tuple(names.replace("{}", "/".join(entry)) for entry in entries)
        if len(names) != len(entries):
            raise ConfigError.of(f"{name}.columns", list(names), f"{len(entries)} names").in_file(mapping.name)
        for column in names:
            if column not in columns:
                raise Refused(f"{mapping.name}: `{path}` has no column `{column}`{did_you_mean(column, columns)}")
        found[name] = [Series(columns[column].times, columns[column].rows * source.scale) for column in names]
    return found


def at_ticks(log: Log, robot: rust.Robot, period: float, path: Path) -> dict[str, Array]:
    """Return every signal at the ticks of a controller, from time zero.

    A log with this period [s] has a tick in every row. In a faster one a tick has the last values until then; entries
    that are slower are held too.

    Raises
    ------
    Refused
        For a log that lacks a signal without which no flight can begin, or whose times do not increase.
    """
    there = {*log.signals} | ({"raw_base_rotation"} if QUATERNION in log.signals else set())
    if lacking := [name for name in NEEDED if name not in there]:
        raise Refused(f"`{path}` has no {', '.join(f'`{name}`' for name in lacking)}; expected what a tick is given")
    base = log.signals["raw_joint_position"][0].times
    if base.size == 0 or not np.all(np.diff(base, prepend=-np.inf) > 0.0) or not np.isfinite(base[-1]):
        raise Refused(f"times in `{path}` do not increase from row to row")
    ticks, is_denser = base, base.size > 1 and np.mean(np.diff(base)) < (1.0 - PERIOD_TOLERANCE) * period
    if is_denser:
        ticks = base[0] + period * np.arange(int((base[-1] - base[0] + ROUNDING) / period) + 1)
    found = {}
    for name, series in log.signals.items():
        rows = np.concatenate([np.reshape(_hold(one, ticks), (ticks.size, -1)) for one in series], axis=1)
        if name == QUATERNION:
            found["raw_base_rotation"] = rust.rotation_from_wxyz(rows)
        else:
            shape = [len(names) for names in recording.axes_of(name, robot)]
            found[name] = rows.reshape(ticks.size, *shape)
    # The times of ticks are those of the rows, and not of a message about them.
    times = ticks if is_denser or "time" not in found else found["time"]
    return found | {"time": times - times[0]}


def _hold(series: Series, ticks: Array) -> Array:
    """Return the last row until each tick; NaN before the first."""
    place = np.searchsorted(series.times, ticks + ROUNDING, side="right") - 1
    return np.where((place < 0).reshape(-1, *[1] * (series.rows.ndim - 1)), np.nan, series.rows[np.maximum(place, 0)])
