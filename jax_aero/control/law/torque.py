"""The joint torque controller: torques whose joint accelerations follow the commanded joint velocities.

```text
s̈* = −K_D (ṡ − ṡ*) − K_P ∫(ṡ − ṡ*)
s̈(τ) = G τ + s̈_free,   G = (M⁻¹)_ss,   s̈_free = [M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a − h − S F)]_s
min ½ w_a |s̈(τ) − s̈*|² + ½ (w_τ + ε) |τ|²   subject to |τ| ≤ τ_max
```

followed by a rate limiter. Since the base floats, `G` is the joint block of the inverse mass matrix, not the inverse of
the joint block. Equations M68 to M72 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.control.qp import BoxQp
from jax_aero.types import Array, pytree

WEIGHT_TORQUE = 0.001
REGULARISATION = 1e-4
"""`ε`, added to the diagonal."""


@pytree
class TorqueParams:
    """Gains and weights of the torque QP."""

    kd: Float[Array, ""]
    """`K_D` [1/s]."""
    kp: Float[Array, ""]
    """`K_P` [1/s²]."""
    weight_acceleration: Float[Array, ""]


class TorqueQp(NamedTuple):
    """The torque QP of one tick; `n` joints."""

    acceleration_desired: Float[Array, " n"]
    """`s̈*` [rad/s²]."""
    acceleration_free: Float[Array, " n"]
    """Joint accelerations without torque, `s̈_free` [rad/s²]."""
    gain: Float[Array, "n n"]
    """`G`, joint acceleration per unit of torque [1/(kg m²)]."""
    problem: BoxQp


def torque_qp(
    params: TorqueParams,
    torque_max: Float[Array, " n"],
    gain: Float[Array, "n n"],
    free: Float[Array, " n"],
    velocity_error: Float[Array, " n"],
    velocity_error_integral: Float[Array, " n"],
) -> TorqueQp:
    """Build the QP; `torque_max` is in N m, `gain` is `G`, `free` is `s̈_free`."""
    penalty = WEIGHT_TORQUE + REGULARISATION
    weighted = params.weight_acceleration * gain
    h = weighted @ gain
    h = 0.5 * (h + h.T) + penalty * jnp.eye(h.shape[0], dtype=h.dtype)
    desired = -params.kd * velocity_error - params.kp * velocity_error_integral
    return TorqueQp(desired, free, gain, BoxQp(h, weighted @ (free - desired), -torque_max, torque_max))


def limit_rate(torque: Float[Array, " n"], target: Float[Array, " n"], step: Float[Array, " n"]) -> Float[Array, " n"]:
    """Move `torque` towards `target` by at most `step` per entry."""
    return torque + jnp.clip(target - torque, -step, step)
