"""Signals of a log at the ticks of a controller: what `replay`, `identify` and viewers read of it.

Times become ticks, lost rows ticks without a measurement, and rotations of few digits rotations.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.body.spatial import nearest_rotation, wxyz_from_rotation
from jax_aero.view import Refused, recording
from jax_aero.view.columns import Array, Series
from jax_aero.view.logs import QUATERNION, Log, read
from jax_aero.view.recording import Recording

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

EXACT, ROUNDED = 1e-12, 0.01
"""Greatest deviation of `RᵀR` from the identity in a flight's own rotations, and greatest change of an entry by which a
matrix becomes a rotation: two decimals are up to 0.008 off."""

BEYOND = 3.0
"""Angle of a joint that no robot has, in its stops, or in 0.5 rad where they are narrower."""

OFTEN = 0.05
"""Share of the rows with such angles in which they are no outliers, but of another unit."""


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


def of_controller(log: Log, config: rust.Config, path: Path, *, also: Sequence[str] = ()) -> Ticks:
    """Return every signal of a log at the ticks of a flight's torques, as `at_ticks`.

    Raises
    ------
    Refused
        As `at_ticks`, for joints whose angles are none in radians, and for wrenches of the feet that are only named as
        those of a simulated world.
    """
    if "foot_wrench" in log.signals and "raw_foot_wrench" not in log.signals:
        what = f"`{path}` has `foot_wrench`, the wrenches of a simulated world"
        raise Refused(f"{what}, but not what was measured; expected `raw_foot_wrench`, which a map can name")
    controller, robot = config["controller"], rust.Robot(config["robot"])
    period = float(controller["time_step"]) / int(rust.resolve_config(config)["controller"]["torque"]["steps"])
    ticks = at_ticks(on_its_feet(log, config), robot, period, path, also=also)
    angles = np.abs(ticks.signals["raw_joint_position"])
    often = np.nanquantile(angles, 1.0 - OFTEN, axis=0)
    for name, angle, most, (low, high) in zip(robot.joint_names, often, beyond(robot), robot.joint_stops, strict=True):
        if angle > most:
            what = f"`raw_joint_position` of `{name}` in `{path}` is often {angle:g}"
            raise Refused(f"{what}; expected {low:g} to {high:g} (deg?)")
    return ticks


def beyond(robot: rust.Robot) -> Array:
    """Return the angles of joints that no robot has [rad]."""
    most: Array = BEYOND * np.abs(np.reshape(robot.joint_stops, (-1, 2))).max(axis=1, initial=0.5)
    return most


def on_its_feet(log: Log, config: rust.Config) -> Log:
    """Return a log with what a standing robot need not measure.

    The base follows from the joints, the first sole being flat and at rest at the origin of the inertial axes; jets
    that the controller does not use have no thrust.
    """
    controller, signals = config["controller"], dict(log.signals)
    if not controller.get("use_jets", True) and "raw_thrust" not in signals and "raw_joint_position" in signals:
        times = signals["raw_joint_position"][0].times
        signals["raw_thrust"] = [Series(times, np.zeros((times.size, len(rust.Robot(config["robot"]).jet_names))))]
    base = ("raw_base_position", "raw_base_rotation", "raw_base_velocity")
    joints = ("raw_joint_position", "raw_joint_velocity")
    if "contact" not in controller or signals.keys() & {*base, QUATERNION} or not signals.keys() >= {*joints}:
        return log._replace(signals=signals)
    from jax_aero.mujoco.leg_odometry import LegOdometry

    times = signals["raw_joint_position"][0].times
    positions, rates = (np.column_stack([entry.rows for entry in signals[name]]) for name in joints)
    legs = LegOdometry.on_first_sole(config["robot"], controller["contact"]["feet"])
    still = np.zeros(6)
    states = [
        legs.measure(rust.State(still[:3], np.eye(3), position, np.concatenate([still, rate])))
        for position, rate in zip(positions, rates, strict=True)
    ]
    rest = (
        [np.asarray(state.base_position) for state in states],
        [np.asarray(state.base_rotation).ravel() for state in states],
        [np.asarray(state.velocity)[:6] for state in states],
    )
    signals |= {name: [Series(times, np.array(rows))] for name, rows in zip(base, rest, strict=True)}
    return log._replace(signals=signals)


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
    lacking = [name for name in needed if name not in log.signals]
    of_rows = ["raw_joint_position" if robot.joint_names else "raw_base_position", *needed]
    if named := [name for name in of_rows if name in log.signals]:
        stamps = log.signals[named[0]][0].times
        unit = _likely_unit(log.scale, _typical_step(stamps), period)
        rows = _check_times(stamps, path, unit)
    if lacking:
        names = ", ".join(f"`{name}`" for name in lacking).replace(QUATERNION, "raw_base_rotation")
        raise Refused(f"`{path}` has no {names}; expected what a tick is given")
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
    signals = {}
    for name, series in log.signals.items():
        entries = [_hold(one, ticks, held * max(period, _typical_step(one.times))) for one in series]
        flat = np.concatenate([entry.reshape(ticks.size, -1) for entry in entries], axis=1)
        if name in (QUATERNION, "raw_base_rotation"):
            signals["raw_base_rotation"] = _rotations(flat, name, ticks, stamps, path)
        else:
            shape = [len(names) for names in recording.axes_of(name, robot)]
            signals[name] = flat.reshape(ticks.size, *shape)
    if not robot.joint_names:
        signals["raw_joint_position"] = np.zeros((ticks.size, 0))
    times = ticks - ticks[0]
    if not is_denser and "time" in signals:
        # The stamps of messages are rounded, the times that they state are not.
        stated = np.where(is_lost, times, signals["time"] - signals["time"][0])
        times = stated if np.all(np.abs(stated - times) < ROUNDING) else times
    return Ticks(signals | {"time": times}, is_recorded)


def _rotations(flat: Array, name: str, ticks: Array, stamps: Array, path: Path) -> Array:
    """Return the rotations (n, 3, 3) of quaternions (n, 4), or of matrices (n, 9) that may be printed with few digits.

    Quaternions of any length but zero are rotations; of a matrix the nearest rotation is taken. NaN stays NaN.
    """
    if name == QUATERNION:
        is_none, rotations = ~flat.any(axis=1), rust.rotation_from_wxyz(flat)
    else:
        rotations = flat.reshape(-1, 3, 3).copy()
        error = np.abs(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3)).max(axis=(1, 2))
        is_rounded = (error > EXACT) | (np.linalg.det(np.nan_to_num(rotations)) < 0.0)  # not where it is NaN
        rotations[is_rounded] = nearest_rotation(rotations[is_rounded])
        is_none = np.abs(rotations.reshape(flat.shape) - flat).max(axis=1) > ROUNDED
    if (places := np.flatnonzero(is_none)).size:
        time, numbers = ticks[places[0]], " ".join(f"{number:g}" for number in flat[places[0]])
        row = int(np.searchsorted(stamps, time + ROUNDING))
        what = f"`{name}` of `{path}` is {numbers} in row {row} at {time:g} s, and no rotation in {places.size} ticks"
        raise Refused(f"{what}; expected one, or nothing where it is not measured")
    return rotations


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


def read_flight(path: Path, config: rust.Config | None, mapping: Path | None, robot_file: str | None) -> Recording:
    """Return a log, given as in `read`, as a flight to view: with what was measured where it lacks the true state."""
    log = read(path, config, mapping, robot_file)
    config = config or log.config
    assert config is not None  # which `read` refuses
    config = {**config, "robot": str(robot_file or config["robot"])}
    place = Path(config["robot"])
    robot = rust.Robot(place)
    measured, is_recorded = of_controller(log, config, path)
    signals = {name: rows[is_recorded] for name, rows in measured.items()}
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
