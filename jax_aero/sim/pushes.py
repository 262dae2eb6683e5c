"""Pushes: forces and moments on bodies of the simulated robot, each for a time.

Bodies are structure; wrenches and times are numbers.

Equation M155 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.body.kinematics import generalised_force
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotate
from jax_aero.config import Push
from jax_aero.types import Array, Kinematics, Static, leaf, pytree


@pytree
class Pushes:
    """Pushes of a flight."""

    bodies: Static[tuple[int, ...]]
    forces: Float[Array, "p 3"]
    """At the bodies' centres of mass [N], inertial axes."""
    moments: Float[Array, "p 3"]
    """[N m], inertial axes."""
    durations: Float[Array, " p"]
    """[s]."""


def start_pushes(pushes: Sequence[Push], robot: RobotModel) -> tuple[Pushes, Float[Array, " p"]]:
    """Return the pushes of a flight, and the times until their starts [s]; the crate has checked their bodies."""
    bodies = tuple(robot.body_names.index(push.body) for push in pushes)
    forces, moments, durations, left = (
        jnp.asarray(leaf([getattr(push, name) for push in pushes])) for name in ("force", "moment", "duration", "start")
    )
    return Pushes(bodies, forces, moments, durations), left


def pushing_force(
    robot: RobotModel, kin: Kinematics, pushes: Pushes, left: Float[Array, " p"], step: Float[Array, ""]
) -> Float[Array, " N"]:
    """Return the mean generalised force over the next `step` [s] of pushes that start in `left` [s]."""
    acts = jnp.minimum(left + pushes.durations, step) - jnp.maximum(left, 0.0)
    share = jnp.maximum(acts, 0.0)[:, None] / step
    at = np.array(pushes.bodies, dtype=int)
    points = rotate(kin.body_rotations[at], robot.coms[at]) + kin.body_positions[at]
    return generalised_force(robot, kin, pushes.bodies, points, share * pushes.forces, share * pushes.moments)
