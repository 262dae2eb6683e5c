"""The interface for user-defined controllers."""

from __future__ import annotations

from typing import Protocol, TypeVar

from jax_aero.body.robot import RobotModel
from jax_aero.control.command import Command
from jax_aero.control.measurement import Measurement
from jax_aero.types import State

S = TypeVar("S")


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
