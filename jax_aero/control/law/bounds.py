"""Bounds of the momentum QP that keep thrusts and joint positions within their limits."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.types import Array


def rate_bounds(
    value: Float[Array, " k"],
    lower: Float[Array, " k"],
    upper: Float[Array, " k"],
    rate_max: Float[Array, " k"],
    steepness: Float[Array, ""],
) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
    """Return bounds on the rate of a value that itself has limits.

    ```text
    −r tanh(ε (x − x_min)) ≤ ẋ ≤ r tanh(ε (x_max − x))
    ```

    Far from the limits the bounds are ±r; at a limit the rate towards it is zero; beyond a limit the bound changes sign
    and forces the value back. `lower ≤ upper` holds for every x, since `tanh a + tanh b` has the sign of
    `a + b = ε (x_max − x_min) ≥ 0`. Equation M65 of `docs/model`.
    """
    return -rate_max * jnp.tanh(steepness * (value - lower)), rate_max * jnp.tanh(steepness * (upper - value))
