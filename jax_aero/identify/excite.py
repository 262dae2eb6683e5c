"""Manoeuvres for identification: references with some axes in motion, which `jax-aero fly` flies as missions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.body.spatial import rotation_from_rpy

AXES = {"x": 0.5, "y": 0.5, "z": 0.3, "roll": 8.0, "pitch": 8.0, "yaw": 20.0}
"""Axes of a manoeuvre, with their greatest motion [m, deg], which the realistic simulation survives."""
PERIODS = (7.0, 4.3, 2.9)
"""Periods of the motion [s]; none is a multiple of another, so that axes are distinguished."""
SPAN = (4.0, 58.0)
"""Beginning and end of a manoeuvre [s]."""
RISE = 3.0
"""Time in which the motion begins and ends [s]."""


def reference(
    com: NDArray[np.float64], rpy: NDArray[np.float64], axes: Sequence[str], start: float, end: float
) -> NDArray[np.float64]:
    """Return rows of time, centre of mass and attitude [s, m, rad] about a place and attitude, (n, 7)."""
    time = np.arange(start, end + 1e-9, 0.02)
    edge = np.clip(np.minimum(time - start, time[-1] - time) / RISE, 0.0, 1.0)
    window = edge**3 * (10.0 - 15.0 * edge + 6.0 * edge**2)
    rows = np.tile(np.concatenate([com, rpy]), (time.size, 1))
    for number, (name, size) in enumerate(AXES.items()):
        if name in axes:
            waves = [
                np.sin(2.0 * np.pi * (time - start) / period * (1.0 + 0.13 * number) + 1.7 * number * k)
                for k, period in enumerate(PERIODS)
            ]
            share = np.sum(waves, axis=0) / len(waves)
            rows[:, number] += window * share * (size if number < 3 else np.radians(size))
    return np.column_stack([time, rows])


def write(path: Path, rows: NDArray[np.float64]) -> None:
    """Write a reference as `mission.file` reads it."""
    names = "time,x,y,z,roll,pitch,yaw"
    np.savetxt(path, rows, fmt="%.10g", delimiter=",", header=names, comments="")


def reference_of(config: rust.Config, axes: Sequence[str], start: float, end: float) -> NDArray[np.float64]:
    """Return the reference about the start of a flight's configuration."""
    initial = config["simulator"]["initial"]
    rpy, joints = np.radians(initial["base_rpy_deg"]), np.asarray(initial["joint_position"])
    rotation = np.asarray(rotation_from_rpy(rpy))
    state = rust.State(np.asarray(initial["base_position"]), rotation, joints, np.zeros(6 + joints.size))
    com = rust.dynamics(rust.Robot(config["robot"]), state).com_position
    return reference(com, rpy, axes, start, end)


def flight(config: rust.Config, axes: Sequence[str], folder: Path) -> rust.Config:
    """Return the flight of a manoeuvre, whose reference is written to a folder."""
    write(folder / "excite.csv", reference_of(config, axes, *SPAN))
    mission = {"file": str(folder / "excite.csv")}
    simulator = config["simulator"] | {"duration": SPAN[1] + 2.0}
    return rust.resolve_config({**config, "mission": mission, "simulator": simulator})
