"""Outages of measurements: values with an error for a time. Missing and frozen ones are for channels, which JAX lacks.

Equation M104 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import exp_so3, multiply
from jax_aero.config import Outage, OutageChannel
from jax_aero.control.measurement import Measurement
from jax_aero.types import Array, leaf, pytree, static

ROUNDING = 5e-7
"""Absorbs the rounding of times [s]."""


@pytree
class WrongChannel:
    """A channel with an error for a time."""

    channel: OutageChannel = static()
    jets: tuple[int, ...] = static()
    """Jets whose thrusts are wrong."""
    start: Float[Array, ""]
    """[s]."""
    duration: Float[Array, ""]
    """[s]; infinite to the end of the flight."""
    error: Float[Array, ""]
    """Added to every component, in the channel's unit; for a rotation, an angle about inertial x [rad]."""

    def spoil(self, sample: Measurement) -> Measurement:
        """Return a measurement with the error, if its time has come."""
        since, state = sample.time - self.start + ROUNDING, sample.state
        error = jnp.where((since >= 0.0) & (since < self.duration), self.error, 0.0)
        match self.channel:
            case "wind":
                return sample._replace(wind=sample.wind + error)
            case "thrust":
                return sample._replace(thrust=sample.thrust.at[np.array(self.jets)].add(error))
            case "joints":
                position, velocity = state.joint_position + error, state.velocity.at[6:].add(error)
                state = state._replace(joint_position=position, velocity=velocity)
            case "base_position":
                state = state._replace(base_position=state.base_position + error)
            case "base_rotation":
                turn = exp_so3(jnp.stack([error, jnp.zeros_like(error), jnp.zeros_like(error)]))
                state = state._replace(base_rotation=multiply(turn, state.base_rotation))
            case "base_velocity":
                state = state._replace(velocity=state.velocity.at[:6].add(error))
        return sample._replace(state=state)


def wrong_channels(outages: Sequence[Outage], robot: RobotModel) -> tuple[WrongChannel, ...]:
    """Return the channels that are wrong in a flight; the crate has checked the names of jets."""
    return tuple(
        WrongChannel(
            outage.channel,
            tuple(jet for jet, name in enumerate(robot.jets.names) if outage.jet in (None, name)),
            leaf(outage.start),
            leaf(np.inf if outage.duration is None else outage.duration),
            leaf(outage.error),
        )
        for outage in outages
    )
