"""A second-order engine (M32) identified from a test bench log, validated on another, its estimator tuned.

`jax-aero study identify_engine P220` generates two logs of an engine in the robot's file, in the format of a
bench: time, throttle and thrust with noise, at 100 Hz. `--set train=FILE --set test=FILE` reads real logs: CSV files
with the columns `time_s,throttle_percent,thrust_n`, at any rate from 100 Hz on.

1. Local cubics smooth thrust and give its two derivatives; linear least squares give all coefficients except b_uu.
2. Output error: segments of 1 s are simulated (M33) from their smoothed initial states, then segments of 20 s, and
   Levenberg-Marquardt adjusts all ten coefficients to match the thrusts.
3. The whole other log is simulated from its first sample.
4. For the estimator (M35), R follows from the residual noise, Q from the likelihood of the innovations.

The result goes to `results/identify_engine/NAME/`; `jax-aero figures engine` draws it.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import savgol_coeffs, savgol_filter

from experiments import Refused
from experiments.study import Findings, Study
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import ConfigError
from jax_aero.body.jets import (
    Engines,
    EngineState,
    SecondOrderJets,
    drift,
    input_gain,
    throttle_input,
    thrust_acceleration,
    update_ekf,
)
from jax_aero.body.robot import ENGINE_KEYS

COLUMNS = ("time_s", "throttle_percent", "thrust_n")
STEP = 0.01
"""Sampling time of a log and of the simulated controller [s]."""
FINE = 10
"""Integration steps of the generator per sample, since a real engine is not a discrete model."""
NOISE = 1.0
"""Standard deviation of the noise on the generated thrust [N]."""
WINDOW = 10
"""Number of samples on either side in the fit of a local cubic."""
SEGMENTS = (100, 2000)
"""Samples per simulated segment: short ones converge from far away, long ones are insensitive to the initial state."""
PUBLISHED_Q, PUBLISHED_R = np.array([[10.0, 1.0], [1.0, 10.0]]), 1.0

Array = NDArray[np.float64]


class Log(NamedTuple):
    """Log of a test on the bench."""

    time: Array
    """Times [s], equally spaced."""
    throttle: Array
    """Throttle [%]."""
    thrust: Array
    """Measured thrust [N]."""


class SmoothedThrust(NamedTuple):
    """Thrust and its derivatives from local cubics."""

    thrust: Array
    rate: Array
    acceleration: Array


class EngineLogs(tables.Table, frozen=True):
    """Logs for identification and validation; without them they are generated from an engine of the robot's file."""

    train: Path | None = None
    test: Path | None = None

    def __post_init__(self) -> None:
        if (self.train is None) != (self.test is None):
            raise ConfigError.of("", None, "both `train` and `test`, or none")


def compute(name: str, logs: EngineLogs) -> Findings:
    """Generate or read logs, identify, validate and tune."""
    table = tables.read(ROBOT)["engines"]
    if name not in table:
        raise Refused(f"no engine `{name}`; there are {', '.join(table)}")
    truth = np.array([table[name][key] for key in ENGINE_KEYS], dtype=float)
    read = [read_log(path) for path in (logs.train, logs.test) if path]
    train, test = read or [bench_log(truth, seed) for seed in (1, 2)]
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
    data.attrs |= {"q_thrust": q[0, 0], "q_rate": q[1, 1], "r": r, "made": int(not read)}
    texts = {} if read else {"train.csv": log_text(train), "test.csv": log_text(test)}
    return Findings(f"{name} identified from a log", data, figures(data), files=[ROBOT], texts=texts)


STUDY = Study("identify_engine", __doc__, EngineLogs, compute, ("P220",), engine="jax")
main = STUDY.main


# --- logs


def bench_log(engine: Array, seed: int, seconds: float = 60.0) -> Log:
    """Return a generated log of a test: throttle in steps and ramps between 25 and 100 %, thrust with noise.

    The engine is integrated with ten steps per sample; `seed` determines throttle and noise.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP) + 1
    throttle = profile(rng, n)
    e = Engines(*engine.tolist())
    thrust, rate = steady_start(e, throttle[0]), 0.0
    measured = np.empty(n)
    for tick in range(n):
        measured[tick] = thrust
        for _ in range(FINE):
            acceleration = acceleration_of(e, thrust, rate, throttle[tick])
            thrust, rate = advance_thrust(thrust, rate, acceleration, STEP / FINE)
    return Log(np.linspace(0.0, seconds, n), throttle, measured + rng.normal(scale=NOISE, size=n))


def profile(rng: np.random.Generator, n: int) -> Array:
    """Return a throttle profile [%]: levels of 1 to 4 s, reached at once or by a ramp of up to 2 s."""
    throttle, level = np.empty(n), 50.0
    start = 0
    while start < n:
        goal = rng.uniform(25.0, 100.0)
        ramp = int(rng.choice([0.0, rng.uniform(0.3, 2.0)]) / STEP)
        hold = int(rng.uniform(1.0, 4.0) / STEP)
        part = np.concatenate([np.linspace(level, goal, ramp, endpoint=False), np.full(hold, goal)])
        end = min(n, start + part.size)
        throttle[start:end] = part[: end - start]
        start, level = end, goal
    return throttle


def steady_start(e: Any, throttle: float) -> float:
    """Return the steady thrust [N] at a throttle [%], by simulating one minute."""
    thrust, rate = 50.0, 0.0
    for _ in range(6000):
        thrust, rate = advance_thrust(thrust, rate, acceleration_of(e, thrust, rate, throttle), STEP)
    return thrust


def acceleration_of(e: Any, thrust: Any, rate: Any, throttle: Any) -> float:
    """Return the thrust acceleration of M32 [N/s²] at a throttle within its range, in plain numbers."""
    return float(drift(e, thrust, rate) + input_gain(e, thrust, rate) * throttle_input(e, throttle))


def advance_thrust(thrust: Any, rate: Any, acceleration: Any, step: float) -> tuple[Any, Any]:
    """Return thrust and rate after a step of M33."""
    return thrust + step * (rate + 0.5 * step * acceleration), rate + step * acceleration


def read_log(path: Path) -> Log:
    """Read a log of a test bench; of a faster one every step has the last sample until then.

    Raises
    ------
    Refused
        If the file is invalid; the message names it and what was expected.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        values = np.array([[float(row[column]) for column in COLUMNS] for row in rows])
    except OSError as reason:
        raise Refused(f"cannot read `{path}`: {reason.strerror}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise Refused(f"`{path}` is no log; expected numbers in the columns {', '.join(COLUMNS)}") from None
    if not np.isfinite(values).all():
        raise Refused(f"`{path}` holds numbers that are not finite; expected finite ones")
    gaps = np.diff(values[:, 0])
    if not (gaps > 0.0).all() or gaps.max(initial=0.0) > 1.05 * STEP:
        raise Refused(f"`{path}`: samples are {gaps.min():g} to {gaps.max():g} s apart; expected 0 to {STEP:g} s")
    if gaps.min(initial=STEP) < 0.95 * STEP:
        times = np.arange(values[0, 0], values[-1, 0] + 0.05 * STEP, STEP)
        values = values[np.searchsorted(values[:, 0], times + 0.05 * STEP) - 1]
        values[:, 0] = times
    if len(values) <= SEGMENTS[-1]:
        raise Refused(f"`{path}` holds {len(values)} steps of {STEP:g} s; expected more than {SEGMENTS[-1]}")
    return Log(*values.T)


def log_text(log: Log) -> str:
    """Return a log in the format of `read_log`."""
    rows = "\n".join(f"{t:.2f},{u:.4f},{thrust:.4f}" for t, u, thrust in zip(*log, strict=True))
    return f"{','.join(COLUMNS)}\n{rows}\n"


# --- identification


def smooth(thrust: Array) -> SmoothedThrust:
    """Return thrust and two derivatives by least-squares cubics over `2 WINDOW + 1` samples."""
    return SmoothedThrust(
        *(savgol_filter(thrust, 2 * WINDOW + 1, 3, order, STEP, mode="nearest") for order in range(3))
    )


def regression(log: Log) -> Array:
    """Return the ten coefficients by linear least squares on smoothed derivatives, with b_uu = 0."""
    t, d, a = smooth(log.thrust)
    u = log.throttle
    inner = slice(2 * WINDOW, -2 * WINDOW)
    columns = np.stack([t, t * t, d, d * d, t * d, u, t * u, d * u, np.ones_like(t)], axis=1)[inner]
    size = np.abs(columns).max(axis=0)
    k = np.linalg.lstsq(columns / size, a[inner], rcond=None)[0] / size
    return np.array([*k[:8], 0.0, k[8]])


def identify(log: Log, limits: Array) -> Array:
    """Return the twelve numbers of an engine, including the `limits` of its throttle [%]."""
    found = regression(log)
    for segment in SEGMENTS:
        residual = residual_of(log, limits, segment)
        # Scales of the coefficients, which differ by orders of magnitude; a zero gets the typical size of b_uu.
        scale = np.where(found == 0.0, 1e-3, np.abs(found))
        slope = jax.jit(jax.jacfwd(residual))
        found = least_squares(jax.jit(residual), found, slope, method="lm", x_scale=scale).x
    return np.concatenate([found, limits])


def residual_of(log: Log, limits: Array, segment: int) -> Callable[[Any], Any]:
    """Return the difference between simulated segments and the log [N] as a function of the ten coefficients."""
    n = (log.time.size - 1) // segment
    smoothed = smooth(log.thrust)
    firsts = segment * np.arange(n)
    throttle = jnp.asarray(log.throttle[: n * segment].reshape(n, segment))
    seen = jnp.asarray(log.thrust[1 : n * segment + 1].reshape(n, segment))
    start = jnp.asarray(np.stack([smoothed.thrust[firsts], smoothed.rate[firsts]], axis=1))

    def residual(k: Any) -> Any:
        engine = Engines(*k, *limits)

        def step(state: Any, u: Any) -> Any:
            after = _step(engine, state[..., 0], state[..., 1], u)
            return jnp.stack(after, axis=-1), after[0]

        _, thrusts = jax.lax.scan(step, start, throttle.T)
        # A bad guess may diverge; its error is bounded so that it still indicates the better direction.
        return jnp.clip(thrusts.T - seen, -1e3, 1e3).ravel()

    return residual


def _step(engine: Engines, thrust: Any, rate: Any, throttle: Any) -> tuple[Any, Any]:
    return advance_thrust(thrust, rate, thrust_acceleration(engine, thrust, rate, throttle), STEP)


def simulate(engine: Array, throttle: Array, smoothed: SmoothedThrust) -> Array:
    """Return the thrust [N] of the whole log, simulated from its first sample."""
    e = Engines(*engine)

    def step(state: Any, u: Any) -> Any:
        return _step(e, state[0], state[1], u), state[0]

    _, thrusts = jax.lax.scan(step, (jnp.asarray(smoothed.thrust[0]), jnp.asarray(0.0)), jnp.asarray(throttle))
    return np.asarray(thrusts)


# --- estimator


def estimate(engine: Array, log: Log, q: Array, r: float) -> tuple[Array, float]:
    """Return thrust and rate (n, 2) estimated by M35, and the log likelihood of the innovations up to a constant."""
    model = SecondOrderJets(
        engines=Engines(*(jnp.array([value]) for value in engine)),
        thrust_min=jnp.zeros(1),
        q=jnp.asarray(q),
        r=jnp.asarray(r),
        feedback_is_estimated=True,
    )
    one = jnp.ones(1)

    def step(state: EngineState, sample: Any) -> Any:
        seen, throttle = sample
        variance = state.covariance[0, 0, 0] + model.r / STEP
        error = seen - state.estimate[0, 0]
        found, covariance = update_ekf(model, state, seen * one, throttle * one, STEP)
        likelihood = -0.5 * (jnp.log(variance) + error * error / variance)
        return state._replace(estimate=found, covariance=covariance), (state.estimate[0], likelihood)

    start = EngineState(one, jnp.array([[smooth(log.thrust).thrust[0], 0.0]]), 10.0 * jnp.eye(2)[None])
    _, (states, likelihood) = jax.lax.scan(step, start, (jnp.asarray(log.thrust), jnp.asarray(log.throttle)))
    return np.asarray(states), float(likelihood[10:].sum())


def tune(engine: Array, log: Log) -> tuple[Array, float]:
    """Return Q and R: R from the noise about the smoothed thrust, Q diagonal with the greatest likelihood on a grid.

    The residual of a cubic through 2 w + 1 samples is smaller than the noise, by the weight of the middle sample.
    """
    taken = savgol_coeffs(2 * WINDOW + 1, 3)[WINDOW]
    left = log.thrust - smooth(log.thrust).thrust
    # The median is insensitive to the edges of steps, which a cubic does not follow.
    variance = (np.median(np.abs(left)) / 0.6745) ** 2 / (1.0 - taken)
    r = float(variance * STEP)
    grid = [np.diag([a, b]) for a in 10.0 ** np.arange(-4.0, 2.0) for b in 10.0 ** np.arange(-2.0, 4.0)]
    return max(grid, key=lambda q: estimate(engine, log, q, r)[1]), r


# --- result


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
    # For a generated log the truth is known; for a real one the smoothed log is the best substitute.
    true_thrust = np.asarray(dataset["thrust_file" if dataset.attrs["made"] else "thrust_smoothed"])
    for label in ("tuned", "published"):
        state = np.asarray(dataset[f"estimate_{label}"])
        found[f"estimator, {label}: rms thrust error [N]"] = rms(state[:, 0] - true_thrust)
        found[f"estimator, {label}: rms rate error [N/s]"] = rms(state[:, 1] - np.gradient(true_thrust, STEP))
    for key in ("q_thrust", "q_rate", "r"):
        if key in dataset.attrs:
            found[f"tuned {key}"] = float(dataset.attrs[key])
    return found
