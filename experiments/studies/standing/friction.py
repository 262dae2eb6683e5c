"""Dry friction of the standing robot's drives: without load and as a share of the load, fitted to a record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from experiments.studies.standing.motion import moved
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.mujoco import ground

TOLERANCE = {"[mm]": 5.0, "[deg]": 1.0, "[N m]": 1.5, "[s]": 1.0}
"""Difference from the record that counts as one, by unit: centre of mass, angles, torques, onset."""

STEP = 0.1
"""Relative change of a number in a difference quotient."""

STEPS = 4
"""Greatest number of steps of the fit."""

FELL = 1e3
"""Difference that counts for a flight that does not end as it should."""


class Friction(tables.Table, frozen=True):
    """Joints whose friction a record determines."""

    joints: tuple[str, ...]
    start: tuple[float, float]
    """First guess: friction without load [N m], and its share of the load."""
    others: tuple[float, float]
    """Numbers of the other joints, with which these are tried too."""


def fit(asked: Friction, flown: rust.Config, recorded: Mapping[str, float]) -> dict[str, Any]:
    """Return the two numbers with which the simulated experiment moves most as the record, by difference quotients."""

    def simulate(numbers: NDArray[np.float64]) -> tuple[rust.FlightResult, dict[str, float]]:
        changed = with_friction(flown, asked.joints, numbers)
        flight = ground.fly(changed)
        return flight, moved(flight.log, changed) if flight.outcome == "completed" else {}

    def residuals(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        figures = simulate(numbers)[1]
        scales = {name: TOLERANCE[name[name.rindex("[") :]] for name in recorded}
        return np.array([(figures.get(name, FELL) - recorded[name]) / scale for name, scale in scales.items()])

    solution = least_squares(residuals, asked.start, bounds=([0.0, 0.0], [10.0, 1.0]), diff_step=STEP, max_nfev=STEPS)
    other = simulate(np.array(asked.others))[0]
    return {
        "fitted friction without load [N m]": solution.x[0],
        "fitted share of the load": solution.x[1],
        "greatest difference of the fit over its tolerance": float(np.abs(solution.fun).max()),
        "with the numbers of the other joints": f"{other.outcome} at {other.log['time'][-1]:.1f} s",
    }


def with_friction(config: rust.Config, joints: tuple[str, ...], numbers: NDArray[np.float64]) -> rust.Config:
    """Return a configuration whose joints have this friction without load [N m], and this share of the load."""
    simulator = dict(config["simulator"])
    motors = dict(simulator["motors"])
    for key, number in zip(("friction_of", "load_friction"), numbers, strict=True):
        motors[key] = {**motors.get(key, {}), **dict.fromkeys(joints, float(number))}
    return {**config, "simulator": {**simulator, "motors": motors}}
