"""The joints between two ticks of the law: predicted under their torques, corrected by their own measurements.

The torque law can run faster than the momentum law (`controller.torque.steps`). In a tick of the torques only joint
positions and velocities are new; what the torque QP takes from the model is that of the last tick of the law.

Equation M152 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.config import ControllerSection
from jax_aero.types import Array, Static, leaf, pytree


class JointMeasurement(NamedTuple):
    """What a tick of the torques receives; NaN is not measured."""

    position: Float[Array, " n"]
    """[rad, m]."""
    velocity: Float[Array, " n"]
    """[rad/s, m/s]."""


class JointsBetween(NamedTuple):
    """Joints at the last tick of law or torques."""

    position: Float[Array, " n"]
    """[rad, m]."""
    velocity: Float[Array, " n"]
    """[rad/s, m/s]."""
    torque: Float[Array, " n"]
    """Acting torques [N m, N]."""
    acceleration: Float[Array, " n"]
    """Accelerations under them [rad/s², m/s²]."""
    mean_torque: Float[Array, " n"]
    """Mean of the torques from this tick of the law to the next, if the acting ones remain [N m, N]."""
    are_solved: Bool[Array, ""]
    """Whether all QPs since the tick of the law, with its own, have certified answers."""


@pytree
class JointTracker:
    """Shares and limits with which the joints are corrected."""

    period: Float[Array, ""]
    """Time between two ticks of the torques [s]."""
    of_position: Float[Array, ""]
    """Share of the innovation of the position that corrects it."""
    of_velocity: Float[Array, "2"]
    """Shares of the innovations of position [1/s] and velocity that correct the velocity."""
    greatest: Float[Array, "2"]
    """Greatest accepted position and velocity."""
    jump: Float[Array, "2"]
    """Greatest accepted differences from the prediction; infinite without limits."""
    steps: Static[int]
    """Ticks of the torques in a tick of the law."""


def joint_tracker(controller: ControllerSection, time_step: float) -> JointTracker:
    """Return a tracker that corrects as the estimator does, and accepts what the channels accept."""
    estimator, channels = controller.estimator, controller.channels
    period = time_step / controller.torque.steps

    def share(time: float) -> float:
        return -np.expm1(-period / time) if time > 0.0 else 1.0

    of_position, of_velocity = 1.0, [0.0, 1.0]
    if estimator is not None and estimator.joint_observer is not None:
        left = share(estimator.joint_observer)  # two poles at e^(-h/T)
        of_position, of_velocity = left * (2.0 - left), [left * left / period, 0.0]
    elif estimator is not None:
        of_position = share(estimator.joint_position.time_constant)
        of_velocity = [0.0, share(estimator.joint_velocity.time_constant)]
    jump = channels.jump
    return JointTracker(
        period=leaf(period),
        of_position=leaf(of_position),
        of_velocity=leaf(of_velocity),
        greatest=leaf([channels.greatest.joint_position, channels.greatest.joint_velocity]),
        jump=leaf([np.inf, np.inf] if jump is None else [jump.joint_position, jump.joint_velocity]),
        steps=controller.torque.steps,
    )


def update(tracker: JointTracker, joints: JointsBetween, measured: JointMeasurement) -> JointsBetween:
    """Advance the joints to a measurement of them. Numbers that are not accepted correct nothing."""
    velocity = joints.velocity + tracker.period * joints.acceleration
    position = joints.position + tracker.period * velocity

    def innovation(quantity: int, now: Array, predicted: Array) -> Array:
        difference = now - predicted
        is_near = jnp.abs(difference) <= tracker.jump[quantity]
        return jnp.where((jnp.abs(now) <= tracker.greatest[quantity]) & is_near, difference, 0.0)

    moved, faster = innovation(0, measured.position, position), innovation(1, measured.velocity, velocity)
    return joints._replace(
        position=position + tracker.of_position * moved,
        velocity=velocity + (tracker.of_velocity[0] * moved + tracker.of_velocity[1] * faster),
    )
