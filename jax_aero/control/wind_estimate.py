"""The measured wind, with the errors of a wind sensor or estimate.

```text
wind ──(mean only)──► delay ──► + bias + noise ──► low pass ──► measured wind
```

The wind is a function of time, so a delay needs no memory; noise is drawn before the flight.

Equation M39 of `docs/model.md`.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero import noise
from jax_aero.config import WindEstimateConfig
from jax_aero.types import Array, leaf, pytree

NOISE_STREAM = 0


@pytree
class WindEstimate:
    """Errors of the wind estimate of one flight."""

    bias: Float[Array, "3"]
    """[m/s]."""
    noise_std: Float[Array, ""]
    """[m/s]."""
    noise: Float[Array, "ticks 3"]
    """Of standard deviation one."""
    delay_ticks: Int[Array, ""]
    """Age of the measured wind."""
    time_constant: Float[Array, ""]
    """Of the low pass [s]; zero for none."""
    mean: Float[Array, "3"]
    """Over the flight, of the wind that it was prepared with [m/s]."""
    is_mean: Bool[Array, ""]
    """Whether that mean is all that is measured."""


def wind_estimate(
    settings: WindEstimateConfig, time_step: Float[Array, ""], winds: Float[Array, "ticks 3"]
) -> WindEstimate:
    """Errors of a flight in which the true winds are `winds` [m/s]. Outside loops: noise is drawn here."""
    ticks = len(winds)
    # Half a tick rounds up.
    delay = np.floor(np.asarray(settings.delay) / np.asarray(time_step) + 0.5)
    return WindEstimate(
        bias=leaf(settings.bias),
        noise_std=leaf(settings.noise_std),
        noise=jnp.asarray(noise.normals(settings.seed, NOISE_STREAM, 3 * ticks).reshape(ticks, 3)),
        delay_ticks=jnp.asarray(delay, jnp.int32),
        time_constant=leaf(settings.time_constant),
        mean=jnp.mean(winds, axis=0),
        is_mean=jnp.asarray(settings.mean_only, bool),
    )


def measured_wind(
    estimate: WindEstimate,
    wind_at: Callable[[Float[Array, ""]], Float[Array, "3"]],
    before: Float[Array, "3"],
    tick: Int[Array, ""],
    time_step: Float[Array, ""],
) -> Float[Array, "3"]:
    """Measured wind [m/s] of this tick; `before` is that of the last.

    Until the delay has passed the first wind is measured; the low pass starts settled.
    """
    then = jnp.maximum(tick - estimate.delay_ticks, 0) * time_step
    wind = jnp.where(estimate.is_mean, estimate.mean, wind_at(then))
    drawn = estimate.noise[jnp.minimum(tick, estimate.noise.shape[0] - 1)]
    measured = wind + estimate.bias + estimate.noise_std * drawn
    has_filter = (estimate.time_constant > 0.0) & (tick > 0)
    share = -jnp.expm1(-time_step / jnp.where(has_filter, estimate.time_constant, 1.0))
    return jnp.where(has_filter, before + (measured - before) * share, measured)
