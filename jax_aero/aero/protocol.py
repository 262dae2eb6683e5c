"""Inputs and outputs of an aerodynamic model: the interface for user-defined models."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jax_aero.body.robot import RobotModel
from jax_aero.types import Array, Kinematics


class LinksInAir(NamedTuple):
    """The links of a robot in the air; inertial axes. A model uses the fields it needs."""

    axes: Float[Array, "L 3"]
    """Unit axes of symmetry."""
    v_air: Float[Array, "L 3"]
    """Velocity of the air relative to each link [m/s]."""
    wind: Float[Array, "3"]
    """Velocity of the air [m/s], without the motion of the links."""
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
    """Return the force on each link [N] from a model, after a check of its shape.

    Raises
    ------
    ValueError
        If the shape is wrong, which broadcasting would hide; raised when the model is traced.
    """
    forces = model.forces(links)
    if (shape := np.shape(forces)) != (expected := np.shape(links.v_air)):
        raise ValueError(f"`forces` of {type(model).__name__} has shape {shape}; expected {expected}")
    return forces
