"""The measured wind, with the errors of a wind sensor or of a wind estimate.

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
from jaxtyping import Bool, Float, Int

from jax_aero import rust
from jax_aero.config import WindEstimateConfig
from jax_aero.control.measurement import Measurement
from jax_aero.sim.disturbance import Disturbance, Moment
from jax_aero.sim.wind import Wind, wind_velocity
from jax_aero.types import Array, leaf, pytree

NOISE_STREAM = 0


@pytree
class WindEstimate(Disturbance):
    """Errors of the measured wind of one flight. The state is the measured wind of the last tick [m/s]."""

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

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Return the length of the noise, and the wind unless its mean is known not to be used.

        A traced switch is not known.
        """
        is_unused = not isinstance(self.is_mean, jax.core.Tracer) and not np.asarray(self.is_mean).any()
        return ("n_ticks",) if is_unused else ("n_ticks", "measured_wind")

    def start(self, first: Measurement) -> Float[Array, "3"]:
        """Return a wind that is not used, since the low pass starts in steady state."""
        return jnp.zeros_like(first.wind)

    def measure(
        self, state: Float[Array, "3"], given: Measurement, moment: Moment
    ) -> tuple[Float[Array, "3"], Measurement]:
        """Measure the wind with its errors (M39); the first wind until the delay has passed."""
        then = jnp.maximum(moment.tick - self.delay_ticks, 0).astype(state.dtype) * moment.time_step
        wind = jnp.where(self.is_mean, self.mean, wind_velocity(moment.measured_wind, then))
        drawn = self.noise[jnp.minimum(moment.tick, self.noise.shape[0] - 1)]
        measured = wind + self.bias + self.noise_std * drawn
        has_filter = (self.time_constant > 0.0) & (moment.tick > 0)
        share = -jnp.expm1(-moment.time_step / jnp.where(has_filter, self.time_constant, 1.0))
        measured = jnp.where(has_filter, state + (measured - state) * share, measured)
        return measured, given._replace(wind=measured)


def wind_estimate(settings: WindEstimateConfig, time_step: Float[Array, ""], wind: Wind, n_ticks: int) -> WindEstimate:
    """Return the errors of a flight in a wind. Call it outside loops, since it draws noise."""
    ticks = n_ticks + 1
    # Half a tick rounds up.
    delay = np.floor(np.asarray(settings.delay) / np.asarray(time_step) + 0.5)
    times = np.arange(ticks) * np.asarray(time_step)
    winds: Array = jax.jit(jax.vmap(wind_velocity, in_axes=(None, 0)))(wind, times)
    return WindEstimate(
        bias=leaf(settings.bias),
        noise_std=leaf(settings.noise_std),
        noise=jnp.asarray(rust.normals(settings.seed, NOISE_STREAM, 3 * ticks).reshape(ticks, 3)),
        delay_ticks=jnp.asarray(delay, jnp.int32),
        time_constant=leaf(settings.time_constant),
        mean=jnp.mean(winds, axis=0),
        is_mean=jnp.asarray(settings.mean_only, bool),
    )
