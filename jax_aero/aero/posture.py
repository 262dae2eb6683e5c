"""Where a posture puts the links: their frames in base axes, for tables of joint angles."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero.aero.dataset import JOINTS, LINKS, Floats
from jax_aero.kinematics import frame_poses, kinematics
from jax_aero.robot import RobotModel
from jax_aero.types import Array, State


class LinkFrames(NamedTuple):
    """Frames of the aerodynamic links of P postures, as seen from the base."""

    rotations: Floats
    """(P, 13, 3, 3) `base_from_link`."""
    positions: Floats
    """(P, 13, 3) origins from the base origin, base axes [m]."""


def link_frames(robot: RobotModel, joint_position_deg: Floats) -> LinkFrames:
    """Frames of the links at joint angles (P, 19) [deg], order of `JOINTS`; the ankles are straight.

    Raises
    ------
    ValueError
        If the robot's links or joints are not those of the tables.
    """
    if robot.aero_links.names != LINKS or not set(JOINTS) <= set(robot.joint_names):
        raise ValueError(f"{robot.name} has not the links and joints of the tables: {', '.join(LINKS)}")
    with jax.enable_x64(True):
        rotations, positions = _frames(robot, np.radians(joint_position_deg))
    return LinkFrames(np.asarray(rotations), np.asarray(positions))


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def _frames(robot: RobotModel, angles: Array) -> tuple[Array, Array]:
    places, links = np.array([robot.joint_names.index(name) for name in JOINTS]), robot.aero_links
    joints = jnp.zeros(robot.n_joints).at[places].set(angles)
    still = State(jnp.zeros(3), jnp.eye(3), joints, jnp.zeros(6 + robot.n_joints))
    return frame_poses(kinematics(robot, still), links.bodies, links.rotations, links.positions)


def link_axes(robot: RobotModel, joint_position_deg: Floats) -> Floats:
    """Return unit axes of symmetry (N, 13, 3) in base axes, at joint angles (N, 19) [deg]; rows may repeat."""
    shapes, shape_of = np.unique(joint_position_deg, axis=0, return_inverse=True)
    axes: Floats = np.einsum("plij,lj->pli", link_frames(robot, shapes).rotations, np.asarray(robot.aero_links.axes))
    return axes[shape_of.reshape(-1)]
