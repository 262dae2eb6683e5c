"""An engine identified from a log of a test bench.

`jax-aero study identify_engine P220` generates two logs of an engine of the robot's file, identifies the second-order
engine (M32, `second_order`) from one, validates it on the other, and tunes its estimator (M35).

`--set bench=FILE` reads a dataset of `jax-aero data import-bench` with speeds of the shaft, thrusts, or both, and
identifies an engine of the shaft's speed (M176, `shaft`), and M32 beside it from the thrusts. `span` is the
time of the run. Every 5 s of it are also predicted by the fit to the rest, and with `test` another run, from its first
sample.

The result goes to `results/identify_engine/NAME/`; `jax-aero figures engine` draws that of the generated logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr

from experiments import Refused
from experiments.data.import_bench import load_bench
from experiments.studies.identify_engine import shaft
from experiments.studies.identify_engine.second_order import (
    PUBLISHED_Q,
    PUBLISHED_R,
    STEP,
    Array,
    Log,
    bench_log,
    estimate,
    identify,
    simulate,
    smooth,
    tune,
)
from experiments.study import Findings, Study
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from jax_aero.base.tables import Interval, Positive
from jax_aero.base.terminal import ConfigError
from jax_aero.body.robot import ENGINE_KEYS
from jax_aero.body.shaft import DENSITY, TEMPERATURE, Ambient

THROTTLE = np.array([0.0, 100.0])
"""Range of the throttle of a bench [%]."""


class EngineLogs(tables.Table, frozen=True):
    """Logs of a bench; without them they are generated from an engine of the robot's file."""

    bench: Path | None = None
    """Dataset of `jax-aero data import-bench`."""
    span: Interval | None = None
    """Times between which the engine runs [s]; by default the whole log."""
    test: Path | None = None
    """Another run of the engine, of which nothing is identified."""
    test_span: Interval | None = None
    density: Positive = DENSITY
    """Density of the air on the bench [kg/m³]."""
    temperature: Positive = TEMPERATURE
    """Its temperature [K]."""

    def __post_init__(self) -> None:
        if self.bench is None and self.test is not None:
            raise ConfigError.of("test", str(self.test), "none without `bench`")


def compute(name: str, logs: EngineLogs) -> Findings:
    """Identify the engine of a log, or that of generated ones."""
    return of_bench(name, logs) if logs.bench else of_made_logs(name)


def of_made_logs(name: str) -> Findings:
    """Generate logs, identify, validate and tune."""
    table = tables.read(ROBOT)["engines"]
    if name not in table:
        raise Refused(f"no engine `{name}`; there are {', '.join(table)}")
    truth = np.array([table[name][key] for key in ENGINE_KEYS], dtype=float)
    train, test = (bench_log(truth, seed) for seed in (1, 2))
    with jax.enable_x64(True):
        found = identify(train, truth[10:])
        whole = simulate(found, test.throttle, smooth(test.thrust))
        of_file = simulate(truth, test.throttle, smooth(test.thrust))
        q, r = tune(found, train)
        estimates = {
            label: estimate(found, test, *numbers)[0]
            for label, numbers in (("tuned", (q, r)), ("published", (PUBLISHED_Q, PUBLISHED_R)))
        }
    data = to_dataset(test, found, truth, whole, of_file, estimates)
    data.attrs |= {"q_thrust": q[0, 0], "q_rate": q[1, 1], "r": r}
    return Findings(f"{name} identified from a log", data, figures(data), files=[ROBOT])


def of_bench(name: str, logs: EngineLogs) -> Findings:
    """Identify an engine of the shaft's speed, and M32 beside it."""
    ambient = Ambient.of(logs.density, logs.temperature)
    benches = [(load_bench(path), span) for path, span in _logs(logs)]
    runs = [shaft.sample(bench, _span(bench, span), ambient) for bench, span in benches]
    run = runs[0]
    fitted = shaft.identify(run)
    full = fitted.numbers["thrust_max"]
    summary: dict[str, Any] = {"sha256 of the log": benches[0][0].sha256, **shaft.listing(run, fitted)}
    summary |= shaft.errors(run, fitted.speed, fitted.thrust, full, "simulated")
    summary |= shaft.errors(run, run.speed, fitted.thrust_of_speed, full, "of the measured speed")
    speed, thrust = fitted.held_out
    summary |= shaft.errors(run, speed, thrust, full, "each 5 s predicted by the rest")
    signals = {"speed_simulated": fitted.speed, "thrust_simulated": fitted.thrust}
    if np.isfinite(run.thrust).any():
        whole, held_out = of_second_order(run)
        for label, thrust in (("M32", whole), ("M32, each 5 s predicted by the rest", held_out)):
            summary |= shaft.errors(run, np.nan * thrust, thrust, full, label)
        signals["thrust_second_order"] = whole
    for other in runs[1:]:
        with jax.enable_x64(True):
            speed, thrust, of_speed = (np.asarray(part) for part in shaft.predict(other, fitted.numbers))
        # Speeds of both are shares of their own full speed; a test is of the same engine.
        summary |= shaft.errors(other, speed, thrust, full, "test, predicted")
        summary |= shaft.errors(other, other.speed, of_speed, full, "test, of the measured speed")
    signals |= {key: getattr(run, key) for key in ("wanted", "throttle", "speed", "thrust", "drift")}
    data = xr.Dataset({key: (("time",), value) for key, value in signals.items()}, {"time": run.time})
    return Findings(f"Engine {name} identified on a bench", data, summary)


def of_second_order(run: shaft.Run) -> tuple[Array, Array]:
    """Return thrusts [N] simulated by M32: fitted to the run, and of every block by the fit to the rest."""
    throttle = 100.0 * (run.wanted - run.wanted.min()) / np.ptp(run.wanted) if run.has_wanted else run.throttle
    block, held_out = run.blocks, np.full(run.time.size, np.nan)

    def fitted_to(rows: Array) -> Array:
        with jax.enable_x64(True):
            found = identify(Log(run.time, throttle, run.thrust), THROTTLE, rows)
            return simulate(found, throttle, smooth(run.thrust))

    for left in range(block[-1] + 1):
        held_out[block == left] = fitted_to(block != left)[block == left]
    return fitted_to(block >= 0), held_out


def _logs(logs: EngineLogs) -> list[tuple[Path, Interval | None]]:
    return [(path, span) for path, span in ((logs.bench, logs.span), (logs.test, logs.test_span)) if path]


def _span(bench: Any, span: Interval | None) -> tuple[float, float]:
    return (float(bench.time[0]), float(bench.time[-1])) if span is None else (span.lower, span.upper)


STUDY = Study("identify_engine", __doc__, EngineLogs, compute, ("P220",), engine="jax")
main = STUDY.main


def to_dataset(
    log: Log, found: Array, truth: Array, whole: Array, of_file: Array, estimates: Mapping[str, Array]
) -> xr.Dataset:
    """Return the validation log, the models' thrusts and the estimates as a labelled dataset."""
    smoothed = smooth(log.thrust)
    variables: dict[str, Any] = {
        "throttle": (("time",), log.throttle, {"units": "%"}),
        "thrust": (("time",), log.thrust, {"units": "N", "long_name": "measured"}),
        "thrust_smoothed": (("time",), smoothed.thrust, {"units": "N"}),
        "rate_smoothed": (("time",), smoothed.rate, {"units": "N/s"}),
        "thrust_identified": (("time",), whole, {"units": "N", "long_name": "simulated from the first sample"}),
        "thrust_file": (("time",), of_file, {"units": "N", "long_name": "the same, coefficients of the file"}),
        "found": (("coefficient",), found),
        "file": (("coefficient",), truth),
    }
    for label, states in estimates.items():
        variables[f"estimate_{label}"] = (("time", "state"), states, {"units": "N, N/s"})
    coordinates = {"time": ("time", log.time, {"units": "s"}), "coefficient": list(ENGINE_KEYS), "state": ["T", "Tdot"]}
    return xr.Dataset(variables, coordinates)


def figures(dataset: xr.Dataset) -> dict[str, float]:
    """Return rms errors on the validation log [N]."""
    span = float(dataset["thrust_smoothed"].max() - dataset["thrust_smoothed"].min())
    inner = slice(50, -50)

    def rms(values: Any) -> float:
        return float(np.sqrt(np.mean(np.asarray(values)[inner] ** 2)))

    found = {"noise: measured less smoothed [N]": rms(dataset["thrust"] - dataset["thrust_smoothed"])}
    for label, name in (("identified", "thrust_identified"), ("of the file", "thrust_file")):
        error = rms(dataset[name] - dataset["thrust_smoothed"])
        found[f"thrust simulated, {label}: rms error [N]"] = error
        found[f"thrust simulated, {label}: rms error [% of range]"] = 100.0 * error / span
    true_thrust = np.asarray(dataset["thrust_file"])
    for label in ("tuned", "published"):
        state = np.asarray(dataset[f"estimate_{label}"])
        found[f"estimator, {label}: rms thrust error [N]"] = rms(state[:, 0] - true_thrust)
        found[f"estimator, {label}: rms rate error [N/s]"] = rms(state[:, 1] - np.gradient(true_thrust, STEP))
    for key in ("q_thrust", "q_rate", "r"):
        if key in dataset.attrs:
            found[f"tuned {key}"] = float(dataset.attrs[key])
    return found
