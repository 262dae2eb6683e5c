"""Weights and structure of the predictive law, from its configuration, which the crate has checked."""

from __future__ import annotations

from dataclasses import fields
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_aero import config
from jax_aero.body.robot import RobotModel
from jax_aero.config import Air
from jax_aero.control.mpc.clearance import Clearance, clearance_params
from jax_aero.types import Array, leaf, pytree, static

POSTURE_GAIN = 5.0
"""Gain with which joints that the law does not move return to the posture [1/s]."""
DECAY = 3.0
"""`λ`: rate at which errors decay after the horizon [1/s]."""
JOINT_EXCESS = 1e3
"""Weight of a joint position beyond its limits [1/rad²]."""


@pytree
class MpcWeights:
    """Weights of the errors along the horizon, per second; those of rates and inputs too."""

    position: Float[Array, "3"]
    """Centre of mass [1/m²]."""
    velocity: Float[Array, "3"]
    """Its velocity [s²/m²]."""
    acceleration: Float[Array, ""]
    """Its acceleration [s⁴/m²]."""
    attitude: Float[Array, "3"]
    """[1/rad²]."""
    angular_velocity: Float[Array, ""]
    """[s²/rad²]."""
    angular_acceleration: Float[Array, ""]
    """[s⁴/rad²]."""
    posture: Float[Array, " f"]
    """Positions of the joints that the law moves, about the posture of the first tick [1/rad²]."""
    joint_velocity: Float[Array, ""]
    """[s²/rad²]."""
    joint_command: Float[Array, ""]
    """Commanded joint velocities [s²/rad²]."""
    thrust_rate: Float[Array, ""]
    """[s²/N²]."""
    tail: Float[Array, "2"]
    """What is left of motion and attitude at the end of the horizon, not per second [s⁴/m², s⁴/rad²]."""


class Structure(NamedTuple):
    """What determines the shapes of the horizon; hashable, fixed at compilation."""

    air: Air
    """Whether the wrench of the air changes in the prediction."""
    joints: tuple[int, ...]
    """Joints that the law moves."""
    durations: tuple[float, ...]
    """Durations of the knots [s]."""
    blocks: tuple[int, ...]
    """Of every knot, the block in which the joint velocities are constant."""
    ends: tuple[int, ...]
    """Ticks from now to the end of every knot."""

    @property
    def doublings(self) -> tuple[int, ...]:
        """Of every knot, the power of two by which it is longer than the first."""
        return tuple(round(np.log2(duration / self.durations[0])) for duration in self.durations)

    def unknowns(self, jets: int) -> int:
        """Return the number of inputs: thrust rates by knot, then joint velocities by block."""
        return jets * len(self.durations) + len(self.joints) * (self.blocks[-1] + 1)


@pytree
class Mpc:
    """The predictive law: every number is a leaf."""

    structure: Structure = static()
    period: Float[Array, ""]
    """Time between two plans [s]."""
    decay: Float[Array, ""]
    """`λ` [1/s]."""
    thrust_excess: Float[Array, ""]
    """Weight of a thrust beyond its range [1/N²]."""
    clearance: Clearance
    weights: MpcWeights


def mpc_params(settings: config.MpcConfig, robot: RobotModel, time_step: float) -> Mpc:
    """Return the parameters of the law for a robot and ticks of `time_step` [s]."""
    numbers = dict(robot.joint_groups)
    blocks = np.repeat(np.arange(len(settings.joint_knots)), settings.joint_knots)
    structure = Structure(
        air=settings.air,
        joints=tuple(sorted({joint for name in settings.joint_groups for joint in numbers[name]})),
        durations=tuple(settings.knots),
        blocks=tuple(blocks.tolist()),
        ends=tuple(accumulate(round(duration / time_step) for duration in settings.knots)),
    )
    return Mpc(
        structure,
        period=leaf(settings.period),
        decay=leaf(DECAY),
        thrust_excess=leaf(settings.thrust_excess),
        clearance=clearance_params(settings.clearance, robot),
        weights=_weights(settings.weights, robot, structure.joints),
    )


def _weights(settings: config.MpcWeights, robot: RobotModel, moved: tuple[int, ...]) -> MpcWeights:
    posture = {joint: settings.posture.get(name, 0.0) for name, joints in robot.joint_groups for joint in joints}
    values = {item.name: leaf(getattr(settings, item.name)) for item in fields(MpcWeights) if item.name != "posture"}
    return MpcWeights(**values, posture=leaf([posture[joint] for joint in moved]))
