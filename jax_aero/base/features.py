"""What a policy observes, in an environment as in the controller (M170).

Functions take `numpy` or `jax.numpy` as an argument.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Aim(NamedTuple):
    """Set-point of a tick, in inertial axes."""

    com: Any
    """Centre of mass (3,) [m]."""
    rotation: Any
    """Desired `inertial_from_base` (3, 3)."""
    velocity: Any
    """Of the centre of mass (3,) [m/s]."""
    angular_velocity: Any
    """Of the base (3,) [rad/s]."""


def aim_of(setpoint: Any) -> Aim:
    """Return what a set-point of the controller asks for."""
    rotation = setpoint.rotation
    return Aim(setpoint.com_position, rotation, setpoint.com_velocity, rotation @ setpoint.angular_velocity)


def features(
    xp: Any,
    rotation: Any,
    velocity: Any,
    joint_position: Any,
    thrust: Any,
    com: Any,
    aim: Aim,
    wrench: Any,
    thrust_max: Any,
) -> dict[str, Any]:
    """Return what is observed, by name, each of order one; (…, 3) in base axes but for joints and thrusts (M170).

    Of one robot, or with leading axes of several. `rotation` is `inertial_from_base`, `velocity` that of the base, its
    angular velocity and that of the joints, `joint_position` from the posture, `com` the centre of mass, and `wrench`
    the observed one about it, inertial axes.
    """
    error, force = xp.swapaxes(aim.rotation, -1, -2) @ rotation, 0.1 * xp.sum(thrust_max)
    skew = [error[..., i, j] - error[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))]

    def in_base(vector: Any) -> Any:
        return (vector[..., None, :] @ rotation)[..., 0, :]

    return {
        "gravity": -rotation[..., 2, :],
        "rotation": 0.5 * xp.stack(skew, axis=-1),
        "position": in_base(com - aim.com),
        "velocity": in_base(velocity[..., :3] - aim.velocity),
        "angular_velocity": in_base(velocity[..., 3:6] - aim.angular_velocity),
        "joint_position": joint_position,
        "joint_velocity": 0.1 * velocity[..., 6:],
        "thrust": thrust / thrust_max,
        "force": in_base(wrench[..., :3]) / force,
        "moment": in_base(wrench[..., 3:]) / (0.1 * force),
    }
