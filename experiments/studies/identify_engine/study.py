"""An engine identified from a log of a test bench.

`jax-aero study identify_engine NAME --set bench=FILE` reads a dataset of `jax-aero data import-bench` with speeds of
the shaft, thrusts, or both, and identifies an engine of the shaft's speed (M176, `shaft`). `span` is the time of the
run. Every 5 s of it are also predicted by the fit to the rest.

The result goes to `results/identify_engine/NAME/`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from experiments.studies.identify_engine import shaft
from jax_aero.base import tables
from jax_aero.base.tables import Interval, Positive
from jax_aero.base.terminal import Refused
from jax_aero.body.shaft import DENSITY, TEMPERATURE, Ambient
from jax_aero.data.import_bench import load_bench
from jax_aero.results.study import Findings, Study


class EngineLogs(tables.Table, frozen=True):
    """Logs of a bench."""

    bench: Path | None = None
    """Dataset of `jax-aero data import-bench`, without which nothing is identified."""
    span: Interval | None = None
    """Times between which the engine runs [s]; by default the whole log."""
    density: Positive = DENSITY
    """Density of the air on the bench [kg/m³]."""
    temperature: Positive = TEMPERATURE
    """Its temperature [K]."""


def compute(name: str, logs: EngineLogs) -> Findings:
    """Identify an engine of the shaft's speed."""
    if logs.bench is None:
        raise Refused("there is no log; expected --set bench=FILE, a dataset of `jax-aero data import-bench`")
    ambient = Ambient.of(logs.density, logs.temperature)
    bench, span = load_bench(logs.bench), logs.span
    run = shaft.sample(bench, (span.lower, span.upper) if span else (bench.time[0], bench.time[-1]), ambient)
    fitted = shaft.identify(run)
    full = fitted.numbers["thrust_max"]
    summary: dict[str, Any] = {"sha256 of the log": bench.sha256, **shaft.listing(run, fitted)}
    summary |= shaft.errors(run, fitted.speed, fitted.thrust, full, "simulated")
    summary |= shaft.errors(run, run.speed, fitted.thrust_of_speed, full, "of the measured speed")
    speed, thrust = fitted.held_out
    summary |= shaft.errors(run, speed, thrust, full, "each 5 s predicted by the rest")
    signals = {"speed_simulated": fitted.speed, "thrust_simulated": fitted.thrust}
    signals |= {key: getattr(run, key) for key in ("wanted", "throttle", "speed", "thrust", "drift")}
    data = xr.Dataset({key: (("time",), value) for key, value in signals.items()}, {"time": run.time})
    return Findings(f"Engine {name} identified on a bench", data, summary)


STUDY = Study("identify_engine", __doc__, EngineLogs, compute, ("engine",), backend="jax")
main = STUDY.main
