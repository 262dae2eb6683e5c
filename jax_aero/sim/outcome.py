"""How a flight ends: the limits of what is physically possible, and those of a fall.

Equation M80 of `docs/model`.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jax_aero.sim.plant import Plant, PlantState
from jax_aero.types import Array, pytree

(
    FLYING,
    BY_ROTATION,
    BY_COM,
    NOT_FINITE,
    BY_SPEED,
    BY_ANGULAR_VELOCITY,
    BY_JOINT_VELOCITY,
    BY_JOINT_POSITION,
    BY_THRUST,
) = range(9)
"""Codes of `FlightState.loss`: falls by rotation and position errors first, divergence from `NOT_FINITE` on."""

LARGEST_NUMBER = 1e9
"""Limit in SI units beyond which a state counts as not finite, since the next step may overflow."""

LIMITS = {
    BY_SPEED: 300.0,
    BY_ANGULAR_VELOCITY: 100.0,
    BY_JOINT_VELOCITY: 100.0,
    BY_JOINT_POSITION: 6.0,
    BY_THRUST: 10.0,
}
"""Limits of physically possible values, as in the crate.

Speed of base and air [m/s], angular velocity of the base [rad/s], velocity of a joint and its distance beyond its stops
[rad, m], ratio of a thrust to the jet's greatest.
"""


COURSE_ERROR = 0.5
"""Greatest position error after the start-up of a flight that is on course [m]."""


@pytree
class FallLimits:
    """Criteria of a fall."""

    rotation_error_deg: Float[Array, ""]
    """Greatest rotation between base and set-point [deg]."""
    com_error: Float[Array, ""]
    """Greatest distance between centre of mass and set-point [m]."""


def divergence(plant: Plant, state: PlantState, wind: Float[Array, "3"]) -> Int[Array, ""]:
    """Return the criterion by which the plant has diverged, `FLYING` if by none."""
    robot, now = plant.robot, state.robot
    lower, upper = jnp.asarray(robot.joint_stops).T
    joints, ratios = now.joint_position, state.jets.thrust / robot.jets.thrust_max
    found = {
        BY_SPEED: jnp.maximum(jnp.linalg.norm(now.velocity[:3]), jnp.linalg.norm(wind)),
        BY_ANGULAR_VELOCITY: jnp.linalg.norm(now.velocity[3:6]),
        BY_JOINT_VELOCITY: jnp.max(jnp.abs(now.velocity[6:]), initial=0.0),
        BY_JOINT_POSITION: jnp.max(jnp.maximum(lower - joints, joints - upper), initial=-jnp.inf),
        BY_THRUST: jnp.max(ratios, initial=0.0),
    }
    code = jnp.array(FLYING, jnp.int32)
    for criterion, value in reversed(found.items()):
        code = jnp.where(value > LIMITS[criterion], criterion, code)
    return jnp.where(_is_in_range((state, wind)), code, NOT_FINITE)


def fall(
    limits: FallLimits, rotation_error: Float[Array, ""], com_error: Float[Array, ""]
) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """Return whether and why the robot has fallen, and the error."""
    over_rotated = rotation_error > jnp.deg2rad(limits.rotation_error_deg)
    is_far = com_error > limits.com_error
    is_finite = jnp.isfinite(rotation_error) & jnp.isfinite(com_error)
    fall = jnp.where(over_rotated, BY_ROTATION, jnp.where(is_far, BY_COM, FLYING))
    fall = jnp.where(is_finite, fall, NOT_FINITE)
    return fall.astype(jnp.int32), jnp.where(over_rotated, rotation_error, com_error)


def _is_in_range(tree: Any) -> Array:
    """Return whether all numbers, and the products of several of them that a tick forms, are finite."""
    numbers = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(jnp.abs(leaf) < LARGEST_NUMBER) for leaf in numbers]))


def lost_reason(loss: int, size: float) -> str:
    """Return the reason for a loss in words, as the crate does."""
    limit = f"{LIMITS.get(loss, 0.0):g}"
    return {
        BY_ROTATION: f"rotation error {np.rad2deg(size):.1f} deg",
        BY_COM: f"CoM error {size:.2f} m",
        NOT_FINITE: "state not finite",
        BY_SPEED: f"speed of base or air above {limit} m/s",
        BY_ANGULAR_VELOCITY: f"angular velocity above {limit} rad/s",
        BY_JOINT_VELOCITY: f"joint velocity above {limit} rad/s",
        BY_JOINT_POSITION: f"joint more than {limit} rad beyond its stop",
        BY_THRUST: f"thrust above {limit} times its greatest",
    }[loss]
