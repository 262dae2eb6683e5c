"""Recorded logs to be replayed: our NetCDF, MCAP, MATLAB and CSV, and others with a file that names their columns.

A mapping file is TOML: a table for each signal (`rust.signals`) that the log holds.

    time               = { columns = "stamp", scale = 1e-9 }
    raw_joint_position = { columns = "encoder_{}", scale = 0.0174532925199433 }   # {} is the joint's name
    raw_base_position  = { columns = ["px", "py", "pz"] }
    raw_base_quaternion = { columns = ["qw", "qx", "qy", "qz"] }                  # in place of raw_base_rotation

Columns of an MCAP file are the numbers of its JSON messages, such as `/topic/field/0`, with the times of recording or,
with `time = { columns = ["/joints/stamp", "/base/stamp"] }`, those that the messages of each topic state, in one of the
forms `columns.FORMS`. Times with a unit of their own, as timestamps of parquet and texts of ISO 8601, need no `scale`.
Those of a MATLAB file are named in `jax_aero.view.matlab`, and have its times.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.places import did_you_mean
from jax_aero.base.terminal import ConfigError
from jax_aero.body.spatial import wxyz_from_rotation
from jax_aero.view import Refused, recording
from jax_aero.view.columns import FORMS, TABLES, Array, Series, read_mcap
from jax_aero.view.export import column_name
from jax_aero.view.formats import FORMATS as FORMATS
from jax_aero.view.formats import instead_of
from jax_aero.view.matlab import read_mat
from jax_aero.view.recording import Recording, entries_of

QUATERNION = "raw_base_quaternion"
"""Signal of a mapping, in the place of `raw_base_rotation`: (w, x, y, z)."""

NEEDED = ("raw_base_position", "raw_base_rotation", "raw_base_velocity", "raw_joint_position", "raw_thrust")
"""Signals without which no flight can begin."""

MEASURED = ("base_position", "base_velocity", "joint_position", "joint_velocity", "thrust", "wind")
"""Signals that are viewed as they were measured, with `raw_` before the name, where a log has nothing better."""

PERIOD_TOLERANCE = 0.01
"""Greatest relative difference between the period of a log and that of its ticks."""

ROUNDING = 5e-7
"""Time that absorbs the rounding of times [s]."""

HELD = 1.5
"""Longest time for which a row is held, in periods of its topic or of the ticks; after it there is no measurement."""

LATE = 10
"""Number of rows within which a late row is followed by early ones; otherwise rows were lost."""

FEW = 5
"""Number of rows over which a first guess of their period is taken, among which few have a lost one."""

LEAST_STEP, LEAST_TICKS = 2e-4, 10
"""Least time between two rows [s], and number of ticks: with less, times have another unit."""

LONGEST_GAP = 60.0
"""Longest time between two rows of one flight [s]."""

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


class Ticks(NamedTuple):
    """Signals of a log at the ticks of a controller.

    Attributes
    ----------
    signals
        Every signal; NaN where the log holds none.
    is_recorded
        Whether the log has a row for a tick, (n,).
    """

    signals: dict[str, Array]
    is_recorded: NDArray[np.bool_]


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
    unstamped: Collection[str] = ()
    scale: float | None = None
    if suffix == ".mcap":
        given = dict.fromkeys(stamps, time.scale) if "time" in sources else {}
        columns, own, unstamped = read_mcap(path, given, is_ours=mapping is None)
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
            if any(absent[0].startswith(f"{topic}/") for topic in unstamped):
                expected = f"one of each topic, also of that of `{absent[0]}`: {FORMS}"
                raise ConfigError.of("time.columns", list(stamps), expected).in_file(mapping.name)
            raise Refused(f"{mapping.name}: `{path}` has no column `{absent[0]}`{did_you_mean(absent[0], header)}")
        if not absent:
            source = None if signal == "time" else sources.get(signal)  # whose readers return seconds
            signals[signal] = [_in_our_units(columns[name], source, name, path) for name in names]
    return Log(signals, own, scale)


def read_flight(path: Path, config: rust.Config | None, mapping: Path | None, robot_file: str | None) -> Recording:
    """Return a log, given as in `read`, as a flight to view: with what was measured where it lacks the true state."""
    log = read(path, config, mapping, robot_file)
    config = config or log.config
    assert config is not None  # which `read` refuses
    place = Path(robot_file or config["robot"])
    robot = rust.Robot(place)
    found, is_recorded = at_ticks(log, robot, float(config["controller"]["time_step"]), path)
    signals = {name: rows[is_recorded] for name, rows in found.items()}
    signals = {name: _filled(signals[f"raw_{name}"]) for name in MEASURED if f"raw_{name}" in signals} | signals
    signals.setdefault("base_quaternion", np.asarray(wxyz_from_rotation(_filled(signals["raw_base_rotation"]))))
    if "com_position" not in signals:
        rotations, still = rust.rotation_from_wxyz(signals["base_quaternion"]), np.zeros(6 + len(robot.joint_names))
        poses = zip(signals["base_position"], rotations, signals["joint_position"], strict=True)
        signals["com_position"] = np.array(
            [rust.dynamics(robot, rust.State(*pose, still)).com_position for pose in poses]
        )
    signals.setdefault("com_setpoint", signals["com_position"])
    return Recording(
        title=path.stem,
        signals=recording.with_zeros(signals, robot),
        robot=robot,
        robot_path=place,
        outcome="logged",
        lost_time=None,
        lost_reason=None,
        config=config,
    )


def _filled(rows: Array) -> Array:
    """Return rows in which what is not a number is that of the last row with one, or zero."""
    is_known = np.isfinite(rows.reshape(len(rows), -1)).all(axis=1)
    return np.nan_to_num(rows[np.maximum.accumulate(np.where(is_known, np.arange(len(rows)), 0))])


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
    found = {}
    for name, signal in rust.signals().items():
        if signal.dims[0] == "time" and (entries := entries_of(name, robot)):
            if suffix in (".mcap", ".mat"):
                head = f"/signals/{name}" if suffix == ".mcap" else name
                found[name] = tuple(column_name(head, entry or ("value",)) for entry in entries)
            else:
                found[name] = tuple(column_name(name, entry) for entry in entries)
    return found


def _load_mapping(path: Path) -> dict[str, Source]:
    table = tables.read(path)
    known = [*(name for name, signal in rust.signals().items() if signal.dims[0] == "time"), QUATERNION]
    for name in table:
        if name not in known:
            raise ConfigError(f"{path.name}: there is no signal `{name}`{did_you_mean(name, known)}")
    return tables.convert(table, dict[str, Source], path.name)


def _mapped_columns(sources: Mapping[str, Source], robot: rust.Robot, mapping: Path) -> dict[str, tuple[str, ...]]:
    """Return the columns of every signal that a mapping file names."""
    found = {}
    for name, source in sources.items():
        entries = [(letter,) for letter in "wxyz"] if name == QUATERNION else entries_of(name, robot)
        names = source.columns
        if isinstance(names, str):
            names = tuple(names.replace("{}", "/".join(entry)) for entry in entries)
        if len(names) != len(entries):
            raise ConfigError.of(f"{name}.columns", list(names), f"{len(entries)} names").in_file(mapping.name)
        found[name] = names
    return found


def at_ticks(log: Log, robot: rust.Robot, period: float, path: Path, *, also: Sequence[str] = ()) -> Ticks:
    """Return every signal at the ticks of a controller, from time zero: when all that a flight begins with is measured.

    A log with this period [s] has a tick in every row, and ticks without a measurement where rows were lost. In a
    faster one a tick has the last values until then. Entries that are slower are held for `HELD` of their periods.
    Signals of `also` are needed too.

    Warns about lost rows, and about rows with the time of the next one, which count as lost.

    Raises
    ------
    Refused
        For a log that lacks a signal without which no flight can begin, whose times decrease, or that has few of the
        ticks between its first and its last one.
    """
    needed = [QUATERNION if name not in log.signals and name == "raw_base_rotation" else name for name in NEEDED]
    needed = [name for name in [*needed, *also] if robot.joint_names or "joint" not in name]
    if lacking := [name for name in needed if name not in log.signals]:
        names = ", ".join(f"`{name}`" for name in lacking).replace(QUATERNION, "raw_base_rotation")
        raise Refused(f"`{path}` has no {names}; expected what a tick is given")
    stamps = log.signals["raw_joint_position" if robot.joint_names else "raw_base_position"][0].times
    unit = _likely_unit(log.scale, _typical_step(stamps), period)
    rows = _check_times(stamps, path, unit)
    spans = [(*_span(one, name, path), name) for name in needed for one in log.signals[name]]
    (begin, last, late), (first, end, early) = max(spans), min(spans, key=lambda span: span[1])
    if begin > end:
        what = f"`{early}` ({first:g} to {end:g} s) and `{late}` ({begin:g} to {last:g} s)"
        raise Refused(f"{what} of `{path}` do not overlap; expected times of one clock")
    rows = rows[rows >= min(begin, rows[-1])]
    most = LATE * rows.size + int(LONGEST_GAP / period)
    if (rows[-1] - rows[0]) / period > most:
        raise Refused(
            f"`{path}` has {rows.size} rows in {rows[-1] - rows[0]:g} s; expected one in most of {period:g} s{unit}"
        )
    typical = _fitted_step(rows)
    if typical < LEAST_STEP:
        what = f"`{path}` has {rows.size} rows in {rows[-1] - rows[0]:g} s, {typical:g} s from one to the next"
        raise Refused(f"{what}; expected at least {LEAST_STEP:g} s{unit}")
    if is_denser := typical < (1.0 - PERIOD_TOLERANCE) * period:
        ticks = rows[0] + period * np.arange(int((rows[-1] - rows[0] + ROUNDING) / period) + 1)
        is_lost = np.zeros(ticks.size, dtype=np.bool_)
    elif typical <= (1.0 + PERIOD_TOLERANCE) * period:
        ticks, is_lost = _add_lost(rows, period)
    else:  # which no controller of this period replays
        ticks, is_lost = rows, np.zeros(rows.size, dtype=np.bool_)
    if ticks.size < LEAST_TICKS:
        what = f"`{path}` has {ticks.size} ticks of {period:g} s, of {rows.size} rows in {rows[-1] - rows[0]:g} s"
        raise Refused(f"{what}; expected at least {LEAST_TICKS} ticks{unit}")
    # A row less than half a period before the tick of a lost one is another one's.
    held = np.where(is_lost, 0.5, HELD)
    is_recorded = ticks - rows[_last_row(rows, ticks)] <= held * period
    if not is_recorded.all():
        warnings.warn(_describe_gaps(stamps, ticks, is_recorded, path), stacklevel=2)
    found = {}
    for name, series in log.signals.items():
        entries = [_hold(one, ticks, held * max(period, _typical_step(one.times))) for one in series]
        flat = np.concatenate([entry.reshape(ticks.size, -1) for entry in entries], axis=1)
        if name == QUATERNION:
            if (zero := np.flatnonzero(~flat.any(axis=1))).size:
                where = f"`{QUATERNION}` of `{path}` is 0 0 0 0 at {ticks[zero[0]]:g} s, in {zero.size} ticks"
                raise Refused(f"{where}; expected a rotation, or nothing where it is not measured")
            found["raw_base_rotation"] = rust.rotation_from_wxyz(flat)
        else:
            shape = [len(names) for names in recording.axes_of(name, robot)]
            found[name] = flat.reshape(ticks.size, *shape)
    if not robot.joint_names:
        found["raw_joint_position"] = np.zeros((ticks.size, 0))
    times = ticks - ticks[0]
    if not is_denser and "time" in found:
        # The stamps of messages are rounded, the times that they state are not.
        stated = np.where(is_lost, times, found["time"] - found["time"][0])
        times = stated if np.all(np.abs(stated - times) < ROUNDING) else times
    return Ticks(found | {"time": times}, is_recorded)


def _likely_unit(scale: float | None, step: float, period: float) -> str:
    """Return the unit, as a question, in which steps [s] of rows would be near the period [s], if it is another one."""
    thousands = round(np.log10(period / step) / 3.0) if 0.0 < step < np.inf else 0
    if scale is None or thousands == 0:
        return ""
    name = {0: "s", -1: "ms", -2: "us", -3: "ns"}.get(thousands + round(np.log10(scale) / 3.0), "another unit")
    return f" (times in {name}?)"


def _check_times(times: Array, path: Path, unit: str) -> Array:
    """Return the times of rows without those that the next row repeats, which are warned about."""
    if times.size == 0:
        raise Refused(f"`{path}` has no row")
    if not np.isfinite(times).all():
        raise Refused(f"row {np.isfinite(times).argmin() + 1} of `{path}` has no time")
    steps = np.diff(times)
    for is_wrong, expected in (
        (steps < 0.0, "times that increase"),
        (steps > LONGEST_GAP, f"at most {LONGEST_GAP:g} s"),
    ):
        if is_wrong.any():
            row = int(is_wrong.argmax())
            what = f"row {row + 2} of `{path}` is {steps[row]:g} s after the one at {times[row]:g} s"
            # Without the row whose time is wrong, its neighbours are two steps apart.
            step = _typical_step(times)
            over = np.concatenate([[3.0 * step], times[2:] - times[:-2], [3.0 * step]])[row : row + 2]
            first, second = np.abs(over - 2.0 * step)
            if first < 0.5 * second:
                what = f"row {row + 1} of `{path}`, at {times[row]:g} s, is {-steps[row]:g} s after the next one"
            raise Refused(f"{what}; expected {expected} between the rows of a flight{unit}")
    if (doubled := np.flatnonzero(steps == 0.0)).size:
        more = f", and {doubled.size - 1} more do so" if doubled.size > 1 else ""
        what = f"row {doubled[0] + 2} of `{path}` repeats the time of the row before, {times[doubled[0]]:g} s{more}"
        if 2 * doubled.size > times.size:
            expected = "times of measurement, which `time = { columns = … }` of --map may name"
            raise Refused(f"{what}, as times of recording in bursts; expected {expected}")
        warnings.warn(f"{what}; the later one is used", stacklevel=3)
    later: Array = times[np.append(steps > 0.0, True)]
    return later


def _span(series: Series, name: str, path: Path) -> tuple[float, float]:
    """Return the times of the first and the last row with a number [s]."""
    is_measured = ~np.isnan(series.rows.reshape(len(series.times), -1)).any(axis=1)
    if not is_measured.any():
        raise Refused(f"`{path}` has no number of `{name}`, without which no flight begins")
    if np.any(np.diff(series.times) < 0.0):
        raise Refused(f"the times of `{name}` in `{path}` decrease; expected times that increase")
    times = series.times[is_measured]
    return float(times[0]), float(times[-1])


def _typical_step(times: Array) -> float:
    """Return the median time from row to row [s]; infinite for a single row."""
    return float(np.median(np.diff(times))) if times.size > 1 else np.inf


def _fitted_step(times: Array) -> float:
    """Return the time from row to row [s] between the first and the last one, in which lost rows count."""
    if times.size < 2:
        return np.inf
    few = min(FEW, times.size - 1)
    rough = float(np.median(times[few:] - times[:-few])) / few
    return float(times[-1] - times[0]) / (_add_lost(times, rough)[0].size - 1)


def _add_lost(rows: Array, period: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the times of rows, with those of lost ones in between, and which ones were lost.

    As many were lost before a row as it and the next `LATE` rows are later, in periods, than the row before it; of the
    last rows, which have fewer after them, than all of those before it.
    """
    late = (rows - rows[0]) / period - np.arange(rows.size)
    windows = np.lib.stride_tricks.sliding_window_view
    after = windows(np.pad(late[1:], (0, LATE), constant_values=np.inf), LATE + 1).min(axis=1)
    before = late[:-1].copy()
    before[-LATE:] = windows(np.pad(before, (LATE, 0), constant_values=-np.inf), LATE + 1).max(axis=1)[-LATE:]
    lost = np.append(np.maximum(np.rint(after - before), 0.0).astype(int), 0)
    steps = np.append(np.diff(rows), 0.0) / (lost + 1)
    row = np.repeat(np.arange(rows.size), lost + 1)
    number = np.arange(row.size) - np.searchsorted(row, row)
    return rows[row] + number * steps[row], number > 0


def _describe_gaps(stamps: Array, ticks: Array, is_recorded: NDArray[np.bool_], path: Path) -> str:
    edges = np.flatnonzero(np.diff(is_recorded, prepend=True, append=True))
    begin, end = edges[:2]
    after = int(_last_row(stamps, ticks[begin : begin + 1])[0])
    others = np.count_nonzero(~is_recorded) - (end - begin)
    more = f", and for {others} in {edges.size // 2 - 1} other places" if others else ""
    what = f"`{path}` has no row for {end - begin} ticks after row {after + 1} at {stamps[after]:g} s{more}"
    return f"{what}; they are replayed as ticks without a measurement"


def _last_row(times: Array, ticks: Array) -> NDArray[np.int64]:
    """Return the place of the last row until each tick; −1 before the first."""
    return np.searchsorted(times, ticks + ROUNDING, side="right") - 1


def _hold(series: Series, ticks: Array, longest: Array) -> Array:
    """Return the last row until each tick; NaN before the first, and after the longest time since it [s]."""
    place = _last_row(series.times, ticks)
    held: Array = series.rows[place]
    held[(place < 0) | (ticks - series.times[place] > longest)] = np.nan
    return held
