"""An engine of the speed of its shaft: control unit, shaft, thrust (M176 of `docs/model`).

    throttle ──control unit──► wanted speed ──shaft──► speed ──thrust_of──► thrust

Speeds are shares of the full speed. Air of another density and temperature scales them (`Ambient`).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.types import Array

DENSITY, TEMPERATURE = 1.225, 288.15
"""Density [kg/m³] and temperature [K] of the standard atmosphere at sea level (ISO 2533)."""


class Shaft(NamedTuple):
    """Numbers of an engine, or of several."""

    idle: Float[Array, "..."]
    """Speed at idle, a share of the full speed."""
    ramp_up: Float[Array, "..."]
    """Greatest rate of the wanted speed upwards [1/s]."""
    ramp_down: Float[Array, "..."]
    lag_up: Float[Array, "..."]
    """Time constant of the speed below the wanted one [s]."""
    lag_down: Float[Array, "..."]
    acceleration: Float[Array, "..."]
    """Greatest acceleration at full speed [1/s]."""
    deceleration: Float[Array, "..."]
    exponent: Float[Array, "..."]
    """Exponent of the speed in both of them."""
    thrust_max: Float[Array, "..."]
    """Thrust at full speed [N]."""
    square_share: Float[Array, "..."]
    """Share of the thrust that is proportional to the square of the speed; the rest is to its cube."""


class Ambient(NamedTuple):
    """Air that an engine takes in, relative to the standard atmosphere.

    Engines of equal corrected speed `n/√θ` are similar: thrust and torque are proportional to the pressure ratio `δ`.
    Source: Volponi, Gas Turbine Parameter Corrections, J. Eng. Gas Turbines Power 121 (1999) 613.
    """

    pressure: Float[Array, ""] | float = 1.0
    """`δ = σ θ`."""
    temperature: Float[Array, ""] | float = 1.0
    """`θ`."""

    @classmethod
    def of(cls, density: float, temperature: float) -> Ambient:
        """Return the ratios of air of a density [kg/m³] and a temperature [K]."""
        theta = temperature / TEMPERATURE
        return cls(density / DENSITY * theta, theta)


STANDARD = Ambient()


def wanted_speed(e: Shaft, throttle: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the speed that a throttle [%] demands."""
    return e.idle + (1.0 - e.idle) * jnp.clip(throttle, 0.0, 100.0) / 100.0


def step_wanted(
    e: Shaft, wanted: Float[Array, "..."], goal: Float[Array, "..."], dt: Float[Array, ""] | float
) -> Float[Array, "..."]:
    """Return the wanted speed of the control unit after `dt` [s]: it moves towards its goal within its ramps."""
    return wanted + jnp.clip(goal - wanted, -dt * e.ramp_down, dt * e.ramp_up)


def speed_rate(
    e: Shaft, speed: Float[Array, "..."], wanted: Float[Array, "..."], ambient: Ambient = STANDARD
) -> Float[Array, "..."]:
    """Return the acceleration of the shaft [1/s]: `clip((n_w − n)/τ, −δ d (n/√θ)ᵏ, δ a (n/√θ)ᵏ)`."""
    error = wanted - speed
    torque = ambient.pressure * (speed / jnp.sqrt(ambient.temperature)) ** e.exponent
    lag = jnp.where(error > 0.0, e.lag_up, e.lag_down)
    return jnp.clip(error / lag, -e.deceleration * torque, e.acceleration * torque)


def thrust_of(e: Shaft, speed: Float[Array, "..."], ambient: Ambient = STANDARD) -> Float[Array, "..."]:
    """Return the thrust [N] at a speed: `δ T_max n_c² (b + (1 − b) n_c)`, `n_c = n/√θ`."""
    corrected = speed / jnp.sqrt(ambient.temperature)
    share = e.square_share + (1.0 - e.square_share) * corrected
    return ambient.pressure * e.thrust_max * corrected * corrected * share
