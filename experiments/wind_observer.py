"""How well the wind is known from the wrench: `python -m experiments wind-observer`.

Perturbed flights of TEST2 in turbulent winds from everywhere, in the world of the controller's model and in that of the
network, are flown by a controller that is told the wind by its wind observer. Printed are the root mean square of the
horizontal error and the share of the time that each horizontal component is within its 90 % interval, from 8 s on.
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments import flight, manifest
from experiments.sweep.perturbation import Perturbation
from jax_aero import rust, tables

SPEEDS = (6.0, 8.0, 10.0, 14.0, 18.0)
"""[m/s]."""
FLIGHTS = 20
"""Of each speed and world."""
DURATION, KNOWN = 20.0, 8.0
"""Of a flight, and from when on it is judged [s]."""
TURBULENCE = 0.1
"""Standard deviation of the wind over its speed."""
QUANTILE = 1.645
"""Of the normal distribution, for 90 %."""
WORLDS = {"the controller's model": "test2_observer", "the network": "robustness_observer"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments wind-observer", description=__doc__)
    parser.add_argument("--flights", type=int, default=FLIGHTS, help="of each speed and world")
    given = parser.parse_args(arguments)
    for world, name in WORLDS.items():
        for speed in SPEEDS:
            results = rust.fly_batch(list(configurations(name, speed, given.flights)), full_log=True)
            errors, inside = zip(*(judged(result.log) for result in results), strict=True)
            rms = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
            covered = float(np.mean(np.concatenate(inside)))
            flown = sum(result.outcome == "completed" for result in results)
            print(f"{world:<24} {speed:4g} m/s: rms {rms:.2f} m/s, {100 * covered:.0f} % inside, {flown} completed")
    return 0


def configurations(name: str, speed: float, flights: int) -> Iterator[dict[str, Any]]:
    """Yield perturbed flights in turbulent winds of this speed, from directions all around."""
    settings = {"simulator.duration": DURATION, "controller.wind_observer": {}}
    table = rust.load_config(flight.find(name), settings)
    links = rust.Robot(table["robot"]).aero_link_names
    perturbation = tables.convert(
        tables.read(manifest.REPOSITORY / "configs" / "perturbation" / "flight.toml"), Perturbation, "perturbation"
    )
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
        perturbation.apply(config, 1, repeat, links)
        yield config


def judged(log: Mapping[str, NDArray[np.float64]]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the length of the horizontal error in every tick, and which components are inside their interval."""
    known = log["time"] >= KNOWN
    error = (log["measured_wind"] - log["wind"])[known, :2]
    return np.linalg.norm(error, axis=1), np.abs(error) < QUANTILE * log["measured_wind_std"][known, :2]


if __name__ == "__main__":
    raise SystemExit(main())
