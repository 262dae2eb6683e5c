"""Factors on the aerodynamic forces of a model: along the relative wind, across it, and by link.

Equation M40 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.aero.protocol import AeroModel, LinksInAir, forces_of
from jax_aero.body.robot import RobotModel
from jax_aero.config import ForceFactorsConfig
from jax_aero.types import Array, leaf, pytree


@pytree
class WeightedModel:
    """Another model with its forces scaled by factors."""

    model: AeroModel
    drag: Float[Array, " L"]
    """Factors on the components along `v_air`."""
    normal: Float[Array, " L"]
    """Factors on the components across `v_air`."""
    links: Float[Array, " L"]
    """Factors on the whole force on each link."""

    def forces(self, links: LinksInAir) -> Float[Array, "L 3"]:
        """Return the force on each link [N], inertial axes.

        F ← w_link ( w_drag F_∥ + w_normal (F − F_∥) ),   F_∥ = (F · v̂) v̂,   v̂ = v_air / |v_air|
        """
        forces, v_air = forces_of(self.model, links), links.v_air
        square = jnp.sum(v_air**2, axis=1, keepdims=True)
        is_still = square == 0.0
        share = jnp.sum(forces * v_air, axis=1, keepdims=True) / jnp.where(is_still, 1.0, square)
        along = jnp.where(is_still, 0.0, share * v_air)
        return self.links[:, None] * (self.drag[:, None] * along + self.normal[:, None] * (forces - along))


def weight_forces(model: AeroModel, factors: ForceFactorsConfig, robot: RobotModel) -> AeroModel:
    """Return the model with factors on its forces, or the model itself without any."""
    if factors == ForceFactorsConfig():
        return model

    def by_link(every: float, named: Mapping[str, float] | None) -> Float[Array, " L"]:
        return every * leaf([(named or {}).get(name, 1.0) for name in robot.aero_links.names])

    return WeightedModel(
        model,
        by_link(factors.drag, factors.drag_of),
        by_link(factors.normal, factors.normal_of),
        by_link(factors.scale, factors.links),
    )
