"""Output of a tick."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jax_aero.body.robot import RobotModel
from jax_aero.control.qp import QpAnswer
from jax_aero.control.terms import Terms
from jax_aero.types import Array, Setpoint


class Command(NamedTuple):
    """Command of a controller, held until the next tick. Entries that are `None` are NaN in the log."""

    thrust_rate: Float[Array, " j"]
    """`Ṫ*` [N/s]."""
    joint_torque: Float[Array, " n"]
    """Joint torques [N m]."""
    setpoint: Setpoint | None = None
    """Set-point that the controller follows. Without it a flight is lost only by exceeding the divergence limits."""
    joint_velocity: Float[Array, " n"] | None = None
    """`ṡ*` [rad/s]."""
    momentum_qp: QpAnswer | None = None
    torque_qp: QpAnswer | None = None
    degraded_modes: Int[Array, ""] | None = None
    """What in the tick is not as usual, a sum of the bits in `rust.MODES`."""
    terms: Terms | None = None

    def check(self, robot: RobotModel) -> None:
        """Refuse shapes that do not fit this robot, which broadcasting over its jets and joints would hide.

        Raises
        ------
        ValueError
            If a shape is wrong; the message names the entry, its shape and what was expected.
        """
        joints = (robot.n_joints,)
        parts: list[tuple[str, Any, tuple[int, ...]]] = [
            ("thrust_rate", self.thrust_rate, (robot.jets.count,)),
            ("joint_torque", self.joint_torque, joints),
        ]
        if self.joint_velocity is not None:
            parts.append(("joint_velocity", self.joint_velocity, joints))
        if self.setpoint is not None:
            axes = {"rotation": (3, 3)}
            parts += [
                (f"setpoint.{name}", part, axes.get(name, (3,))) for name, part in self.setpoint._asdict().items()
            ]
        for name, part, expected in parts:
            if (shape := np.shape(part)) != expected:
                raise ValueError(f"`{name}` of the command has shape {shape}; expected {expected}")
