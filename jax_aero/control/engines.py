"""Which engines follow their commands.

    d ← e^{−Δt/τ} d + (T_k − T̂_k)          how far a thrust has left the commanded one
    n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)   what the momentum says beside the observed wrench

Equations M105 and M106 of `docs/model.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.types import Array, pytree


@pytree
class EngineLimits:
    """When an engine counts as lost."""

    time_constant: Float[Array, ""]
    """[s]."""
    deviation_max: Float[Array, ""]
    """[N]."""
    confirmation: Float[Array, ""]
    """[s]."""
    descend: Float[Array, ""]
    """1 where the robot descends then, 0 where it flies on."""


class EngineState(NamedTuple):
    """What is known of the engines."""

    deviation: Float[Array, " j"]
    """`d` [N]."""
    suspected: Float[Array, " j"]
    """How long it has been too large [s]."""
    is_lost: Bool[Array, " j"]
    """Whether they are lost; for good."""


def start(like: Float[Array, " j"]) -> EngineState:
    """Return what is known of engines with thrusts like these at first."""
    return EngineState(jnp.zeros_like(like), jnp.zeros_like(like), jnp.zeros(like.shape, bool))


def update(
    limits: EngineLimits,
    last: EngineState,
    dt: Float[Array, ""],
    innovation: Float[Array, " j"],
    a_t: Float[Array, "6 j"],
    residual: Float[Array, "6"],
) -> tuple[EngineState, Bool[Array, " j"], Float[Array, " j"]]:
    """Take in by how much thrusts are not the predicted ones.

    Also return which sensors are wrong, and by how much.

    `a_t` takes thrusts to the momentum's rate, `residual` is the `n` above [N, N m].
    """
    deviation = jnp.exp(-dt / limits.time_constant) * last.deviation + innovation
    exceeds = ~last.is_lost & (jnp.abs(deviation) > limits.deviation_max)
    suspected = jnp.where(exceeds, last.suspected + dt, 0.0)
    # Half a tick is for rounding.
    is_sure = exceeds & (suspected >= limits.confirmation + 0.5 * dt)
    explained = -(a_t.T @ residual) / jnp.sum(a_t**2, axis=0)
    is_wrong = is_sure & (explained * jnp.sign(deviation) > 0.5 * jnp.abs(deviation))
    is_lost = last.is_lost | (is_sure & ~is_wrong)
    # A sensor that is no longer accepted says nothing about its engine.
    after = EngineState(jnp.where(is_wrong, 0.0, deviation), jnp.where(is_wrong, 0.0, suspected), is_lost)
    return after, is_wrong, deviation
