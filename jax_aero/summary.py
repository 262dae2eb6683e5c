"""Figures of merit of a flight's log, equal to the Rust crate's.

log ──condense──► the few signals needed for the figures ──figures──► figures of merit

Equation M81 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

SETTLING_TIME = 3.0
"""Settling time after the start of a flight, which begins out of equilibrium [s]."""

LEANING = np.pi / 4
"""Rotation error beyond which a flying robot counts as leaning [rad]."""

WARNING_GAP = 1.0
"""Longest time without a degraded tick that does not interrupt a warning [s]."""


def condense(log: Mapping[str, Any], joint_setpoint: Any) -> dict[str, Any]:
    """Return the signals that `figures` needs, from a log or from one tick of it, as NumPy or JAX arrays."""
    same = (
        "time",
        "com_position",
        "rotation_error",
        "thrust",
        "qp_status",
        "qp_kkt",
        "qp_iterations",
        "degraded_modes",
    )
    return {name: log[name] for name in same} | {
        "com_error": log["com_position"] - log["com_setpoint"],
        "largest_torque": abs(log["joint_torque"]).max(-1, initial=0.0),
        "joint_error": abs(log["joint_position"] - joint_setpoint).sum(-1),
        "simulated": log["aero_force_sim"].sum(-2),
        "estimated": log["aero_force_control"].sum(-2),
    }


def figures(signals: Mapping[str, NDArray[np.float64]]) -> dict[str, float]:
    """Return extremes and means of condensed signals; the first axis is time. A figure without ticks is NaN."""
    time, com_error, rotation_error = signals["time"], signals["com_error"], signals["rotation_error"]
    settled = time >= SETTLING_TIME
    com_error = com_error[settled]
    distance = np.linalg.norm(com_error, axis=1)
    simulated, estimated = signals["simulated"], signals["estimated"]
    tick, modes = float(time[1]) if time.size > 1 else 0.0, signals["degraded_modes"]
    kkt = signals["qp_kkt"][np.isfinite(signals["qp_kkt"])]
    # The greater value of both QPs; NaN without either.
    status, iterations = (np.fmax.reduce(signals[name], axis=1) for name in ("qp_status", "qp_iterations"))
    found = {
        "max_com_error": _greatest_of(distance),
        "max_com_error_x": _greatest_of(np.abs(com_error[:, 0])),
        "max_com_error_y": _greatest_of(np.abs(com_error[:, 1])),
        "max_com_error_z": _greatest_of(np.abs(com_error[:, 2])),
        "max_rotation_error": _greatest(rotation_error),
        "thrust_min": signals["thrust"].min() if signals["thrust"].size else 0.0,
        "thrust_max": signals["thrust"].max() if signals["thrust"].size else 0.0,
        "max_torque": _greatest(signals["largest_torque"]),
        "min_com_height": np.min(signals["com_position"][:, 2], initial=np.inf),
        "min_com_x_settling": np.min(signals["com_position"][~settled, 0], initial=np.inf),
        "ticks_without_solution": _ticks_above(status, 0.0),
        "rms_com_error": _root_mean_square(distance),
        "rms_rotation_error": _root_mean_square(rotation_error[settled]),
        "time_above_45_deg": tick * _ticks_above(rotation_error, LEANING),
        "max_joint_error": _greatest(signals["joint_error"]),
        "max_aero_force": _greatest(np.linalg.norm(simulated, axis=1)),
        "max_aero_force_difference": _greatest(np.linalg.norm(simulated - estimated, axis=1)),
        "max_kkt": _greatest_of(kkt),
        "max_qp_iterations": _greatest(iterations),
        "degraded_time": tick * _ticks_above(modes, 0.0),
        "nominal_until": _nominal_until(time, modes),
        "all_modes": _all_modes(modes),
        "warning_time": _warning_time(time, modes),
    }
    return {name: float(value) if time.size else np.nan for name, value in found.items()}


def _nominal_until(time: NDArray[np.float64], modes: NDArray[np.float64]) -> float:
    """Return the time of the first degraded tick, without one of the last tick; NaN if a set of modes is NaN [s]."""
    return float(np.append(time[modes > 0.0], time[-1])[0]) if time.size and not np.isnan(modes).any() else np.nan


def _all_modes(modes: NDArray[np.float64]) -> float:
    """Return the union of sets of modes; NaN if one is NaN."""
    return np.nan if np.isnan(modes).any() else float(np.bitwise_or.reduce(modes.astype(int)))


def _warning_time(time: NDArray[np.float64], modes: NDArray[np.float64]) -> float:
    """Return the time from the first degraded tick of the last warning to the last tick; zero without one [s]."""
    if not time.size or np.isnan(modes).any():
        return np.nan
    degraded = np.append(time[modes > 0.0], time[-1])
    gaps = np.flatnonzero(np.diff(degraded) > WARNING_GAP + 1e-9)
    return float(time[-1] - degraded[gaps[-1] + 1 if gaps.size else 0])


def _ticks_above(values: NDArray[np.float64], limit: float) -> float:
    """Return the number of ticks with a greater value; NaN if one is NaN."""
    return float(np.sum(np.where(np.isnan(values), np.nan, values > limit)))


def _greatest(values: NDArray[np.float64]) -> float:
    """Return the greatest of values that are not negative; zero if there are none."""
    return float(np.max(values, initial=0.0))


def _greatest_of(values: NDArray[np.float64]) -> float:
    """Return the greatest of values that are not negative; NaN if there are none."""
    return float(np.max(values)) if values.size else np.nan


def _root_mean_square(values: NDArray[np.float64]) -> float:
    """Return the root mean square of the values; NaN if there are none."""
    return float(np.sqrt(np.mean(values**2))) if values.size else np.nan
