"""Accuracy of the wind estimated from the wrench.

Perturbed flights of TEST2 in turbulent winds from all directions are flown by a controller that uses the wind of its
wind observer: in worlds with the controller's own model, axisymmetric or network; with the axisymmetric model in the
network's world; and, if `worlds` names it, with the axisymmetric model in its own world with realistic sensors. For
each wind it records the root mean square of the horizontal error, and the share of time for which each horizontal
component is within its 90 % interval, from 8 s on. The result goes to `results/wind_observer/turbulence/`.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import keys, places, tables
from jax_aero.results.study import Findings, Study
from jax_aero.sweep.perturbation import Perturbation

DURATION, KNOWN = 20.0, 8.0
"""Duration of a flight, and time from which on it is judged [s]."""
TURBULENCE = 0.1
"""Standard deviation of the wind relative to its speed."""
PERTURBATION = places.CONFIGS / "perturbation" / "flight.toml"
QUANTILE = 1.645
"""Quantile of the normal distribution for a 90 % interval."""
World = Literal["axisymmetric", "network", "axisymmetric in the network's air", "realistic sensors"]
WORLDS: dict[World, tuple[str, str | None]] = {
    "axisymmetric": ("test2_observer", None),
    "network": ("robustness_observer", "simulator.aero"),
    "axisymmetric in the network's air": ("robustness_observer", None),
    "realistic sensors": ("test2_sensors", None),
}
"""Experiment of each world, and the key that gives the controller's aerodynamic model if not the experiment's own."""


class WindEstimate(tables.Table, frozen=True):
    """Flights of the study."""

    worlds: tuple[World, ...] = ("axisymmetric", "network", "axisymmetric in the network's air")
    """Worlds in which the flights are flown."""
    speeds: tuple[tables.Positive, ...] = (6.0, 8.0, 10.0, 14.0, 18.0)
    """Wind speeds [m/s]."""
    flights: tables.Count = 12
    """Flights for each speed and world."""
    seed: tables.Seed = 2
    """Seed of the perturbation; the observer's numbers were chosen with seed 1."""

    def __post_init__(self) -> None:
        tables.check_levels(self, "worlds", "speeds")


def compute(_: str, asked: WindEstimate) -> Findings:
    """Fly and judge the estimates."""
    by_world: dict[str, dict[str, float]] = {}
    for world in asked.worlds:
        for speed in asked.speeds:
            results = rust.fly_batch(list(configurations(world, speed, asked.flights, asked.seed)), full_log=True)
            errors, inside = zip(*(wind_errors(result.log) for result in results), strict=True)
            by_world[f"{world}, {speed:g} m/s"] = {
                "rms": float(np.sqrt(np.mean(np.concatenate(errors) ** 2))),
                "inside": float(np.mean(np.concatenate(inside))),
                "completed": sum(result.outcome == "completed" for result in results),
            }
    units = {"rms": ("m s-1", "root mean square error"), "inside": ("1", "share inside the 90 % interval")}
    shape = (len(asked.worlds), len(asked.speeds))
    data = xr.Dataset(
        {
            key: (
                ("world", "speed"),
                np.array([figures[key] for figures in by_world.values()]).reshape(shape),
                {"units": unit, "long_name": name},
            )
            for key, (unit, name) in units.items()
        },
        {
            "world": list(asked.worlds),
            "speed": ("speed", list(asked.speeds), {"units": "m s-1", "long_name": "wind speed"}),
        },
    )
    bases = sorted({WORLDS[world][0] for world in asked.worlds})
    flights = {base: rust.load_config(base) for base in bases}
    return Findings("Wind from the wrench", data, by_world, flights=flights, files=[PERTURBATION])


STUDY = Study("wind_observer", __doc__, WindEstimate, compute, ("turbulence",), backend="rust")
main = STUDY.main


def configurations(world: World, speed: float, flights: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield perturbed flights in turbulent winds of this speed, from directions all around."""
    name, model = WORLDS[world]
    settings = {"simulator.duration": DURATION, "controller.wind_observer": True}
    table = rust.load_config(name, settings)
    if model is not None:
        table["controller"]["aero"] = copy.deepcopy(keys.get(table, model))
    robot = rust.Robot(table["robot"])
    perturbation = tables.load(PERTURBATION, Perturbation)
    for repeat in range(flights):
        config = copy.deepcopy(table)
        angle = 2.0 * np.pi * (repeat + 0.5) / flights
        std = TURBULENCE * speed
        config["wind"] = {
            "profile": "turbulent",
            "velocity": [speed * float(np.cos(angle)), speed * float(np.sin(angle)), 0.0],
            "ramp_start": 2.0,
            "ramp_end": 5.0,
            "std": [std, std, 0.3 * std],
            "time_scale": 2.0,
            "seed": 0,
        }
        perturbation.apply(config, seed, repeat, robot)
        yield config


def wind_errors(log: Mapping[str, NDArray[np.float64]]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the length of the horizontal error in every tick, and which components are within their interval."""
    known = log["time"] >= KNOWN
    error = (log["measured_wind"] - log["wind"])[known, :2]
    return np.linalg.norm(error, axis=1), np.abs(error) < QUANTILE * log["measured_wind_std"][known, :2]
