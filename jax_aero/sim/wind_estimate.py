"""The measured wind, with the errors of a wind sensor or of a wind estimate.

```text
wind ──(mean only)──► delay ──► + bias + noise ──► low pass ──► measured wind
```

The wind is a function of time, so the delay needs no state; noise is drawn before the flight.

Equation M39 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero import rust
from jax_aero.config import WindEstimateConfig
from jax_aero.types import Array, leaf, pytree

NOISE_STREAM = 0


@pytree
class WindEstimate:
    """Errors of the measured wind of one flight."""

    bias: Float[Array, "3"]
    """Constant error [m/s]."""
    noise_std: Float[Array, ""]
    """Standard deviation of the noise [m/s]."""
    noise: Float[Array, "ticks 3"]
    """Noise of unit standard deviation."""
    delay_ticks: Int[Array, ""]
    """Age of the measured wind [ticks]."""
    time_constant: Float[Array, ""]
    """Time constant of the low pass [s]; zero for none."""
    mean: Float[Array, "3"]
    """Mean wind over the flight for which the errors were drawn [m/s]."""
    is_mean: Bool[Array, ""]
    """Whether only that mean is measured."""


def wind_estimate(
    settings: WindEstimateConfig, time_step: Float[Array, ""], winds: Float[Array, "ticks 3"]
) -> WindEstimate:
    """Return the errors of a flight with the true winds `winds` [m/s]. Call it outside loops, since it draws noise."""
    ticks = len(winds)
    # Half a tick rounds up.
    delay = np.floor(np.asarray(settings.delay) / np.asarray(time_step) + 0.5)
    return WindEstimate(
        bias=leaf(settings.bias),
        noise_std=leaf(settings.noise_std),
        noise=jnp.asarray(rust.normals(settings.seed, NOISE_STREAM, 3 * ticks).reshape(ticks, 3)),
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
    """Return the measured wind [m/s] of this tick; `before` is that of the last tick.

    The first wind is measured until the delay has passed; the low pass starts in steady state.
    """
    then = jnp.maximum(tick - estimate.delay_ticks, 0).astype(before.dtype) * time_step
    wind = jnp.where(estimate.is_mean, estimate.mean, wind_at(then))
    drawn = estimate.noise[jnp.minimum(tick, estimate.noise.shape[0] - 1)]
    measured = wind + estimate.bias + estimate.noise_std * drawn
    has_filter = (estimate.time_constant > 0.0) & (tick > 0)
    share = -jnp.expm1(-time_step / jnp.where(has_filter, estimate.time_constant, 1.0))
    return jnp.where(has_filter, before + (measured - before) * share, measured)
