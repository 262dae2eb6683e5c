"""Identification of a second-order engine (M32) from throttle and thrust, and of the noise of its estimator (M35).

1. Local cubics smooth the thrust and give its two derivatives; linear least squares give all coefficients except b_uu.
2. Output error: segments of 1 s are simulated (M33) from their smoothed initial states, then segments of 20 s, and
   Levenberg-Marquardt adjusts all ten coefficients to match the thrusts.
3. For the estimator, R follows from the residual noise, Q from the likelihood of the innovations.

Thrusts that are missing in a log are NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import savgol_coeffs, savgol_filter

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


# --- identification


def fill(values: Array) -> Array:
    """Return values with those that are missing on the line between their neighbours."""
    row, known = np.arange(values.size), np.isfinite(values)
    return np.interp(row, row[known], values[known])


def smooth(thrust: Array) -> SmoothedThrust:
    """Return thrust and two derivatives by least-squares cubics over `2 WINDOW + 1` samples."""
    thrust = fill(thrust)
    return SmoothedThrust(
        *(savgol_filter(thrust, 2 * WINDOW + 1, 3, order, STEP, mode="nearest") for order in range(3))
    )


def regression(log: Log, rows: Array) -> Array:
    """Return the ten coefficients by linear least squares on smoothed derivatives, with b_uu = 0."""
    t, d, a = smooth(log.thrust)
    u = log.throttle
    inner = np.isfinite(log.thrust) & rows
    inner[: 2 * WINDOW] = inner[-2 * WINDOW :] = False
    columns = np.stack([t, t * t, d, d * d, t * d, u, t * u, d * u, np.ones_like(t)], axis=1)[inner]
    size = np.abs(columns).max(axis=0)
    k = np.linalg.lstsq(columns / size, a[inner], rcond=None)[0] / size
    return np.array([*k[:8], 0.0, k[8]])


def identify(log: Log, limits: Array, rows: Array | None = None) -> Array:
    """Return the twelve numbers of an engine, with the `limits` of its throttle [%], from some `rows` (N,) or all."""
    rows = np.full(log.time.size, fill_value=True) if rows is None else rows
    found = regression(log, rows)
    for segment in (min(segment, log.time.size - 1) for segment in SEGMENTS):
        residual = residual_of(log, limits, segment, rows)
        # Scales of the coefficients, which differ by orders of magnitude; a zero gets the typical size of b_uu.
        scale = np.where(found == 0.0, 1e-3, np.abs(found))
        slope = jax.jit(jax.jacfwd(residual))
        found = least_squares(jax.jit(residual), found, slope, method="lm", x_scale=scale).x
    return np.concatenate([found, limits])


def residual_of(log: Log, limits: Array, segment: int, rows: Array) -> Callable[[Any], Any]:
    """Return the difference between simulated segments and the log [N] as a function of the ten coefficients."""
    n = (log.time.size - 1) // segment
    smoothed = smooth(log.thrust)
    firsts = segment * np.arange(n)
    throttle = jnp.asarray(log.throttle[: n * segment].reshape(n, segment))
    seen = jnp.asarray(log.thrust[1 : n * segment + 1].reshape(n, segment))
    # Without a thrust at its start a segment tells nothing.
    known = np.isfinite(log.thrust[1 : n * segment + 1]) & rows[1 : n * segment + 1]
    known = known.reshape(n, segment) & np.isfinite(log.thrust[firsts, None])
    start = jnp.asarray(np.stack([smoothed.thrust[firsts], smoothed.rate[firsts]], axis=1))

    def residual(k: Any) -> Any:
        engine = Engines(*k, *limits)

        def step(state: Any, u: Any) -> Any:
            after = _step(engine, state[..., 0], state[..., 1], u)
            return jnp.stack(after, axis=-1), after[0]

        _, thrusts = jax.lax.scan(step, start, throttle.T)
        # A bad guess may diverge; its error is bounded so that it still indicates the better direction.
        return jnp.where(known, jnp.clip(thrusts.T - jnp.nan_to_num(seen), -1e3, 1e3), 0.0).ravel()

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
    _, (states, likelihood) = jax.lax.scan(step, start, (jnp.asarray(fill(log.thrust)), jnp.asarray(log.throttle)))
    return np.asarray(states), float(likelihood[10:].sum())


def tune(engine: Array, log: Log) -> tuple[Array, float]:
    """Return Q and R: R from the noise about the smoothed thrust, Q diagonal with the greatest likelihood on a grid.

    The residual of a cubic through 2 w + 1 samples is smaller than the noise, by the weight of the middle sample.
    """
    taken = savgol_coeffs(2 * WINDOW + 1, 3)[WINDOW]
    left = fill(log.thrust) - smooth(log.thrust).thrust
    # The median is insensitive to the edges of steps, which a cubic does not follow.
    variance = (np.median(np.abs(left)) / 0.6745) ** 2 / (1.0 - taken)
    r = float(variance * STEP)
    grid = [np.diag([a, b]) for a in 10.0 ** np.arange(-4.0, 2.0) for b in 10.0 ** np.arange(-2.0, 4.0)]
    return max(grid, key=lambda q: estimate(engine, log, q, r)[1]), r
