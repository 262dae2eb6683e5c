"""Whether the flight follows its set-point, or strays so far from it that it may be lost.

```text
φ̂ = log(R_dᵀ R) + T (R_dᵀ ω − ω_d)        rotation error in `horizon` T
p̂ = p_G − p_d + T (ṗ_G − ṗ_d)              error of the centre of mass in `horizon`
```

A flight strays if one of their lengths, or the speed of a joint, exceeds its limit for a confirmation time.

Equations M148 and M149 of `docs/model`.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.spatial import log_so3, multiply
from jax_aero.types import Array, Setpoint, State, pytree


@pytree
class SupervisorLimits:
    """When a flight strays from its set-point, and what is then done."""

    horizon: Float[Array, ""]
    """Time by which errors are extrapolated with their rates [s]."""
    rotation: Float[Array, ""]
    """Greatest extrapolated angle between the base and its set-point [rad]."""
    position: Float[Array, ""]
    """Greatest extrapolated distance of the centre of mass from its set-point [m]."""
    joint_velocity: Float[Array, ""]
    """Greatest velocity of a joint [rad/s]."""
    confirmation: Float[Array, ""]
    """Time for which a limit has to be exceeded [s]."""
    descend: Float[Array, ""]
    """1 where a flight that strays levels and descends, else 0."""


def update(
    limits: SupervisorLimits,
    exceeded: Float[Array, ""],
    elapsed: Float[Array, ""],
    state: State,
    com: Float[Array, "3"],
    com_velocity: Float[Array, "3"],
    setpoint: Setpoint,
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Return the time for which a limit has been exceeded [s], and whether the flight strays.

    `exceeded` is that time at the last tick, `elapsed` [s] ago; `com` [m] and `com_velocity` [m/s] are of the centre of
    mass.
    """
    to_desired = setpoint.rotation.T
    turning = to_desired @ state.velocity[3:6] - setpoint.angular_velocity
    rotation = log_so3(multiply(to_desired, state.base_rotation)) + limits.horizon * turning
    position = com - setpoint.com_position + limits.horizon * (com_velocity - setpoint.com_velocity)
    is_beyond = jnp.sum(rotation**2) > limits.rotation**2
    is_beyond |= jnp.sum(position**2) > limits.position**2
    is_beyond |= jnp.any(jnp.abs(state.velocity[6:]) > limits.joint_velocity)
    exceeded = jnp.where(is_beyond, exceeded + elapsed, 0.0)
    # A billionth absorbs the rounding of the sum.
    return exceeded, is_beyond & (exceeded >= limits.confirmation * (1.0 - 1e-9))
