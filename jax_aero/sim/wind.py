"""Wind as a function of time: the velocity of the air in inertial axes, the same everywhere."""

from __future__ import annotations

import jax.numpy as jnp

from jax_aero.config import ConstantWind, GustWind, RampWind, WindConfig
from jax_aero.types import Array


def wind_velocity(wind: WindConfig, time: Array) -> Array:
    """Velocity of the air (3,) at `time` [s]: m/s, inertial axes."""
    if isinstance(wind, ConstantWind):
        return jnp.asarray(wind.velocity)
    if isinstance(wind, RampWind):
        has_length = wind.ramp_end > wind.ramp_start
        length = jnp.where(has_length, wind.ramp_end - wind.ramp_start, 1.0)
        risen = jnp.where(time >= wind.ramp_end, 1.0, jnp.maximum((time - wind.ramp_start) / length, 0.0))
        return jnp.where(has_length | (time >= wind.ramp_end), risen, 0.0) * wind.velocity
    if isinstance(wind, GustWind):
        phase = (time - wind.start) / wind.duration
        is_blowing = (phase >= 0.0) & (phase <= 1.0)
        strength = jnp.where(is_blowing, 0.5 * (1.0 - jnp.cos(2.0 * jnp.pi * phase)), 0.0)
        return wind.velocity + strength * wind.gust
    return _between_samples(wind.times, wind.velocities, time)


def _between_samples(times: Array, velocities: Array, time: Array) -> Array:
    """Straight lines between samples, the end values outside."""
    velocities = jnp.asarray(velocities)
    return jnp.stack([jnp.interp(time, jnp.asarray(times), velocities[:, axis]) for axis in range(3)])
