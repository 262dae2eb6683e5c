"""Result folders: what they hold and how they are written; the interface between runs and figures.

A folder holds `run.nc` (every signal, with unit and named coordinates) and `manifest.json` (what
was flown, by which code, on what machine). It appears complete or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import xarray as xr

from jax_aero.files import complete_folder, write_json
from jax_aero.result import FlightResult

RUN_FILE = "run.nc"
MANIFEST_FILE = "manifest.json"

MOMENTUM = "kg m s-1 (linear), kg m2 s-1 (angular)"
MOMENTUM_RATE = "N (linear), N m (angular)"


@dataclass(frozen=True)
class Signal:
    """One variable of `run.nc`."""

    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "f8"


SIGNALS: Mapping[str, Signal] = {
    "base_position": Signal(("time", "xyz"), "m", "position of the base origin, inertial frame"),
    "base_quaternion": Signal(("time", "wxyz"), "1", "rotation from base to inertial frame"),
    "base_velocity": Signal(
        ("time", "six"), "m s-1 (linear), rad s-1 (angular)", "base velocity, mixed: both parts in inertial axes"
    ),
    "joint_position": Signal(("time", "joint"), "rad", "joint position"),
    "joint_velocity": Signal(("time", "joint"), "rad s-1", "joint velocity"),
    "com_position": Signal(("time", "xyz"), "m", "centre of mass, inertial frame"),
    "com_velocity": Signal(("time", "xyz"), "m s-1", "velocity of the centre of mass, inertial frame"),
    "com_setpoint": Signal(("time", "xyz"), "m", "smoothed reference of the centre of mass, inertial frame"),
    "rotation_error": Signal(("time",), "rad", "angle between the base and its smoothed reference"),
    "base_rpy_setpoint": Signal(("time", "rpy"), "rad", "smoothed reference of the base: roll, pitch, yaw"),
    "thrust": Signal(("time", "jet"), "N", "thrust of each jet"),
    "thrust_rate": Signal(("time", "jet"), "N s-1", "commanded thrust rate"),
    "joint_velocity_command": Signal(("time", "joint"), "rad s-1", "joint velocity command of the momentum QP"),
    "joint_torque": Signal(("time", "joint"), "N m", "commanded joint torque, after the rate limiter"),
    "wind": Signal(("time", "xyz"), "m s-1", "wind velocity, inertial frame"),
    "aero_force_sim": Signal(("time", "link", "xyz"), "N", "aerodynamic force in the simulator, inertial frame"),
    "aero_force_control": Signal(
        ("time", "link", "xyz"), "N", "aerodynamic force the controller compensates, inertial frame"
    ),
    "momentum": Signal(("time", "six"), MOMENTUM, "centroidal momentum, inertial axes"),
    "momentum_setpoint": Signal(("time", "six"), MOMENTUM, "reference of the centroidal momentum"),
    "momentum_rate_estimate": Signal(("time", "six"), MOMENTUM_RATE, "momentum rate the controller estimates"),
    "qp_status": Signal(("time", "qp"), "1", "outcome of each QP; 0 is solved", dtype="i2"),
    "qp_kkt": Signal(("time", "qp"), "1", "scaled KKT residual of each QP's answer"),
    "qp_iterations": Signal(("time", "qp"), "1", "active-set iterations of each QP", dtype="i4"),
}
"""Every variable of `run.nc` except the coordinates and `joint_setpoint`."""

WRENCH = "N (force), N m (moment)"

GROUND_SIGNALS: Mapping[str, Signal] = {
    "measured_wind": Signal(("time", "xyz"), "m s-1", "measured wind velocity, inertial frame"),
    "joint_torque_measured": Signal(
        ("time", "joint"), "N m", "torque that reaches the joint: of the motor, less its friction"
    ),
    "foot_wrench": Signal(("time", "foot", "six"), WRENCH, "wrench on each sole about its origin, inertial axes"),
    "sole_position": Signal(("time", "foot", "xyz"), "m", "origin of each sole, inertial frame"),
    "feet_carry": Signal(("time",), "1", "whether the controller takes the feet to carry", dtype="i1"),
    "contact_force": Signal(("time", "foot", "six"), WRENCH, "foot wrenches f_c* that the controller integrates"),
    "contact_force_rate": Signal(
        ("time", "foot", "six"), "N s-1 (force), N m s-1 (moment)", "rate of f_c* commanded by the momentum QP"
    ),
    "contact_force_torque": Signal(("time", "foot", "six"), WRENCH, "foot wrenches that come with the torques"),
}
"""What a robot that stands adds to them."""


class RobotNames(Protocol):
    """The part of a robot that labels a log; `jax_aero.rust.Robot` is one."""

    @property
    def joint_names(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def joint_groups(self) -> Mapping[str, Sequence[str]]: ...  # noqa: D102
    @property
    def aero_link_names(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def jet_names(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def foot_names(self) -> Sequence[str]: ...  # noqa: D102


def to_dataset(
    flight: FlightResult, robot: RobotNames, *, title: str, config_digest: str, engine: str = "rust"
) -> xr.Dataset:
    """Label a flight's log with dimensions, coordinates and units."""
    coords = _coordinates(flight, robot)
    variables: dict[str, Any] = {}
    signals = SIGNALS
    if not GROUND_SIGNALS.keys().isdisjoint(flight.log):
        signals = {**SIGNALS, **GROUND_SIGNALS}
        coords["foot"] = ("foot", np.array(list(robot.foot_names), dtype=str))
    for name, signal in signals.items():
        if name not in flight.log:
            raise ValueError(f"the flight's log has no `{name}`")
        shape = tuple(coords[dim][1].shape[0] for dim in signal.dims)
        if flight.log[name].shape != shape:
            raise ValueError(f"`{name}` has shape {flight.log[name].shape}; expected {shape} for {signal.dims}")
        attributes = {"units": signal.units, "long_name": signal.long_name}
        variables[name] = (signal.dims, flight.log[name].astype(signal.dtype), attributes)
    if unlabelled := flight.log.keys() - signals.keys() - {"time"}:
        raise ValueError(f"no unit is written down for {', '.join(sorted(unlabelled))}; add them to SIGNALS")
    variables["joint_setpoint"] = (
        ("joint",),
        np.asarray(flight.joint_setpoint),
        {"units": "rad", "long_name": "posture of the first tick, kept as reference"},
    )
    facts: dict[str, str | float] = {
        "title": title,
        "outcome": flight.outcome,
        # NetCDF attributes have no null: NaN and the empty text stand for "did not fall".
        "fall_time": np.nan if flight.fall_time is None else flight.fall_time,
        "fall_reason": flight.fall_reason or "",
        "engine": engine,
        "config_hash": config_digest,
    }
    return xr.Dataset(variables, coords, facts)


def _coordinates(flight: FlightResult, robot: RobotNames) -> dict[str, Any]:
    group_of = {joint: group for group, joints in robot.joint_groups.items() for joint in joints}
    labels: dict[str, Sequence[str]] = {
        "xyz": ["x", "y", "z"],
        "wxyz": ["w", "x", "y", "z"],
        "rpy": ["roll", "pitch", "yaw"],
        "six": ["linear_x", "linear_y", "linear_z", "angular_x", "angular_y", "angular_z"],
        "joint": robot.joint_names,
        "jet": robot.jet_names,
        "link": robot.aero_link_names,
        "qp": ["momentum", "torque"],
    }
    coords: dict[str, Any] = {"time": ("time", flight.log["time"], {"units": "s", "long_name": "time"})}
    for dim, names in labels.items():
        coords[dim] = (dim, np.array(list(names), dtype=str))
    groups = np.array([group_of.get(joint, "") for joint in robot.joint_names], dtype=str)
    coords["joint_group"] = ("joint", groups, {"long_name": "sub-assembly of the joint"})
    return coords


def write_dataset(dataset: xr.Dataset, path: Path) -> None:
    """Write NetCDF-4, compressed losslessly."""
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {str(name): packed for name in dataset.data_vars}
    dataset.to_netcdf(path, engine="h5netcdf", encoding=encoding)


def write_run(folder: Path, dataset: xr.Dataset, manifest: Mapping[str, Any], *, replace: bool = False) -> None:
    """Write a whole result folder at once."""
    with complete_folder(folder, replace=replace) as draft:
        write_dataset(dataset, draft / RUN_FILE)
        write_json(draft / MANIFEST_FILE, manifest)


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a finished result, or `None` where there is none to read."""
    try:
        manifest = json.loads((folder / MANIFEST_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return manifest if isinstance(manifest, dict) and (folder / RUN_FILE).is_file() else None


def unrelated_files(folder: Path) -> list[str]:
    """Return the names in a folder that belong to no result; replacing the result would delete them."""
    return sorted(entry.name for entry in folder.iterdir() if entry.name not in (RUN_FILE, MANIFEST_FILE))
