"""Observer of the wrench that the controller's model does not contain, from the centroidal momentum alone.

```text
w    = L̇ − r,   r = A_T T + A_a f_a − m g e₃                      unmodelled wrench
dŵ/dt = K_o (w − ŵ)                                               observed wrench
ŵ   += (1 − exp(−K_o Δt)) ((L_k − L_{k−1})/Δt − r_{k−1} − ŵ)      per tick, then limited
```

Inertial axes, about the centre of mass, force first.

Equations M82 to M84 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.types import Array, pytree


@pytree
class ObserverGains:
    """Gains of the observer and the greatest wrench that it estimates."""

    gain_force: Float[Array, ""]
    """`K_o` of the force [1/s]."""
    gain_moment: Float[Array, ""]
    """`K_o` of the moment [1/s]."""
    force_max: Float[Array, ""]
    """Greatest observed force along each axis [N]."""
    moment_max: Float[Array, ""]
    """Greatest observed moment about each axis [N m]."""


class ObserverState(NamedTuple):
    """State of the observer between two ticks."""

    wrench: Float[Array, "6"]
    """`ŵ` [N, N m]."""
    is_known: Bool[Array, ""]
    """Whether momentum and rate below are those of a last tick."""
    momentum: Float[Array, "6"]
    """Centroidal momentum `L` [kg m/s, kg m²/s]."""
    rate: Float[Array, "6"]
    """Its rate as modelled, `r` [N, N m]."""


def start(like: Float[Array, "..."]) -> ObserverState:
    """Return the initial state, in the precision of `like`."""
    nothing = jnp.zeros(6, like.dtype)
    return ObserverState(nothing, jnp.array(False), nothing, nothing)


def update(
    gains: ObserverGains,
    time_step: Float[Array, ""],
    last: ObserverState,
    momentum: Float[Array, "6"],
    rate: Float[Array, "6"],
) -> ObserverState:
    """Process a tick, `time_step` [s] after the last one; `ŵ` stays in the first one, and if numbers overflow."""
    shares = -jnp.expm1(-time_step * _repeat_axes(gains.gain_force, gains.gain_moment))
    moved = last.wrench + shares * ((momentum - last.momentum) / time_step - last.rate - last.wrench)
    limits = _repeat_axes(gains.force_max, gains.moment_max)
    is_used = last.is_known & jnp.all(jnp.isfinite(moved))
    wrench = jnp.where(is_used, jnp.clip(moved, -limits, limits), last.wrench)
    return ObserverState(wrench, jnp.array(True), momentum, rate)


def _repeat_axes(force: Array, moment: Array) -> Array:
    return jnp.repeat(jnp.stack([jnp.asarray(force), jnp.asarray(moment)]), 3)
