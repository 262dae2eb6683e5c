"""How a standing robot moves from calm to wind, recorded or simulated."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust

Array = NDArray[np.float64]

VISIBLE = 2e-3
"""Displacement of the centre of mass at the onset [m]."""

JOINTS = (("ankle_pitch", "knee", "hip_pitch"), ("ankle_roll", "hip_roll"))
"""Joints that move in wind along x and along y."""

CALM, WINDY = (4.0, 9.0), (20.0, 32.0)
"""Times before the wind and in it whose means are compared [s]."""


def moved(signals: Mapping[str, Array], config: rust.Config) -> dict[str, float]:
    """Return how centre of mass and legs move, and how their torques change, from calm to wind: the mean of both legs.

    The onset is when the centre of mass has moved by `VISIBLE`, from when the wind begins to rise.
    """
    time, robot = signals["time"], rust.Robot(config["robot"])
    wind = config["disturbances"]["controller_wind"]
    along = int(np.abs(wind["velocity"]).argmax())

    def change(rows: Array) -> Array:
        calm, windy = ((time >= start) & (time <= end) for start, end in (CALM, WINDY))
        return np.asarray(rows[windy].mean(axis=0) - rows[calm].mean(axis=0))

    positions = signals.get("joint_position", signals["raw_joint_position"])
    com = centre_of_mass(signals, robot)[:, along]
    begun = time >= wind["ramp_start"]
    still = com[(time >= wind["ramp_start"] - 1.0) & ~begun].mean()
    changes = {
        "centre of mass [mm]": 1e3 * abs(float(change(com))),
        "onset [s]": float(time[begun][(np.abs(com[begun] - still) > VISIBLE).argmax()] - wind["ramp_start"]),
    }
    legs = [[robot.joint_names.index(f"{side}_{name}") for side in "lr"] for name in JOINTS[along]]
    mirror = np.array([0.5, (0.5, -0.5)[along]])  # roll joints turn their legs the other way
    for name, leg in zip(JOINTS[along], legs, strict=True):
        words = name.replace("_", " ")
        changes[f"{words} [deg]"] = float(np.degrees(change(positions)[leg]) @ mirror)
        changes[f"{words}, torque [N m]"] = float(change(signals["joint_torque_measured"])[leg] @ mirror)
    return changes


def centre_of_mass(signals: Mapping[str, Array], robot: rust.Robot) -> Array:
    """Return the centre of mass at every tick [m], of a record from base and joints."""
    if "com_position" in signals:
        return signals["com_position"]
    still = np.zeros(6 + len(robot.joint_names))
    rows = zip(*(signals[f"raw_{part}"] for part in ("base_position", "base_rotation", "joint_position")), strict=True)
    states = (rust.State(position, rotation, joints, still) for position, rotation, joints in rows)
    return np.array([rust.dynamics(robot, state).com_position for state in states])
