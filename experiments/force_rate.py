"""How large is what the paper's controller neglects: the rate of the aerodynamic forces, along a flight.

`python -m experiments.force_rate [NAME]` flies an experiment (default test2) and splits the second derivative of the
centroidal momentum at every tick, with the derivatives of the symbolic implementation, into what the controller's QP
models (A_T Ṫ, Λ_T ν, Λ_a ν) and what it leaves out (link forces that change as links turn, as they accelerate, as the
wind changes). The result goes to `results/force_rate/NAME/`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from experiments import Refused, flight, study
from jax_aero import rust
from jax_aero.summary import SETTLING_TIME
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.momentum import ForceRate

"""The first seconds of a flight, a free fall and its recovery, are left out of the figures [s]; as in the crate."""

KNOWN = ("thrust_rate", "lambda_t", "lambda_a")
NEGLECTED = ("attitude", "acceleration", "wind")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.force_rate", description=__doc__)
    parser.add_argument("name", nargs="?", default="test2", help="an experiment (default test2)")
    given = parser.parse_args(arguments)
    try:
        document = run(given.name)
    except Refused as reason:
        print(f"error: {reason}", file=sys.stderr)
        return 2
    for key, value in document["summary"].items():
        print(f"{key:<44} {value:.4g}")
    return 0


def run(name: str = "test2", duration: float | None = None) -> dict[str, Any]:
    """Fly, split, write; return the manifest."""
    path = flight.find(name)
    overrides = {} if duration is None else {"simulator.duration": duration}
    config = rust.load_config(path, overrides)
    started = time.perf_counter()
    model = MomentumModel(load_robot(config["robot"]), config["simulator"]["aero"])
    built = time.perf_counter()
    log = rust.fly(config).log
    flown = time.perf_counter()
    parts, mismatch = split(model, log)
    timings = {"build": built - started, "fly": flown - built, "split": time.perf_counter() - flown}

    digest = rust.config_digest(config)
    dataset = to_dataset(log["time"][1:-1], parts, title=f"{config['title']}: second derivative of the momentum")
    dataset.attrs["config_hash"] = digest
    summary = figures(dataset) | {"mismatch with differences of the log, rms over rms": mismatch}
    title = f"Neglected rate of the aerodynamic force, {config['title']}"
    document = study.build_manifest(name, title, config, digest, summary=summary, timings=timings)
    study.write(study.RESULTS / "force_rate" / name, dataset, document)
    return document


def split(model: MomentumModel, log: Mapping[str, Any]) -> tuple[ForceRate, float]:
    """Return the parts of L̈ at every tick but the first and last, (6, ticks) each, and how well they add up.

    Rates are central differences of the log. The parts are compared with the central difference of the logged momentum
    rate, which the crate computed: rms of the difference over the settled flight, relative to the rms of L̈. Where a
    command jumps, central differences see half of it.
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


def to_dataset(t: Any, parts: ForceRate, *, title: str) -> xr.Dataset:
    """Label the parts."""
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
    return xr.Dataset(
        variables, {"time": ("time", t, {"units": "s"}), "six": six}, {"title": title, "settling_time": SETTLING_TIME}
    )


def figures(dataset: xr.Dataset) -> dict[str, float]:
    """Return the sizes of known and neglected parts over the settled flight."""
    data = dataset.sel(time=slice(SETTLING_TIME, None))
    neglected = _sum(data, NEGLECTED)
    whole = neglected + _sum(data, KNOWN)
    found = {}
    for kind, unit, rows in (("force", "N/s", slice(0, 3)), ("moment", "N m/s", slice(3, 6))):
        sums = [("all of it", whole), ("neglected", neglected)]
        for name, signal in [*sums, *((name, data[name]) for name in (*KNOWN, *NEGLECTED))]:
            size = np.sqrt((signal.isel(six=rows) ** 2).sum("six"))
            found[f"{kind}, {name}, largest [{unit}]"] = float(size.max())
            found[f"{kind}, {name}, rms [{unit}]"] = float(np.sqrt((size**2).mean()))
    return found


def _sum(data: xr.Dataset, names: Sequence[str]) -> xr.DataArray:
    first, *others = (data[name] for name in names)
    for other in others:
        first = first + other
    return first


if __name__ == "__main__":
    sys.exit(main())
