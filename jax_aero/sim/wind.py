"""Wind as a function of time: the velocity of the air in inertial axes, the same everywhere.

Equations M36 to M38 of `docs/model.md`.
"""

from __future__ import annotations

from typing import assert_never

import jax.numpy as jnp

from jax_aero.config import ConstantWind, GustWind, RampWind, RecordedWind, TurbulentWind, WindConfig
from jax_aero.types import Array


def wind_velocity(wind: WindConfig, time: Array) -> Array:
    """Velocity of the air (3,) at `time` [s]: m/s, inertial axes."""
    match wind:
        case ConstantWind():
            return jnp.asarray(wind.velocity)
        case RampWind():
            return _risen(wind, time) * wind.velocity
        case TurbulentWind():
            return _risen(wind, time) * (wind.velocity + _turbulence(wind, time))
        case GustWind():
            phase = (time - wind.start) / wind.duration
            is_blowing = (phase >= 0.0) & (phase <= 1.0)
            strength = jnp.where(is_blowing, 0.5 * (1.0 - jnp.cos(2.0 * jnp.pi * phase)), 0.0)
            return wind.velocity + strength * wind.gust
        case RecordedWind():
            return _between_samples(wind.times, wind.velocities, time)
        case _:
            assert_never(wind)


def _risen(wind: RampWind | TurbulentWind, time: Array) -> Array:
    """How far the wind has risen, from 0 to 1."""
    has_length = wind.ramp_end > wind.ramp_start
    length = jnp.where(has_length, wind.ramp_end - wind.ramp_start, 1.0)
    risen = jnp.where(time >= wind.ramp_end, 1.0, jnp.maximum((time - wind.ramp_start) / length, 0.0))
    return jnp.where(has_length | (time >= wind.ramp_end), risen, 0.0)


def _turbulence(wind: TurbulentWind, time: Array) -> Array:
    """Velocity (3,) [m/s] added to the mean: on every axis a sum of waves of equal variance.

    ```text
    Σ √(2/n) σ sin(ω t + φ),   ω τ = tan(π/2 · place)      whose spectrum is  S(ω) ∝ σ² τ / (1 + ω² τ²)
    ```
    """
    frequencies = jnp.tan(0.5 * jnp.pi * jnp.asarray(wind.places)) / wind.time_scale
    waves = jnp.sin(frequencies * time + wind.phases)
    return wind.std * jnp.sqrt(2.0 / waves.shape[1]) * jnp.sum(waves, axis=1)


def _between_samples(times: Array, velocities: Array, time: Array) -> Array:
    """Straight lines between samples, the end values outside."""
    velocities = jnp.asarray(velocities)
    return jnp.stack([jnp.interp(time, jnp.asarray(times), velocities[:, axis]) for axis in range(3)])
