"""Distances that a plan keeps: exhausts and links from other links, as capsules.

Equation M125 of `docs/model.md`. The trims compute the same distances, in `jax_aero/symbolic/clearance.py`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero import config
from jax_aero.kinematics import frame_poses, kinematics_at_rest
from jax_aero.robot import RobotModel
from jax_aero.spatial import rotate
from jax_aero.types import Array, Static, leaf, pytree

TINY = 1e-12
"""Keeps quotients finite if a segment is a point or two segments are parallel [m², m⁴]."""


@pytree
class Clearance:
    """What stays apart: a capsule is an exhaust, numbered as its jet, or a link, numbered after all jets."""

    pairs: Static[tuple[tuple[int, int], ...]]
    """Capsules that keep clear of each other."""
    exhaust: Float[Array, ""]
    """Length of an exhaust's axis from the nozzle [m]."""
    least: Float[Array, ""]
    """Least distance [m]."""
    weight: Float[Array, ""]
    """Weight of a lesser distance [1/m²]."""


def clearance_params(settings: config.ClearanceConfig | None, robot: RobotModel) -> Clearance:
    """Return the pairs of a configuration, without those that no joint moves relative to each other."""
    if settings is None:
        return Clearance((), leaf(0.0), leaf(0.0), leaf(0.0))
    jets, links = robot.jets, robot.aero_links
    first = [*range(jets.count), *(jets.count + links.names.index(name) for name in settings.links)]
    second = [jets.count + links.names.index(name) for name in settings.apart_from]
    body = jets.bodies + links.bodies
    pairs = tuple((one, other) for one in first for other in second if body[one] != body[other])
    return Clearance(pairs, leaf(settings.exhaust), leaf(settings.least), leaf(settings.weight))


def distances(
    robot: RobotModel, clearance: Clearance, joints: tuple[int, ...], joint_position: Float[Array, " n"]
) -> tuple[Float[Array, " p"], Float[Array, "p f"]]:
    """Return the distance between the surfaces of each pair [m], and its derivatives by `joints` [m/rad].

    A distance is negative if one capsule enters the other.
    """
    moved = np.array(joints, dtype=int)
    one, other = np.array(clearance.pairs, dtype=int).reshape(-1, 2).T

    def of(position: Array) -> tuple[Array, Array]:
        start, way, radius = _capsules(robot, clearance.exhaust, joint_position.at[moved].set(position))
        gap = _gap((start[one], way[one]), (start[other], way[other]))
        square = jnp.sum(gap * gap, axis=1)
        apart = jnp.sqrt(jnp.maximum(square, TINY**2))
        found = apart - radius[one] - radius[other]
        return found, found

    by_joint, found = jax.jacfwd(of, has_aux=True)(joint_position[moved])
    return found, by_joint


def _capsules(robot: RobotModel, exhaust: Array, joint_position: Array) -> tuple[Array, Array, Array]:
    """Return start and way of every segment [m], and the distance of the surface from it [m]."""
    kin = kinematics_at_rest(robot, joint_position)
    jets, links = robot.jets, robot.aero_links
    (rotation, nozzle), (link_rotation, origin) = frame_poses(kin, jets), frame_poses(kin, links)
    half = jnp.where(np.array(links.is_sphere, dtype=bool), 0.0, 0.5 * links.lengths)[:, None] * links.axes
    start = jnp.concatenate([nozzle, origin + rotate(link_rotation, links.centres - half)])
    way = jnp.concatenate([-exhaust * rotate(rotation, jets.axes), rotate(link_rotation, 2.0 * half)])
    return start, way, jnp.concatenate([jnp.zeros_like(jets.thrust_max), 0.5 * links.diameters])


def _gap(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Return the way between the nearest points of pairs of segments (p, 3).

    They are those of two lines with parameters clamped in turn (Ericson, Real-Time Collision Detection, 2005, section
    5.1.9).
    """
    (start_1, way_1), (start_2, way_2) = first, second
    between = start_1 - start_2

    def along(a: Array, b: Array) -> Array:
        return jnp.sum(a * b, axis=1)

    a, b, e = along(way_1, way_1) + TINY, along(way_1, way_2), along(way_2, way_2) + TINY
    c, f = along(way_1, between), along(way_2, between)
    on_first = jnp.clip((b * f - c * e) / (a * e - b * b + TINY), 0.0, 1.0)
    on_second = jnp.clip((b * on_first + f) / e, 0.0, 1.0)
    on_first = jnp.clip((b * on_second - c) / a, 0.0, 1.0)
    return between + on_first[:, None] * way_1 - on_second[:, None] * way_2
