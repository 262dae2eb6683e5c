"""Recorded logs to be replayed: our NetCDF, MCAP, MATLAB and CSV, and others with a file that names their columns.

A mapping file is TOML: a table for each signal (`rust.signals`) that the log holds.

    time               = { columns = "stamp", scale = 1e-9 }
    raw_joint_position = { columns = "encoder_{}", scale = 0.0174532925199433 }   # {} is the joint's name
    raw_base_position  = { columns = ["px", "py", "pz"] }
    raw_base_quaternion = { columns = ["qw", "qx", "qy", "qz"] }                  # in place of raw_base_rotation

Columns of an MCAP file are the numbers of its JSON messages, such as `/topic/field/0`, with the times of recording or,
with `time = { columns = ["/joints/stamp", "/base/stamp"] }`, those that the messages of each topic state, in one of the
forms `stamps.FORMS`. Times with a unit of their own, as timestamps of parquet and texts of ISO 8601, need no `scale`.
Those of a MATLAB file are named in `jax_aero.view.matlab`, and have its times.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.places import did_you_mean
from jax_aero.base.terminal import ConfigError
from jax_aero.view import Refused, recording
from jax_aero.view.columns import TABLES, Series, read_mcap
from jax_aero.view.export import column_name
from jax_aero.view.formats import FORMATS as FORMATS
from jax_aero.view.formats import instead_of
from jax_aero.view.matlab import read_mat
from jax_aero.view.recording import entries_of
from jax_aero.view.stamps import FORMS, Stated

QUATERNION = "raw_base_quaternion"
"""Signal of a mapping, in the place of `raw_base_rotation`: (w, x, y, z)."""

MARKS = (99.0, 99.9, 99.99, 999.0, 999.9, 999.99, 9999.0, 9999.9, 99999.0)
"""Numbers that loggers write, with either sign, where nothing was measured."""


M = TypeVar("M", float, str)


class Source(tables.Table, frozen=True):
    """Columns of a signal in a log of others."""

    columns: str | tuple[str, ...]
    """Name of every entry, in our order; or one pattern, in which `{}` stands for the name of the entry."""
    scale: float = 1.0
    """Factor from the unit of the log to ours."""
    missing: tuple[float | str, ...] | None = None
    """Numbers, and texts of a table, where nothing was measured; without the key those of `MARKS` are refused."""

    def marks(self, kind: type[M]) -> list[M]:
        """Return the numbers or the texts where nothing was measured."""
        return [mark for mark in self.missing or () if isinstance(mark, kind)]


class Log(NamedTuple):
    """A recorded log.

    Attributes
    ----------
    signals
        Entries of every signal, in order, or one series with all of them.
    config
        Configuration that it was flown with; `None` if the log does not hold it.
    scale
        Factor of its times to seconds that the mapping states; `None` if they have a unit of their own.
    """

    signals: Mapping[str, list[Series]]
    config: rust.Config | None
    scale: float | None = None


def read(path: Path, config: rust.Config | None, mapping: Path | None = None, robot_file: str | None = None) -> Log:
    """Read a log.

    Parameters
    ----------
    path
        A result of `jax-aero fly`, or a file of `FORMATS`.
    config
        Configuration of the robot that it is of; `None` for that of the log.
    mapping
        File that names the columns; without it they are those of `jax-aero export`.
    robot_file
        File of the robot, in place of that of either configuration.

    Raises
    ------
    Refused
        For a file that cannot be read, or columns that are not there.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        if mapping is not None:
            raise Refused(f"--map is given for `{path}`; expected it with {instead_of(path)}")
        flight = recording.read(path, robot_file or (None if config is None else config["robot"]))
        series = {name: [Series(flight.signals["time"], flight.rows(name))] for name in flight.signals}
        return Log(series, flight.config)
    sources = {} if mapping is None else _load_mapping(mapping)
    columns: dict[str, Series] = {}
    own: rust.Config | None = None
    time = sources.get("time", Source(columns="time"))
    stamps = (time.columns,) if isinstance(time.columns, str) else time.columns
    stated: Mapping[str, Stated] = {}
    scale: float | None = None
    if suffix == ".mcap":
        given = dict.fromkeys(stamps, time.scale) if "time" in sources else {}
        columns, own, stated = read_mcap(path, given, is_ours=mapping is None)
        scale = time.scale if given else None
    elif suffix == ".mat":
        if "time" in sources:
            raise ConfigError.of("time", list(stamps), "none, as a MATLAB file has its own times").in_file(str(mapping))
        held, facts = read_mat(path)
        columns, own = {name: Series(*series) for name, series in held.items()}, facts.get("config")
    if config is None and own is None:
        raise Refused(f"`{path}` holds no configuration of a flight; expected --experiment NAME")
    robot = rust.Robot(robot_file or (config or own or {})["robot"])
    if suffix == ".mcap":
        sources.pop("time", None)
    named = _own_columns(robot, suffix) if mapping is None else _mapped_columns(sources, robot, mapping)
    header: Collection[str] = columns
    if suffix in TABLES:
        wanted = {name for names in named.values() for name in names}
        if len(stamps) != 1:
            raise ConfigError.of("time.columns", list(stamps), "one name").in_file(str(mapping))
        texts = {name: source.marks(str) for signal, source in sources.items() for name in named[signal]}
        columns, header, scale = TABLES[suffix](path, stamps[0], time.scale, wanted, texts, is_ours=mapping is None)
    signals = {}
    for signal, names in named.items():
        absent = [name for name in names if name not in columns]
        if absent and mapping is not None:
            for topic, messages in stated.items():
                if absent[0].startswith(f"{topic}/") and not messages.times:
                    raise _unstamped(topic, messages, absent[0], stamps, path).in_file(mapping.name)
            raise Refused(f"{mapping.name}: `{path}` has no column `{absent[0]}`{did_you_mean(absent[0], header)}")
        if not absent:
            source = None if signal == "time" else sources.get(signal)  # whose readers return seconds
            signals[signal] = [_in_our_units(columns[name], source, name, path) for name in names]
    return Log(signals, own, scale)


def _unstamped(topic: str, messages: Stated, column: str, stamps: Sequence[str], path: Path) -> ConfigError:
    """Return the refusal of a topic whose messages state no time."""
    if any(stamp.startswith(f"{topic}/") for stamp in stamps):
        return ConfigError(f"{messages.describe(topic, f'`{path}`')}; expected {FORMS}")
    return ConfigError.of("time.columns", list(stamps), f"one of each topic, also of that of `{column}`: {FORMS}")


def _in_our_units(column: Series, source: Source | None, name: str, path: Path) -> Series:
    """Return a column in SI units, with NaN for marks of a missing value; refuse what looks like one."""
    if source is None:
        return column
    rows = np.where(np.isin(column.rows, source.marks(float)), np.nan, column.rows)
    is_mark = np.isin(np.abs(rows), MARKS)
    others = np.abs(rows[np.isfinite(rows) & ~is_mark]).max(initial=0.0)
    if source.missing is None and is_mark.any() and np.abs(rows[is_mark]).min() > 2.0 * others:
        row = int(is_mark.argmax())
        what = f"column `{name}` of `{path}` is {rows[row]:g} in row {row + 1}, as where nothing was measured"
        raise Refused(f"{what}; expected `missing = [{rows[row]:g}]` in the mapping, or `missing = []` for a number")
    return Series(column.times, rows * source.scale)


def _own_columns(robot: rust.Robot, suffix: str) -> dict[str, tuple[str, ...]]:
    """Return the columns of every signal as `jax-aero export` names them."""
    columns = {}
    for name, signal in rust.signals().items():
        if signal.dims[0] == "time" and (entries := entries_of(name, robot)):
            if suffix in (".mcap", ".mat"):
                head = f"/signals/{name}" if suffix == ".mcap" else name
                columns[name] = tuple(column_name(head, entry or ("value",)) for entry in entries)
            else:
                columns[name] = tuple(column_name(name, entry) for entry in entries)
    return columns


def _load_mapping(path: Path) -> dict[str, Source]:
    table = tables.read(path)
    known = [*(name for name, signal in rust.signals().items() if signal.dims[0] == "time"), QUATERNION]
    for name in table:
        if name not in known:
            raise ConfigError(f"{path.name}: there is no signal `{name}`{did_you_mean(name, known)}")
    return tables.convert(table, dict[str, Source], path.name)


def _mapped_columns(sources: Mapping[str, Source], robot: rust.Robot, mapping: Path) -> dict[str, tuple[str, ...]]:
    """Return the columns of every signal that a mapping file names."""
    columns = {}
    for name, source in sources.items():
        entries = [(letter,) for letter in "wxyz"] if name == QUATERNION else entries_of(name, robot)
        names = source.columns
        if isinstance(names, str):
            names = tuple(names.replace("{}", "/".join(entry)) for entry in entries)
        if len(names) != len(entries):
            raise ConfigError.of(f"{name}.columns", list(names), f"{len(entries)} names").in_file(mapping.name)
        columns[name] = names
    return columns
