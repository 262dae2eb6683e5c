"""Aerodynamic forces that are stronger or weaker than a model says: along the air, across it, by link.

Equation M40 of `docs/model.md`.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.config import ForceFactorsConfig
from jax_aero.robot import RobotModel
from jax_aero.types import Array, LinkForces, pytree


@pytree
class ForceFactors:
    """Factors on the force of every link."""

    drag: Float[Array, ""]
    """On the part along `v_air`."""
    normal: Float[Array, ""]
    """On the part across it."""
    links: Float[Array, " L"]
    """On the whole force of a link."""


def force_factors(settings: ForceFactorsConfig, robot: RobotModel, table: str = "disturbances.aero") -> ForceFactors:
    """Bring factors into the order of the links; links that are not named keep their force. Errors name the `table`."""
    names = robot.aero_links.names
    if unknown := set(settings.links) - set(names):
        raise ValueError(f"{table}.links names {sorted(unknown)}; {robot.name} has {', '.join(names)}")
    one = jnp.ones_like(jnp.asarray(settings.drag))
    return ForceFactors(settings.drag, settings.normal, jnp.asarray([settings.links.get(name, one) for name in names]))


def weighted(link: LinkForces, factors: ForceFactors) -> LinkForces:
    """Change every force.

    F ← w_link ( w_drag F_∥ + w_normal (F − F_∥) ),   F_∥ = (F · v̂) v̂,   v̂ = v_air / |v_air|
    """
    square = jnp.sum(link.v_air**2, axis=1, keepdims=True)
    is_still = square == 0.0
    share = jnp.sum(link.forces * link.v_air, axis=1, keepdims=True) / jnp.where(is_still, 1.0, square)
    along = jnp.where(is_still, 0.0, share * link.v_air)
    changed = factors.drag * along + factors.normal * (link.forces - along)
    return link._replace(forces=factors.links[:, None] * changed)
