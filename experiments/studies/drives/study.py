"""Friction of the standing robot's drives, fitted to its records.

`jax-aero study drives [front] [lateral]` fits the dry friction of one kind of joints, without load and as a share of
the load, so that the simulated experiment moves as the robot did: pitch and knee joints by the frontal run, roll joints
by the lateral one. The derivatives are difference quotients of flights. The result goes to `results/drives/NAME/`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from experiments.replay import replay
from experiments.standing import moved
from experiments.study import Findings, Study
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.mujoco import ground
from jax_aero.view import logs

TOLERANCE = {"[mm]": 5.0, "[deg]": 1.0, "[N m]": 1.5, "[s]": 1.0}
"""Difference from the record that counts as one, by unit: centre of mass, angles, torques, onset."""

STEP = 0.1
"""Relative change of a number in a difference quotient."""

FELL = 1e3
"""Difference that counts for a flight that does not end as it should."""


class DrivesConfig(tables.Table, frozen=True):
    """One recorded run and the joints that it determines."""

    title: str
    record: Path
    """Table of the record."""
    map: Path
    """File that names its columns, as of `jax-aero replay`."""
    flown: Path
    """Experiment with the controller that the robot had."""
    joints: tuple[str, ...]
    """Joints whose friction is fitted."""
    start: tuple[float, float]
    """First guess: friction without load [N m], and its share of the load."""
    others: tuple[float, float]
    """Numbers of the other joints, with which these are tried too."""
    most_steps: int = 4
    """Greatest number of steps of the fit."""


def compute(_: str, config: DrivesConfig) -> Findings:
    """Fit the two numbers of these joints."""
    flown = rust.load_config(config.flown)
    recorded = moved(replay(logs.read(config.record, flown, config.map), flown, config.record)[0], flown)

    def simulate(numbers: NDArray[np.float64]) -> tuple[rust.FlightResult, dict[str, float]]:
        changed = with_friction(flown, config.joints, numbers)
        flight = ground.fly(changed)
        return flight, moved(flight.log, changed) if flight.outcome == "completed" else {}

    def residuals(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        figures = simulate(numbers)[1]
        scales = {name: TOLERANCE[name[name.rindex("[") :]] for name in recorded}
        return np.array([(figures.get(name, FELL) - recorded[name]) / scale for name, scale in scales.items()])

    bounds = ([0.0, 0.0], [10.0, 1.0])
    fit = least_squares(residuals, config.start, bounds=bounds, diff_step=STEP, max_nfev=config.most_steps)
    simulated = simulate(fit.x)[1]
    other = simulate(np.array(config.others))[0]
    summary: dict[str, Any] = {"friction without load [N m]": fit.x[0], "share of the load": fit.x[1]}
    summary |= {"greatest difference over its tolerance": float(np.abs(fit.fun).max())}
    summary |= {f"recorded: {name}": value for name, value in recorded.items()}
    summary |= {f"simulated: {name}": value for name, value in simulated.items()}
    summary |= {"with the numbers of the other joints": f"{other.outcome} at {other.log['time'][-1]:.1f} s"}
    names = list(recorded)
    table = np.array([[recorded[name], simulated.get(name, np.nan)] for name in names])
    dataset = xr.Dataset({"figure": (("name", "source"), table)}, {"name": names, "source": ["recorded", "simulated"]})
    return Findings(config.title, dataset, summary, flights={"flown": flown})


def with_friction(config: rust.Config, joints: tuple[str, ...], numbers: NDArray[np.float64]) -> rust.Config:
    """Return a configuration whose joints have this friction without load [N m], and this share of the load."""
    simulator = dict(config["simulator"])
    motors = dict(simulator["motors"])
    for key, number in zip(("friction_of", "load_friction"), numbers, strict=True):
        motors[key] = {**motors.get(key, {}), **dict.fromkeys(joints, float(number))}
    return {**config, "simulator": {**simulator, "motors": motors}}


STUDY = Study("drives", __doc__, DrivesConfig, compute, ("front", "lateral"), engine="rust")
main = STUDY.main
