"""Errors of the measured wind.

```text
wind ──(mean only)──► delay ──► + bias + noise ──► low pass ──► measured wind
```

The wind is a function of time, so the delay needs no state; noise is drawn before the flight.

Equation M39 of `docs/model`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jax_aero import rust
from jax_aero.config import WindEstimateConfig
from jax_aero.sim.wind import Wind, wind_velocity
from jax_aero.types import Array, leaf, pytree

STREAM = 0


@pytree
class WindEstimate:
    """Errors of the measured wind of one flight. Their state is the measured wind of the last tick [m/s]."""

    bias: Float[Array, "3"]
    """[m/s, inertial axes]."""
    noise_std: Float[Array, ""]
    """Standard deviation of the noise [m/s]."""
    noise: Float[Array, "ticks 3"]
    """Noise of unit standard deviation."""
    age: Int[Array, ""]
    """Age of the wind [ticks]."""
    time_constant: Float[Array, ""]
    """Time constant of the low pass [s]; zero for none."""
    mean: Float[Array, "3"] | None
    """Mean of the wind over the flight [m/s], if only that is measured."""

    def measure(
        self, state: Float[Array, "3"], wind: Wind, tick: Int[Array, ""], time_step: Float[Array, ""]
    ) -> Float[Array, "3"]:
        """Return the measured wind of a tick [m/s]; until the delay has passed, that of the first wind."""
        then = jnp.maximum(tick - self.age, 0).astype(state.dtype) * time_step
        true = wind_velocity(wind, then) if self.mean is None else jnp.asarray(self.mean)
        measured = true + self.bias + self.noise_std * self.noise[jnp.minimum(tick, self.noise.shape[0] - 1)]
        is_filtered = (self.time_constant > 0.0) & (tick > 0)
        share = -jnp.expm1(-time_step / jnp.where(is_filtered, self.time_constant, 1.0))
        return jnp.where(is_filtered, state + (measured - state) * share, measured)


def wind_estimate(settings: WindEstimateConfig, wind: Wind, time_step: float, ticks: int, drawn: int) -> WindEstimate:
    """Return the errors of a flight of `ticks` ticks in a wind. Call it outside loops, since it draws noise.

    Noise is that of `drawn` ticks.
    """
    times = time_step * jnp.arange(ticks + 1)
    return WindEstimate(
        bias=leaf(settings.bias),
        noise_std=leaf(settings.noise_std),
        noise=jnp.asarray(rust.normals(settings.seed, STREAM, 3 * (drawn + 1)).reshape(-1, 3)),
        age=jnp.asarray(np.floor(settings.delay / time_step + 0.5), jnp.int32),  # half a tick rounds up
        time_constant=leaf(settings.time_constant),
        mean=jnp.mean(jax.vmap(wind_velocity, in_axes=(None, 0))(wind, times), axis=0) if settings.mean_only else None,
    )
