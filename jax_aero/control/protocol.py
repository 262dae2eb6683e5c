"""Inputs and outputs of a flight controller: the interface for user-defined controllers."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from jaxtyping import Float, Int

from jax_aero.control.attitude import AttitudeDemand
from jax_aero.control.channels import UsedMeasurement
from jax_aero.control.momentum import MomentumModel
from jax_aero.control.qp import QpAnswer
from jax_aero.control.tasks import MomentumQp
from jax_aero.control.torque import TorqueQp
from jax_aero.robot import RobotModel
from jax_aero.types import Array, Dynamics, Kinematics, LinkForces, Setpoint, State

S = TypeVar("S")


class Measurement(NamedTuple):
    """Input of a controller at a tick."""

    time: Float[Array, ""]
    """Time since the flight began [s]."""
    state: State
    thrust: Float[Array, " j"]
    """Measured thrusts [N]."""
    wind: Float[Array, "3"]
    """Measured velocity of the air [m/s, inertial axes]."""


class Terms(NamedTuple):
    """Intermediate values of a tick of the momentum controller."""

    estimates: Measurement
    """Output of the estimators; without estimators the measurement."""
    measurement: UsedMeasurement
    """Usable measurement, with predictions of missing values."""
    wind_std: Float[Array, "3"]
    """Standard deviation of the wind in `estimates` [m/s]; zero without a wind observer."""
    state: State
    """State of kinematics and dynamics: the given one itself if nothing is predicted."""
    kinematics: Kinematics
    dynamics: Dynamics
    link_forces: LinkForces
    momentum: MomentumModel
    setpoint: Setpoint
    attitude: AttitudeDemand
    momentum_qp: MomentumQp
    torque_qp: TorqueQp
    unlimited_torque: Float[Array, " n"]
    """Torques before the rate limiter [N m]."""


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
    status: Int[Array, ""] | None = None
    """One of the codes in `tick`."""
    degraded_modes: Int[Array, ""] | None = None
    """A sum of the bits in `channels.MODES`."""
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


class Controller(Protocol[S]):
    """A flight controller: a pytree whose numbers are leaves, with two pure functions that JAX traces.

    `robot` is the model that the controller is to use, by default that of the robot that flies.

    >>> @pytree
    ... class HoldThrust:
    ...     damping: Array
    ...
    ...     def init(self, robot, state):
    ...         return ()
    ...
    ...     def step(self, robot, state, measurement):
    ...         torque = -self.damping * measurement.state.velocity[6:]
    ...         return state, Command(jnp.zeros_like(measurement.thrust), torque)
    """

    def init(self, robot: RobotModel, state: State) -> S:
        """Return the state of the controller at its first tick, with the robot in `state`."""
        ...

    def step(self, robot: RobotModel, state: S, measurement: Measurement) -> tuple[S, Command]:
        """Compute one tick; return the next state of the controller and the command."""
        ...
