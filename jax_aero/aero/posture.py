"""Frames of the links in base axes, for tables of postures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
import numpy.typing as npt
from jaxtyping import Float

from jax_aero.aero.dataset import Floats
from jax_aero.body.kinematics import frame_poses, kinematics_at_rest
from jax_aero.body.robot import RobotModel
from jax_aero.types import Array

NEWTON_METRES = 0.5 * 1.225 * 10.0**2
"""Moment per moment volume of 1 m³ at 10 m/s [N m]."""


class LinkFrames(NamedTuple):
    """Frames of the aerodynamic links relative to the base, for each posture."""

    rotations: Float[np.ndarray, "B L 3 3"]
    """`base_from_link`."""
    positions: Float[np.ndarray, "B L 3"]
    """Origins relative to the base origin, base axes [m]."""
    com: Float[np.ndarray, "B 3"]
    """Centre of mass relative to the base origin, base axes [m]."""


def link_frames(robot: RobotModel, joint_position: Float[np.ndarray, "B n"]) -> LinkFrames:
    """Return the frames of the links at joint positions [rad].

    Rows may repeat: every posture is evaluated once.
    """
    shapes, shape_of = np.unique(joint_position, axis=0, return_inverse=True)
    with jax.enable_x64(True):
        frames = _frames(robot, shapes)
    return LinkFrames(*(np.asarray(part)[shape_of.reshape(-1)] for part in frames))


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def _frames(robot: RobotModel, joints: Array) -> tuple[Array, Array, Array]:
    kin = kinematics_at_rest(robot, joints)
    return *frame_poses(kin, robot.aero_links), kin.com


def axes_of(robot: RobotModel) -> Floats:
    """Return the rotation (3, 3) to base axes from those of the tunnel's tables: x backward, y right, z up."""
    forward, up = np.asarray(robot.forward_axis), np.array([0.0, 0.0, 1.0])
    return np.stack([-forward, np.cross(forward, up), up], axis=1)


class Wrench(NamedTuple):
    """Totals of the links' force areas, base axes."""

    force_area: Float[np.ndarray, "B 3"]
    """Total force `F / (½ ρ V²)` [m²]."""
    moment_volume: Float[np.ndarray, "B 3"]
    """Total moment about the centre of mass `M / (½ ρ V²)` [m³], with each force at its link's centre."""


def total_wrench(
    robot: RobotModel, joint_position: Float[np.ndarray, "B n"], force_area_b: Float[np.ndarray, "B L 3"]
) -> Wrench:
    """Return the totals of force areas [m²], base axes, at joint positions [rad]; rows may repeat."""
    moments = np.cross(link_arms(robot, joint_position), force_area_b).sum(axis=1)
    return Wrench(force_area_b.sum(axis=1), moments)


def vector_rms(vectors: Float[np.ndarray, "B 3"]) -> float:
    """Return the root mean squared length of vectors, in their unit."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def rms_by_posture(
    errors: Sequence[Float[np.ndarray, "B k"]], posture: npt.ArrayLike, draws: int, seed: int
) -> Float[np.ndarray, "draws M"]:
    """Return the rms length of M error vectors (B, k), for postures drawn with replacement."""
    names, number = np.unique(np.asarray(posture), return_inverse=True)
    square = np.stack([np.sum(one**2, axis=-1) for one in errors])
    sums = np.stack([np.bincount(number, one) for one in square])
    count = np.bincount(number)
    drawn = np.random.default_rng(seed).integers(len(names), size=(draws, len(names)))
    rms: Floats = np.sqrt(sums[:, drawn].sum(axis=-1) / count[drawn].sum(axis=-1)).T
    return rms


DRAWS, SEED = 1000, 1


def interval_by_posture(errors: Float[np.ndarray, "B k"], posture: npt.ArrayLike) -> tuple[float, float]:
    """Return the 95 % interval of the rms length of error vectors over the choice of postures, by the bootstrap."""
    low, high = np.quantile(rms_by_posture([errors], posture, DRAWS, SEED), (0.025, 0.975))
    return float(low), float(high)


def link_arms(robot: RobotModel, joint_position: Float[np.ndarray, "B n"]) -> Float[np.ndarray, "B L 3"]:
    """Return the links' aerodynamic centres relative to the centre of mass [m], base axes, at joint positions [rad]."""
    frames = link_frames(robot, joint_position)
    arms: Floats = frames.positions - frames.com[:, None] + _in_base_axes(frames, robot.aero_links.centres)
    return arms


def link_axes(robot: RobotModel, joint_position: Float[np.ndarray, "B n"]) -> Float[np.ndarray, "B L 3"]:
    """Return the links' unit axes of symmetry in base axes, at joint positions [rad]."""
    return _in_base_axes(link_frames(robot, joint_position), robot.aero_links.axes)


def _in_base_axes(frames: LinkFrames, vectors: Float[Array, "L 3"]) -> Floats:
    rotated: Floats = np.einsum("blij,lj->bli", frames.rotations, np.asarray(vectors))
    return rotated
