"""The joint torque controller: torques whose joint accelerations follow the commanded joint velocities.

```text
s̈* = −K_D (ṡ − ṡ*) − K_P ∫(ṡ − ṡ*)
s̈(τ) = G τ + s̈_free,   G = (M⁻¹)_ss,   s̈_free = [M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a − h)]_s
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


@pytree
class TorqueParams:
    """Gains and weights of the torque QP."""

    kd: Float[Array, ""]
    """`K_D` [1/s]."""
    kp: Float[Array, ""]
    """`K_P` [1/s²]."""
    weight_acceleration: Float[Array, ""]
    weight_torque: Float[Array, ""]
    regularisation: Float[Array, ""]
    """`ε`, added to the diagonal."""


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
    share: Float[Array, " n"] | float = 1.0,
) -> TorqueQp:
    """Build the QP; `torque_max` is in N m, `gain` is `G`, `free` is `s̈_free`.

    Of each torque a `share` acts. The acceleration of joints of which none acts is not controlled.
    """
    penalty = params.weight_torque + params.regularisation
    share = jnp.broadcast_to(share, torque_max.shape)
    weighted = _weigh(params, gain, share)
    h = weighted @ gain
    h = 0.5 * (h + h.T) + penalty * jnp.eye(h.shape[0], dtype=h.dtype)
    desired = _desired(params, velocity_error, velocity_error_integral)
    most = share * torque_max
    return TorqueQp(desired, free, gain, BoxQp(h, weighted @ (free - desired), -most, most))


def torque_qp_again(
    params: TorqueParams,
    last: TorqueQp,
    velocity_error: Float[Array, " n"],
    velocity_error_integral: Float[Array, " n"],
    share: Float[Array, " n"],
) -> TorqueQp:
    """Build the QP for other joint velocities; all else is that of the last one."""
    desired = _desired(params, velocity_error, velocity_error_integral)
    g = _weigh(params, last.gain, share) @ (last.acceleration_free - desired)
    return last._replace(acceleration_desired=desired, problem=last.problem._replace(g=g))


def _weigh(params: TorqueParams, gain: Array, share: Array) -> Array:
    return jnp.where(share > 0.0, params.weight_acceleration, 0.0)[None] * gain


def _desired(params: TorqueParams, velocity_error: Array, velocity_error_integral: Array) -> Array:
    return -params.kd * velocity_error - params.kp * velocity_error_integral


def commanded(
    following: TorqueQp, torque_max: Float[Array, " n"], share: Float[Array, " n"], torque: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Return the torques to be commanded where `torque` is to act [N m]: more at weak joints.

    For a free one, the torque with which it would follow its command if it acted, so that the joint is in use again as
    soon as it does.
    """
    missing = following.acceleration_desired - following.acceleration_free - following.gain @ torque
    of_free = jnp.clip(missing / jnp.diag(following.gain), -torque_max, torque_max)
    acts = share > 0.0
    return jnp.where(acts, torque / jnp.where(acts, share, 1.0), of_free)


def limit_rate(torque: Float[Array, " n"], target: Float[Array, " n"], step: Float[Array, " n"]) -> Float[Array, " n"]:
    """Move `torque` towards `target` by at most `step` per entry."""
    return torque + jnp.clip(target - torque, -step, step)
