"""Inputs and outputs of an aerodynamic model: the interface for user-defined models."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jax_aero.robot import RobotModel
from jax_aero.types import Array, Kinematics


class LinksInAir(NamedTuple):
    """The links of a robot as they stand in the air; inertial axes. A model uses what it needs."""

    axes: Float[Array, "L 3"]
    """Unit axes of symmetry."""
    v_air: Float[Array, "L 3"]
    """Velocity of the air relative to each link [m/s]."""
    wind: Float[Array, "3"]
    """Velocity of the air [m/s]."""
    robot: RobotModel
    kinematics: Kinematics


class AeroModel(Protocol):
    """An aerodynamic model: a pytree whose numbers are leaves (`jax_aero.types.pytree` makes one of a class).

    >>> @pytree
    ... class ConstantForce:
    ...     force: Array
    ...
    ...     def forces(self, links):
    ...         return jnp.broadcast_to(self.force, links.v_air.shape)
    """

    def forces(self, links: LinksInAir) -> Float[Array, "L 3"]:
        """Force on each link [N], inertial axes, at its aerodynamic centre. Pure, and traced by JAX."""
        ...


def forces_of(model: AeroModel, links: LinksInAir) -> Float[Array, "L 3"]:
    """Return the force on each link [N] that a model answers.

    Raises
    ------
    ValueError
        For an answer of another shape, as soon as it is traced: it would be spread over the links.
    """
    forces = model.forces(links)
    if (shape := np.shape(forces)) != (expected := np.shape(links.v_air)):
        raise ValueError(f"`forces` of {type(model).__name__} has shape {shape}; expected {expected}")
    return forces
