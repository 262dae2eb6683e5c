"""Size of the rate of aerodynamic forces along a flight, which the paper's controller neglects.

`jax-aero study force_rate [NAME]` flies an experiment (default test2) and decomposes the second derivative of
the centroidal momentum at every tick, by derivatives of the symbolic implementation, into the terms in the controller's
QP (A_T Ṫ, Λ_T ν, Λ_a ν) and those neglected (change of link forces due to rotation and acceleration of links and to
change of the wind). The result goes to `results/force_rate/NAME/`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments import Refused
from experiments.study import Findings, Study
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.rust import SETTLING_TIME
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.momentum import ForceRate

KNOWN = ("thrust_rate", "lambda_t", "lambda_a")
NEGLECTED = ("attitude", "acceleration", "wind")


class ForceRateConfig(tables.Table, frozen=True):
    """Experiment of the study, and its duration."""

    experiment: Path
    duration: tables.Positive | None = None
    """Duration that replaces the experiment's own [s]."""


def compute(name: str, settings: ForceRateConfig) -> Findings:
    """Fly and decompose."""
    overrides = {} if settings.duration is None else {"simulator.duration": settings.duration}
    config = rust.load_config(settings.experiment, overrides)
    model = MomentumModel(load_robot(config["robot"]), config["simulator"]["aero"])
    log = rust.fly(config).log
    if log["time"][-1] <= SETTLING_TIME:
        raise Refused(f"{name} ends at {log['time'][-1]:g} s; expected a `duration` beyond {SETTLING_TIME:g} s")
    parts, mismatch = split(model, log)
    dataset = to_dataset(log["time"][1:-1], parts)
    summary = figures(dataset) | {"mismatch with differences of the log, rms over rms": mismatch}
    return Findings(
        f"Second derivative of the momentum: {config.get('title') or name}",
        dataset,
        summary,
        flights={name: config},
    )


STUDY = Study("force_rate", __doc__, ForceRateConfig, compute, ("test2",), experiments=True)
main = STUDY.main


def split(model: MomentumModel, log: Mapping[str, Any]) -> tuple[ForceRate, float]:
    """Return the parts of L̈ at every tick except the first and last, (6, ticks) each, and the error of their sum.

    Rates are central differences of the log. The sum is compared with the central difference of the logged momentum
    rate, which the crate computed: rms difference over the settled flight, relative to the rms of L̈. If a command
    jumps, central differences contain half of the jump.
    """
    t = log["time"]
    dt = t[1] - t[0]

    def rate(signal: Any) -> Any:
        return (signal[2:] - signal[:-2]).T / (2 * dt)

    inner = slice(1, -1)
    velocity = np.hstack([log["base_velocity"], log["joint_velocity"]])
    parts = model.force_rate(
        log["base_position"][inner].T,
        np.hstack(list(rust.rotation_from_wxyz(log["base_quaternion"][inner]))),
        log["joint_position"][inner].T,
        velocity[inner].T,
        log["thrust"][inner].T,
        log["wind"][inner].T,
        acceleration=rate(velocity),
        thrust_rate=rate(log["thrust"]),
        wind_rate=rate(log["wind"]),
    )
    found, expected = sum(parts), rate(log["momentum_rate_estimate"])
    settled = t[inner] >= SETTLING_TIME
    error = np.linalg.norm((found - expected)[:, settled]) / np.linalg.norm(expected[:, settled])
    return parts, float(error)


def to_dataset(t: Any, parts: ForceRate) -> xr.Dataset:
    """Return the parts as a labelled dataset."""
    units = "N s-1 (linear), N m s-1 (angular)"
    meaning = {
        "thrust_rate": "A_T times thrust rate",
        "lambda_t": "Lambda_T times velocity",
        "lambda_a": "Lambda_a times velocity",
        "attitude": "neglected: link forces change as the links turn",
        "acceleration": "neglected: link forces change as the links accelerate",
        "wind": "neglected: link forces change as the wind does",
    }
    variables = {
        name: (("time", "six"), getattr(parts, name).T, {"units": units, "long_name": text})
        for name, text in meaning.items()
    }
    six = [f"{kind}_{axis}" for kind in ("linear", "angular") for axis in "xyz"]
    time = ("time", t, {"units": "s", "long_name": "time"})
    return xr.Dataset(variables, {"time": time, "six": six}, {"settling_time": SETTLING_TIME})


def figures(dataset: xr.Dataset) -> dict[str, float]:
    """Return the sizes of known and neglected parts over the settled flight."""
    data = dataset.sel(time=slice(SETTLING_TIME, None))
    neglected = reduce(add, (data[name] for name in NEGLECTED))
    whole = neglected + reduce(add, (data[name] for name in KNOWN))
    found = {}
    for kind, unit, rows in (("force", "N/s", slice(0, 3)), ("moment", "N m/s", slice(3, 6))):
        sums = [("all of it", whole), ("neglected", neglected)]
        for name, signal in [*sums, *((name, data[name]) for name in (*KNOWN, *NEGLECTED))]:
            size = np.sqrt((signal.isel(six=rows) ** 2).sum("six"))
            found[f"{kind}, {name}, largest [{unit}]"] = float(size.max())
            found[f"{kind}, {name}, rms [{unit}]"] = float(np.sqrt((size**2).mean()))
    return found
