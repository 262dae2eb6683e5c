"""The measured wind: the simulated wind with errors.

```text
wind ──(mean only)──► delay ──► + bias + noise ──► low pass ──► the controller
```

The wind is a function of time, so a delay needs no memory; noise is drawn before the flight.

Equation M39 of `docs/model.md`.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from jax_aero import noise
from jax_aero.config import WindEstimateConfig
from jax_aero.types import Array, pytree

NOISE_STREAM = 0


@pytree
class WindEstimate:
    """Errors of the wind estimate of one flight."""

    bias: Array
    """(3,) [m/s]."""
    noise_std: Array
    """() [m/s]."""
    noise: Array
    """(ticks, 3) of standard deviation one."""
    delay_ticks: Array
    """() int32: delay of the measured wind."""
    time_constant: Array
    """() of the low pass [s]; zero for none."""
    mean: Array
    """(3,) over the flight [m/s]."""
    tells_mean: Array
    """() whether the mean is measured instead of the wind, bool."""


def wind_estimate(settings: WindEstimateConfig, time_step: Array, winds: Array) -> WindEstimate:
    """Errors of a flight in which the true winds are `winds` (ticks, 3) [m/s]. Outside loops: noise is drawn here."""
    ticks = len(winds)
    # Half a tick rounds up.
    delay = np.floor(np.asarray(settings.delay) / np.asarray(time_step) + 0.5)
    return WindEstimate(
        bias=settings.bias,
        noise_std=settings.noise_std,
        noise=jnp.asarray(noise.normals(settings.seed, NOISE_STREAM, 3 * ticks).reshape(ticks, 3)),
        delay_ticks=jnp.asarray(delay, jnp.int32),
        time_constant=settings.time_constant,
        mean=jnp.mean(winds, axis=0),
        tells_mean=jnp.asarray(settings.mean_only, bool),
    )


def told_wind(
    estimate: WindEstimate, wind_at: Callable[[Array], Array], before: Array, tick: Array, time_step: Array
) -> Array:
    """Wind (3,) [m/s] measured in this tick; `before` is that of the last tick.

    Before the delay has passed, the first wind is measured; the low pass starts settled.
    """
    then = jnp.maximum(tick - estimate.delay_ticks, 0) * time_step
    wind = jnp.where(estimate.tells_mean, estimate.mean, wind_at(then))
    drawn = estimate.noise[jnp.minimum(tick, estimate.noise.shape[0] - 1)]
    measured = wind + estimate.bias + estimate.noise_std * drawn
    has_filter = (estimate.time_constant > 0.0) & (tick > 0)
    share = -jnp.expm1(-time_step / jnp.where(has_filter, estimate.time_constant, 1.0))
    return jnp.where(has_filter, before + (measured - before) * share, measured)
