"""A flight to view: read from a result of `jax-aero fly`, or just flown."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import documents, typed_config
from jax_aero.base.files import find_damaged, read_json
from jax_aero.base.places import MANIFEST_FILE, RESULTS, RUN_FILE
from jax_aero.base.result import ending, labels_of
from jax_aero.base.terminal import ConfigError
from jax_aero.body.urdf import Vector
from jax_aero.view import Refused, require
from jax_aero.view.formats import instead_of
from jax_aero.view.shapes import Look, look_of

SIGNALS = (
    "time",
    "base_position",
    "base_quaternion",
    "base_rpy_setpoint",
    "joint_position",
    "com_position",
    "com_velocity",
    "com_setpoint",
    "rotation_error",
    "thrust",
    "wind",
    "aero_force_sim",
)
"""Signals that `run.nc` must contain; `rust.signals` declares units and meaning of all signals."""


class Instant(NamedTuple):
    """One time of a flight; inertial axes.

    Attributes
    ----------
    time
        Time [s].
    body_positions, body_rotations
        Origins [m], (bodies, 3), and `i_from_b`, (bodies, 3, 3), in the order of `Robot.body_names`.
    com, com_velocity, com_setpoint
        Centre of mass [m], its velocity [m/s] and its reference [m], (3,).
    rotation_error
        Angle between the base and its reference [rad].
    thrust
        Thrusts [N], (jets,).
    wind
        Velocity of the air [m/s], (3,).
    aero_force
        Aerodynamic force on each link in the simulator [N], (links, 3).
    """

    time: float
    body_positions: Vector
    body_rotations: Vector
    com: Vector
    com_velocity: Vector
    com_setpoint: Vector
    rotation_error: float
    thrust: Vector
    wind: Vector
    aero_force: Vector

    @property
    def stopped(self) -> NDArray[np.bool_]:
        """Which engines have stopped, (jets,): with less than 3 % of the greatest thrust."""
        return np.asarray(self.thrust < 0.03 * np.max(self.thrust))


@dataclass(frozen=True)
class Recording:
    """Signals of one flight, the robot that flew it, and its outcome.

    Attributes
    ----------
    title
        Title in one line.
    signals
        Arrays of `SIGNALS` and of other logged signals; the first axis is time.
    robot
        Robot model that computes poses from the signals.
    robot_path
        The robot's TOML file.
    outcome, lost_time, lost_reason
        As in `rust.FlightResult`.
    config
        Resolved configuration, which can be flown again; `None` if the file has none.
    folder
        Folder of the result; `None` for a flight just flown.
    """

    title: str
    signals: Mapping[str, Vector]
    robot: rust.Robot
    robot_path: Path
    outcome: str
    lost_time: float | None
    lost_reason: str | None
    config: rust.Config | None = field(default=None, repr=False)
    folder: Path | None = None

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.signals["time"][-1])

    @cached_property
    def look(self) -> Look:
        """Shapes of the robot."""
        return look_of(self.robot, self.robot_path)

    def rows(self, signal: str) -> Vector:
        """Return a signal with its entries flattened, (n, k)."""
        return np.reshape(self.signals[signal], (self.signals["time"].size, -1))

    @property
    def verdict(self) -> str:
        """Outcome in words: `completed`, or `fell at 21.4 s (rotation error 90.1 deg)`."""
        return ending(self.outcome, self.lost_time, self.lost_reason)

    def at(self, time: float) -> Instant:
        """Return the instant at `time` [s], interpolated linearly; outside the flight, its first or last sample."""
        t = self.signals["time"]
        time = float(np.clip(time, t[0], t[-1]))
        after = int(np.clip(np.searchsorted(t, time), 1, t.size - 1)) if t.size > 1 else 0
        before = max(after - 1, 0)
        share = 0.0 if after == before else (time - t[before]) / (t[after] - t[before])

        def value(name: str) -> Vector:
            signal = self.signals[name]
            return np.asarray((1.0 - share) * signal[before] + share * signal[after])

        first, second = self.signals["base_quaternion"][[before, after]]
        # q and −q are the same rotation: interpolate along the shorter way.
        wxyz = (1.0 - share) * first + share * (second if first @ second >= 0.0 else -second)
        joints = value("joint_position")
        pose = rust.dynamics(
            self.robot,
            rust.State(
                value("base_position"),
                rust.rotation_from_wxyz(wxyz),
                joints,
                np.zeros(6 + joints.size),
            ),
        )
        return Instant(
            time=time,
            body_positions=pose.body_positions,
            body_rotations=pose.body_rotations,
            com=value("com_position"),
            com_velocity=value("com_velocity"),
            com_setpoint=value("com_setpoint"),
            rotation_error=float(value("rotation_error")),
            thrust=value("thrust"),
            wind=value("wind"),
            aero_force=value("aero_force_sim"),
        )


def axes_of(signal: str, robot: rust.Robot) -> list[Sequence[str]]:
    """Return the names along every axis of a signal's row."""
    labels = labels_of(robot)
    return [labels[dim] for dim in rust.signals()[signal].dims[1:]]


def entries_of(signal: str, robot: rust.Robot) -> list[tuple[str, ...]]:
    """Return the names of the entries of a signal's row, one for each of its dimensions; empty names for a scalar.

    >>> entries_of("wind", rust.Robot("configs/robot/sparrow.toml"))
    [('x',), ('y',), ('z',)]
    """
    return list(itertools.product(*axes_of(signal, robot)))


def with_zeros(signals: Mapping[str, Vector], robot: rust.Robot) -> dict[str, Vector]:
    """Return signals with zeros for those of `SIGNALS` that are not there, and a base that stays upright."""
    shapes = {name: [len(names) for names in axes_of(name, robot)] for name in SIGNALS}
    zeros = {name: np.zeros((len(signals["time"]), *shape)) for name, shape in shapes.items()}
    zeros["base_quaternion"][:, 0] = 1.0
    return {**zeros, **signals}


def from_flight(flight: rust.FlightResult, config: rust.Config, title: str) -> Recording:
    """Return the recording of a flight just flown."""
    return Recording(
        title=title,
        signals={name: flight.log[name] for name in rust.signals() if name in flight.log},
        robot=rust.Robot(config["robot"]),
        robot_path=Path(config["robot"]),
        outcome=flight.outcome,
        lost_time=flight.lost_time,
        lost_reason=flight.lost_reason,
        config=config,
    )


def read(result: str | Path, robot: str | Path | None = None) -> Recording:
    """Read a result folder, a `run.nc`, or the name of a result in `results/flight`.

    Parameters
    ----------
    result
        Folder that `jax-aero fly NAME` wrote.
    robot
        TOML file of the robot, if the result does not name it.

    Raises
    ------
    Refused
        If the result is invalid; the message names the file and what was expected.
    """
    path = _run_file(Path(result))
    try:
        return _read(path, robot)
    except Refused:
        raise
    except Exception as reason:  # HDF5, JSON and paths raise many types for invalid results
        raise Refused(f"`{path}` is damaged ({type(reason).__name__}: {reason}); {EXPECTED}") from reason


def _read(path: Path, robot: str | Path | None) -> Recording:
    described = path.with_name(MANIFEST_FILE)
    manifest = read_json(described, documents.Manifest) if os.path.lexists(described) else {}
    if find_damaged(
        path.parent, {name: sha256 for name, sha256 in manifest.get("files", {}).items() if name == path.name}
    ):
        raise Refused(f"`{path}` is not what was written there, by the checksum in {MANIFEST_FILE}; {EXPECTED}")
    signals, facts = _read_signals(path)
    try:
        config = typed_config.make_paths_absolute(manifest["config"], path.parent) if "config" in manifest else None
    except ConfigError as reason:
        raise reason.in_file(str(described)) from None
    robot_path = _robot_path(path, config, robot)
    try:
        loaded = rust.Robot(robot_path)
    except (OSError, ValueError) as reason:
        raise Refused(f"cannot read the robot of `{path}`: {reason}") from None
    _check_shapes(path, signals, loaded)
    if config is not None:
        config["robot"] = str(robot_path)
    lost_time = facts.get("lost_time")
    return Recording(
        title=" ".join(str(facts.get("title") or manifest.get("title") or path.parent.name).split()),
        signals=signals,
        robot=loaded,
        robot_path=robot_path,
        outcome=str(facts.get("outcome", "flown")),
        lost_time=float(lost_time) if lost_time is not None and np.isfinite(lost_time) else None,
        lost_reason=str(facts.get("lost_reason") or "") or None,
        config=config,
        folder=path.parent,
    )


EXPECTED = "expected a folder or a run.nc that `jax-aero fly NAME` wrote, e.g. results/flight/test2"


def _run_file(path: Path) -> Path:
    named = RESULTS / "flight" / path
    if not path.exists() and path.parent == Path() and named.is_dir():
        path = named
    if path.is_dir():
        if not (path / RUN_FILE).is_file():
            raise Refused(f"folder `{path}` holds no {RUN_FILE}; {EXPECTED}")
        return path / RUN_FILE
    if not path.is_file():
        raise Refused(f"there is no `{path}`; {EXPECTED}")
    if path.suffix.lower() not in (".nc", ""):
        raise Refused(f"`{path}` is of a format that is not read; {EXPECTED}, or {instead_of(path)}")
    return path


def _read_signals(path: Path) -> tuple[dict[str, Vector], dict[str, Any]]:
    require(["h5py", "h5netcdf", "xarray"], f"reading `{path}`")
    from jax_aero.base import run_file

    try:
        run = run_file.read(path)
    except Refused as reason:
        raise Refused(f"{reason}; {EXPECTED}") from None
    if missing := [name for name in SIGNALS if name not in run]:
        raise Refused(f"`{path}` has no {', '.join(f'`{name}`' for name in missing)}; {EXPECTED}")
    declared = [name for name, signal in rust.signals().items() if signal.dims[0] == "time" and name in run]
    signals = {name: np.asarray(run[name].values, dtype=np.float64) for name in declared}
    if signals["time"].size == 0:
        raise Refused(f"`{path}` holds no sample; {EXPECTED}")
    if not np.all(np.diff(signals["time"], prepend=-np.inf) > 0.0) or signals["time"][-1] == np.inf:
        raise Refused(f"`time` in `{path}` does not increase from sample to sample; {EXPECTED}")
    return signals, run.attrs


def _robot_path(path: Path, config: rust.Config | None, given: str | Path | None) -> Path:
    if given is not None:
        return Path(given)
    if config is None:
        raise Refused(f"there is no {MANIFEST_FILE} beside `{path}`, which names the robot; give it with --robot FILE")
    named = Path(str(config.get("robot")))
    if not named.is_file():
        raise Refused(f"the robot of `{path}`, `{named}`, is not here; give it with --robot FILE")
    return named


def _check_shapes(path: Path, signals: Mapping[str, Vector], robot: rust.Robot) -> None:
    sizes = {"time": signals["time"].size} | {dim: len(names) for dim, names in labels_of(robot).items()}
    for name in signals:
        shape = tuple(sizes[dim] for dim in rust.signals()[name].dims)
        if signals[name].shape != shape:
            raise Refused(
                f"`{name}` in `{path}` has shape {signals[name].shape}; expected {shape} for robot `{robot.name}`"
            )
