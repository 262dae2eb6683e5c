"""Forces on all links of the robot, with the axes, points and velocities for which a model is evaluated.

The published code misplaces the points. Each of its errors is a switch; the physically correct way is the default.

Equations M18 and M27 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.aero.protocol import AeroModel, LinksInAir, forces_of
from jax_aero.body.kinematics import frame_poses, generalised_force, velocities_at
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import cross, rotate
from jax_aero.config import JacobianOffset, LeverArm, LinkVelocity
from jax_aero.types import Array, Kinematics, LinkForces


class LinkConventions(NamedTuple):
    """Conventions for the placement of points, one value for the simulator and one for the controller."""

    lever_arm: LeverArm = "rotated"
    jacobian_offset: JacobianOffset = "link_rotation"
    link_velocity: LinkVelocity = "at_centre"
    axes_of: int | None = None
    """Link with whose rotation the axes of all links turn, as published; `None` for each with its own."""


def link_forces(
    model: AeroModel, robot: RobotModel, kin: Kinematics, conventions: LinkConventions, wind: Float[Array, "3"]
) -> LinkForces:
    """Evaluate the model for every link in a wind [m/s, inertial axes]."""
    links = robot.aero_links
    rotations, origins = frame_poses(kin, links)
    centres = origins + rotate(rotations, links.centres)
    arm_points = centres if conventions.lever_arm == "rotated" else origins + links.centres
    jacobian_points = centres
    if conventions.jacobian_offset == "base_rotation":
        jacobian_points = origins + rotate(kin.body_rotations[:1], links.centres)
    shifted_twice = conventions.link_velocity == "shifted_twice"
    velocity_points = jacobian_points + links.centres if shifted_twice else centres
    turning = rotations if conventions.axes_of is None else rotations[conventions.axes_of][None]
    axes = rotate(turning, links.axes)
    v_air = wind[None] - velocities_at(kin, links.bodies, velocity_points)
    forces = forces_of(model, LinksInAir(axes, v_air, wind, robot, kin))
    return LinkForces(axes, v_air, arm_points, jacobian_points, forces)


def wrench_about(link: LinkForces, point: Float[Array, "3"]) -> Float[Array, "6"]:
    """Return the sum of the forces [N], then of their moments about `point` [N m], inertial axes."""
    moments = cross(link.arm_points - point[None], link.forces)
    return jnp.concatenate([link.forces.sum(0), moments.sum(0)])


def generalised_aero_force(
    robot: RobotModel, kin: Kinematics, link: LinkForces, points: Float[Array, "L 3"]
) -> Float[Array, " N"]:
    """Return `Σ J_jᵀ f_j` for forces acting at `points` [m], which are `arm_points` or `jacobian_points`."""
    return generalised_force(robot, kin, robot.aero_links.bodies, points, link.forces)
