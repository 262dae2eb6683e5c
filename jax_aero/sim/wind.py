"""Wind as a function of time: the velocity of the air in inertial axes, uniform in space.

Equations M36 to M38 of `docs/model`.
"""

from __future__ import annotations

from typing import TypeAlias, assert_never

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from jax_aero import config, rust
from jax_aero.types import Array, leaf, leaves, pytree


@pytree
class ConstantWind:
    """A wind that is constant in time."""

    velocity: Float[Array, "3"]
    """Velocity [m/s]."""


@pytree
class RampWind:
    """Still air, then a linear rise to a constant wind: the published profile."""

    velocity: Float[Array, "3"]
    """Velocity after the ramp [m/s]."""
    ramp_start: Float[Array, ""]
    """Start of the ramp [s]."""
    ramp_end: Float[Array, ""]
    """End of the ramp [s]."""


@pytree
class GustWind:
    """A steady wind with one additional "1 − cos" gust."""

    velocity: Float[Array, "3"]
    """Steady velocity [m/s]."""
    gust: Float[Array, "3"]
    """Additional velocity at the peak [m/s]."""
    start: Float[Array, ""]
    """Start of the gust [s]."""
    duration: Float[Array, ""]
    """Duration of the gust [s]."""


@pytree
class RecordedWind:
    """A recorded wind: linear between samples, constant before and after them."""

    times: Float[Array, " k"]
    """Times [s], increasing."""
    velocities: Float[Array, "k 3"]
    """Velocities [m/s]."""


@pytree
class TurbulentWind:
    """A ramp with turbulence that rises with it: a sum of sines with the spectrum of a Gauss–Markov process.

    The random numbers are drawn when the wind is built and are leaves like all other numbers.
    """

    mean: RampWind
    std: Float[Array, "3"]
    """Standard deviation of the turbulence [m/s]."""
    time_scale: Float[Array, ""]
    """Time scale τ of the turbulence [s]."""
    places: Float[Array, "3 24"]
    """Position of each sine in the spectrum, in bands of equal variance."""
    phases: Float[Array, "3 24"]
    """Phases [rad]."""


Wind: TypeAlias = ConstantWind | RampWind | GustWind | RecordedWind | TurbulentWind
"""A wind as a function of time."""

WAVES = 24
"""Number of sines per axis."""
TURBULENCE_STREAM = 2


def wind_model(settings: config.WindConfig) -> Wind:
    """Return the configured wind. Call it outside loops, since it reads files and draws random numbers."""
    match settings:
        case config.ConstantWindConfig():
            return leaves(ConstantWind, settings)
        case config.RampWindConfig():
            return leaves(RampWind, settings)
        case config.GustWindConfig():
            return leaves(GustWind, settings)
        case config.TurbulentWindConfig():
            places, phases = _waves(settings.seed)
            mean = leaves(RampWind, settings)
            return TurbulentWind(mean, leaf(settings.std), leaf(settings.time_scale), places, phases)
        case config.FileWindConfig() | config.SamplesWindConfig():
            samples = rust.recorded_wind(msgspec.to_builtins(settings))
            return RecordedWind(times=leaf(samples[:, 0]), velocities=leaf(samples[:, 1:]))
        case _:
            assert_never(settings)


def _waves(seed: int) -> tuple[Array, Array]:
    """Draw the sines of turbulence: axis by axis, a position in every band and a phase."""
    draws = rust.uniforms(seed, TURBULENCE_STREAM, 3 * WAVES * 2).reshape(3, WAVES, 2)
    # The edges of bands are excluded, since the upper edge of the last band has infinite frequency.
    places = (np.arange(WAVES) + 0.25 + 0.5 * draws[..., 0]) / WAVES
    return leaf(places), leaf(2.0 * np.pi * draws[..., 1])


def wind_velocity(wind: Wind, time: Float[Array, ""]) -> Float[Array, "3"]:
    """Return the velocity of the air at `time` [s] [m/s, inertial axes]."""
    match wind:
        case ConstantWind():
            return jnp.asarray(wind.velocity)
        case RampWind():
            return _ramp_fraction(wind, time) * wind.velocity
        case TurbulentWind():
            return _ramp_fraction(wind.mean, time) * (wind.mean.velocity + _turbulence(wind, time))
        case GustWind():
            phase = (time - wind.start) / wind.duration
            is_blowing = (phase >= 0.0) & (phase <= 1.0)
            strength = jnp.where(is_blowing, 0.5 * (1.0 - jnp.cos(2.0 * jnp.pi * phase)), 0.0)
            return wind.velocity + strength * wind.gust
        case RecordedWind():
            times, velocities = jnp.asarray(wind.times), jnp.asarray(wind.velocities)
            return jnp.stack([jnp.interp(time, times, component) for component in velocities.T])
        case _:
            assert_never(wind)


def _ramp_fraction(wind: RampWind, time: Array) -> Array:
    """Return the fraction of the ramp that has passed, from 0 to 1."""
    has_length = wind.ramp_end > wind.ramp_start
    length = jnp.where(has_length, wind.ramp_end - wind.ramp_start, 1.0)
    risen = jnp.where(time >= wind.ramp_end, 1.0, jnp.maximum((time - wind.ramp_start) / length, 0.0))
    return jnp.where(has_length | (time >= wind.ramp_end), risen, 0.0)


def _turbulence(wind: TurbulentWind, time: Array) -> Array:
    """Return the velocity (3,) [m/s] added to the mean: on every axis a sum of sines of equal variance.

    ```text
    Σ √(2/n) σ sin(ω t + φ),   ω τ = tan(π/2 · place)      whose spectrum is  S(ω) ∝ σ² τ / (1 + ω² τ²)
    ```
    """
    frequencies = jnp.tan(0.5 * jnp.pi * jnp.asarray(wind.places)) / wind.time_scale
    waves = jnp.sin(frequencies * time + wind.phases)
    return wind.std * jnp.sqrt(2.0 / waves.shape[1]) * jnp.sum(waves, axis=1)
