"""Figures of merit of a flight's log, the same as the Rust crate's."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

SETTLING_TIME = 3.0
"""Time that a flight takes to settle after it starts out of equilibrium [s]."""

TILTED = np.pi / 4
"""Rotation error beyond which a robot that still flies counts as tilted [rad]."""


def summarise(log: Mapping[str, NDArray[np.float64]], joint_reference: NDArray[np.float64]) -> dict[str, float]:
    """Extremes and means of a log."""
    settled = log["time"] >= SETTLING_TIME
    com_error = (log["com_position"] - log["com_reference"])[settled]
    distance = np.linalg.norm(com_error, axis=1)
    simulated, estimated = log["aero_force_sim"].sum(1), log["aero_force_control"].sum(1)
    tick = float(log["time"][1]) if log["time"].size > 1 else 0.0
    kkt = log["qp_kkt"][np.isfinite(log["qp_kkt"])]
    figures = {
        "max_com_error": _greatest(distance),
        "max_com_error_x": _greatest(np.abs(com_error[:, 0])),
        "max_com_error_y": _greatest(np.abs(com_error[:, 1])),
        "max_com_error_z": _greatest(np.abs(com_error[:, 2])),
        "max_rotation_error": _greatest(log["rotation_error"]),
        "thrust_min": log["thrust"].min(),
        "thrust_max": log["thrust"].max(),
        "max_torque": _greatest(np.abs(log["joint_torque"])),
        "min_com_height": log["com_position"][:, 2].min(),
        "min_com_x_settling": np.min(log["com_position"][~settled, 0], initial=np.inf),
        "ticks_without_solution": np.count_nonzero(np.any(log["qp_status"] != 0.0, axis=1)),
        "rms_com_error": _root_mean_square(distance),
        "rms_rotation_error": _root_mean_square(log["rotation_error"][settled]),
        "time_tilted": tick * np.count_nonzero(log["rotation_error"] > TILTED),
        "max_joint_error": _greatest(np.abs(log["joint_position"] - joint_reference).sum(1)),
        "max_aero_force": _greatest(np.linalg.norm(simulated, axis=1)),
        "max_aero_force_difference": _greatest(np.linalg.norm(simulated - estimated, axis=1)),
        "max_kkt": _greatest(kkt),
        "max_qp_iterations": _greatest(log["qp_iterations"]),
    }
    return {name: float(value) for name, value in figures.items()}


def _greatest(values: NDArray[np.float64]) -> float:
    """Greatest of values that are not negative; zero if there are none."""
    return float(np.max(values, initial=0.0))


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
