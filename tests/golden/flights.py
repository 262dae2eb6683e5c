"""Flights whose signals are stored: how they are flown, which rows are stored, and under which names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments import backends
from jax_aero import rust
from jax_aero.base import places

FOLDER = Path(__file__).parent / "flights"
NAMES = places.names("experiments")

NOT_STORED = {"time", "qp_kkt", "qp_iterations", "max_kkt", "max_qp_iterations", "degraded_modes", "joint_condition"}
NOT_STORED |= {"measured_torque_latency", "measured_thrust_latency"}
"""Residuals of the QP are rounding, and the number of iterations is no property of the flight."""

DOUBLE = 1e-9
"""Tolerance in parts of a signal's range. Rounding differs by 2e-16 per operation, and where a row is stored a flight
multiplies a difference of 1e-13 to at most 1e-10 (measured, see `make.py`)."""

SINGLE = 1e-5
"""Tolerance where a last bit has become a rounding of a network in single precision (6e-8) or a residual of MuJoCo's
constraint solver (its tolerance is 1e-8): differences of at most 1e-6 were measured there."""

SMALL = 1e-3
"""Least range of a signal, in its unit: what stays smaller (a rotation error of 1e-9 rad, say) is rounding of larger
terms."""


class Stored(NamedTuple):
    """Some rows of a flight."""

    row: NDArray[np.int64]
    end: dict[str, Any]
    """Outcome and fall time, where they are certain, and the figures of the summary that are."""
    signals: dict[str, NDArray[np.float64]]
    tolerance: dict[str, NDArray[np.float64]]
    """Of each signal in each row."""


def fly(config: rust.Config) -> rust.FlightResult:
    """Fly a configuration with its own engine."""
    return backends.backend(backends.backend_of(config)).fly(config)


def rounds_coarsely(config: rust.Config) -> bool:
    """Whether a network (single precision) or an iterative contact solver takes part."""
    models = (config["simulator"]["aero"]["model"], config["controller"]["aero"]["model"])
    return "network" in models or backends.backend_of(config) == "mujoco"


def signals(flight: rust.FlightResult) -> dict[str, NDArray[np.float64]]:
    """Return the signals of a log that are stored."""
    return {name: signal for name, signal in flight.log.items() if name not in NOT_STORED}


def summary(flight: rust.FlightResult) -> dict[str, float]:
    """Return the figures of a summary that are stored."""
    return {name: figure for name, figure in flight.summary.items() if name not in NOT_STORED}


def load_stored(name: str) -> Stored:
    """Return what is stored of a flight."""
    with np.load(FOLDER / f"{name}.npz") as file:
        content = dict(file)
    row, end, coarse = content.pop("row"), json.loads(str(content.pop("end"))), content.pop("coarse")
    tolerance = np.where(coarse, SINGLE, DOUBLE)
    return Stored(row, end, content, dict(zip(content, tolerance, strict=True)))


def difference(found: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest difference of each row, relative to the range of the signal over the rows."""
    scale = max(float(np.abs(expected[np.isfinite(expected)]).max(initial=0.0)), SMALL)
    # Some bounds are infinite, some measurements unknown.
    other = (found != expected) & ~(np.isnan(found) & np.isnan(expected))
    apart = np.subtract(found, expected, out=np.zeros(expected.shape), where=other)
    return np.abs(apart).reshape(len(expected), -1).max(axis=1, initial=0.0) / scale
