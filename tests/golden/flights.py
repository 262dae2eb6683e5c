"""Flights whose signals are stored: how they are flown, which rows are stored, and under which names."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import backends, rust
from jax_aero.base import places
from jax_aero.base.references import file_hash
from jax_aero.results.identity import CRATE, VERSIONS, computed_by

FOLDER, DIGESTS = Path(__file__).parent / "flights", Path(__file__).parent / "flights.json"
JAX = "jax_test2"
"""A flight of JAX: the first second of TEST2."""
NAMES = [*places.names("experiments"), JAX]

NOT_STORED = {"time", "qp_kkt", "qp_iterations", "max_kkt", "max_qp_iterations", "degraded_modes", "joint_condition"}
NOT_STORED |= {"measured_torque_latency", "measured_thrust_latency", "raw_height"}
"""Residuals of the QP are rounding, the number of iterations is no property of the flight; none measures its
height."""

DOUBLE = 1e-9
"""Tolerance in parts of a signal's range. Rounding differs by 2e-16 per operation, and where a row is stored a flight
multiplies a difference of 1e-13 to at most 1e-10 (measured, see `make.py`)."""

SINGLE = 1e-5
"""Tolerance where a last bit has become a rounding of a network in single precision (6e-8) or a residual of MuJoCo's
constraint solver (its tolerance is 1e-8): differences of at most 1e-6 were measured there."""

SMALL = 1e-3
"""Least range of a signal, in its unit: what stays smaller (a rotation error of 1e-9 rad, say) is rounding of larger
terms."""


class Digests(NamedTuple):
    """Digests that change with the numbers."""

    numerics: Mapping[str, int]
    """Versions of the numbers of all flights (`jax_aero.results.identity`)."""
    flights: dict[str, list[str]]
    """Digests of configuration and numbers, by flight."""


def load_digests() -> Digests:
    """Return the stored digests."""
    return Digests(**json.loads(DIGESTS.read_text(encoding="utf-8")))


def config_of(name: str) -> rust.Config:
    """Return the configuration of a flight."""
    if name == JAX:
        return rust.load_config("test2", {"backend": "jax", "simulator.duration": 1.0})
    return rust.load_config(name)


def digest(name: str, config: rust.Config, flight: rust.FlightResult) -> list[str]:
    """Return the digests of configuration and numbers of a flight.

    The configuration is the experiment's file with those that it names. Numbers of the crate are all its bits, which
    are the same on every machine. Those of JAX and MuJoCo differ between processors: theirs are the stored rows, which
    hold within their tolerance.
    """
    numbers = signals(flight)
    if computed_by(backends.backend_of(config)) != (CRATE,):
        with np.load(FOLDER / f"{name}.npz") as file:
            numbers = dict(file)
    total = hashlib.sha256()
    for key, values in sorted(numbers.items()):
        total.update(key.encode() + np.ascontiguousarray(values).tobytes())
    return [file_hash(places.find("experiments", "test2" if name == JAX else name)), total.hexdigest()]


def what_changed(name: str, config: rust.Config, flight: rust.FlightResult, known: Digests) -> str:
    """Return whether "configuration" or else "numbers" of a flight differ from the stored ones; empty if neither."""
    if name not in known.flights or not (FOLDER / f"{name}.npz").is_file():
        return "configuration"
    if digest(name, config, flight)[0] != known.flights[name][0]:
        return "configuration"
    return "" if has_numbers(name, config, flight, known) else "numbers"


def has_numbers(name: str, config: rust.Config, flight: rust.FlightResult, known: Digests) -> bool:
    """Return whether a flight has the stored numbers."""
    if name not in known.flights or not (FOLDER / f"{name}.npz").is_file():
        return False
    return digest(name, config, flight)[1] == known.flights[name][1] and not differences(load_stored(name), flight)


def is_unraised(changed: str, config: rust.Config, known: Digests) -> bool:
    """Return whether numbers have changed under the version of the stored ones."""
    parts = computed_by(backends.backend_of(config))
    return changed == "numbers" and all(VERSIONS[part] == known.numerics[part] for part in parts)


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


def differences(stored: Stored, flight: rust.FlightResult) -> dict[str, str]:
    """Return the first tick in which each stored signal differs by more than its tolerance; none if it does not."""
    found, wrong = signals(flight), {}
    for signal, expected in stored.signals.items():
        if signal not in found or len(found[signal]) <= stored.row[-1]:
            wrong[signal] = "it is not there"
            continue
        excess = difference(found[signal][stored.row], expected) / stored.tolerance[signal]
        if not (excess <= 1.0).all():
            first = int((~(excess <= 1.0)).argmax())
            wrong[signal] = (
                f"tick {stored.row[first]}: {excess[first] * stored.tolerance[signal][first]:.1e} of its range"
            )
    return wrong
