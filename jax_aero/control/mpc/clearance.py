"""Distances that a plan keeps: exhausts and links from other links, as capsules.

Equation M126 of `docs/model`. The trims compute the same distances, in `jax_aero/symbolic/clearance.py`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from jax_aero import config, rust
from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotate
from jax_aero.types import Array, leaf, pytree, static

LEAST_DISTANCE = 0.03
"""Of the surfaces; an exhaust is its axis [m]."""
CLEARANCE_WEIGHT = 5e3
"""Weight of a distance below the least one [1/m²]."""
TINY = 1e-12
"""Keeps quotients finite if a segment is a point or two segments are parallel [m², m⁴]."""


@pytree
class Clearance:
    """Capsules, which are segments with a radius, and pairs of them that stay apart."""

    bodies: tuple[int, ...] = static()
    """Body that carries each capsule."""
    pairs: tuple[tuple[int, int], ...] = static()
    start: Float[Array, "c 3"]
    """Start of every segment, body axes [m]."""
    way: Float[Array, "c 3"]
    """From its start to its end, body axes [m]."""
    radius: Float[Array, " c"]
    """[m]; zero for an exhaust."""


def clearance_params(settings: config.ClearanceConfig | None, robot: RobotModel) -> Clearance:
    """Return what a configuration keeps apart, without pairs that share a body."""
    if settings is None:
        none = leaf(np.zeros((0, 3)))
        return Clearance((), (), none, none, leaf(np.zeros(0)))
    of = rust.Robot(robot.source).clearance(msgspec.json.encode(settings).decode())
    bodies, *segments, pairs = of
    return Clearance(tuple(bodies), tuple(pairs), *map(leaf, segments))


def distances(
    robot: RobotModel, clearance: Clearance, joints: tuple[int, ...], joint_position: Float[Array, " n"]
) -> tuple[Float[Array, " p"], Float[Array, "p f"]]:
    """Return the distance between the surfaces of each pair [m], and its derivatives by `joints` [m/rad].

    A distance is negative if one capsule enters the other.
    """
    moved = np.array(joints, dtype=int)
    one, other = np.array(clearance.pairs, dtype=int).reshape(-1, 2).T

    bodies = np.array(clearance.bodies, dtype=int)

    def segments(position: Array) -> tuple[_Segments, _Segments]:
        kin = kinematics_at_rest(robot, joint_position.at[moved].set(position))
        turned = kin.body_rotations[bodies]
        start = rotate(turned, clearance.start) + kin.body_positions[bodies]
        way = rotate(turned, clearance.way)
        return (start[one], way[one]), (start[other], way[other])

    # The distance is least at the nearest points, so its derivative is that with both points fixed on their segments.
    # It is not differentiated through them: `TINY` moves them off the minimum.
    places = _nearest(*segments(joint_position[moved]))

    def of(position: Array) -> tuple[Array, Array]:
        gap = _between(*segments(position), places)
        apart = jnp.sqrt(jnp.maximum(jnp.sum(gap * gap, axis=1), TINY**2))
        found = apart - clearance.radius[one] - clearance.radius[other]
        return found, found

    by_joint, found = jax.jacfwd(of, has_aux=True)(joint_position[moved])
    return found, by_joint


_Segments = tuple[Array, Array]
"""Starts and ways of segments (p, 3) [m]."""


def _between(first: _Segments, second: _Segments, places: tuple[Array, Array]) -> Array:
    """Return the ways from points of the second segments to those of the first (p, 3), at these shares of them."""
    (start_1, way_1), (start_2, way_2) = first, second
    on_first, on_second = places
    return start_1 - start_2 + on_first[:, None] * way_1 - on_second[:, None] * way_2


def _nearest(first: _Segments, second: _Segments) -> tuple[Array, Array]:
    """Return at which shares of pairs of segments (p,) their nearest points lie.

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
    return jnp.clip((b * on_second - c) / a, 0.0, 1.0), on_second
