"""Identification of a second-order engine (M32) from throttle and thrust.

1. Local cubics smooth the thrust and give its two derivatives; linear least squares give all coefficients except b_uu.
2. Output error: segments of 1 s are simulated (M33) from their smoothed initial states, then segments of 20 s, and
   Levenberg-Marquardt adjusts all ten coefficients to match the thrusts.

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
from scipy.signal import savgol_filter

from jax_aero.body.jets import Engines, thrust_acceleration

STEP = 0.01
"""Sampling time of a log [s]."""
WINDOW = 10
"""Number of samples on either side in the fit of a local cubic."""
SEGMENTS = (100, 2000)
"""Samples per simulated segment: short ones converge from far away, long ones are insensitive to the initial state."""

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
    """Return thrust and rate after a step of M33."""
    acceleration = thrust_acceleration(engine, thrust, rate, throttle)
    return thrust + STEP * (rate + 0.5 * STEP * acceleration), rate + STEP * acceleration


def simulate(engine: Array, throttle: Array, smoothed: SmoothedThrust) -> Array:
    """Return the thrust [N] of the whole log, simulated from its first sample."""
    e = Engines(*engine)

    def step(state: Any, u: Any) -> Any:
        return _step(e, state[0], state[1], u), state[0]

    _, thrusts = jax.lax.scan(step, (jnp.asarray(smoothed.thrust[0]), jnp.asarray(0.0)), jnp.asarray(throttle))
    return np.asarray(thrusts)
