"""Outages of measurements: missing, frozen or wrong channels.

Equation M104 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.config import Outage as OutageConfig
from jax_aero.control import Measurement
from jax_aero.robot import RobotModel
from jax_aero.spatial import axis_angle, multiply
from jax_aero.types import Array, State, Static, leaf, pytree, where


@pytree
class Outage:
    """A temporary failure of a channel."""

    channel: Static[str]
    kind: Static[str]
    jets: Bool[Array, " j"]
    """Jets whose thrust measurement fails."""
    start: Float[Array, ""]
    """Start [s]."""
    duration: Float[Array, ""]
    """Duration [s]."""
    error: Float[Array, ""]
    """Error of a wrong value, in the unit of the channel."""


class OutageState(NamedTuple):
    """State of an outage between two ticks."""

    is_begun: Bool[Array, ""]
    first: Measurement
    """Measurement at the start of the outage."""


def outages_of(settings: Sequence[OutageConfig], robot: RobotModel) -> tuple[Outage, ...]:
    """Return the outages of a flight of this robot.

    Raises
    ------
    ValueError
        For a jet that the robot does not have, and for a jet given with a channel other than thrust.
    """
    names = robot.jets.names
    for index, outage in enumerate(settings):
        key = f"disturbances.outages[{index}].jet"
        if outage.jet is not None and outage.channel != "thrust":
            raise ValueError(f"{key} is `{outage.jet}`; expected none, but for the channel thrust")
        if outage.jet is not None and outage.jet not in names:
            raise ValueError(f"{key} is `{outage.jet}`; {robot.name} has {', '.join(names)}")
    return tuple(
        Outage(
            channel=outage.channel,
            kind=outage.kind,
            jets=jnp.array([outage.jet in (None, name) for name in names]),
            start=leaf(outage.start),
            duration=leaf(np.inf if outage.duration is None else outage.duration),
            error=leaf(outage.error),
        )
        for outage in settings
    )


def begin(outages: Sequence[Outage], state: State, thrust: Float[Array, " j"]) -> tuple[OutageState, ...]:
    """Return the state of outages that have not begun."""
    zero = jnp.zeros_like(state.base_position)
    nothing = Measurement(zero[0], state, thrust, zero)
    return tuple(OutageState(jnp.array(False), nothing) for _ in outages)


def spoil(
    outages: Sequence[Outage], held: Sequence[OutageState], measurement: Measurement
) -> tuple[tuple[OutageState, ...], Measurement]:
    """Apply the outages to a measurement."""
    after = []
    for outage, memory in zip(outages, held, strict=True):
        # Half a microsecond allows for rounding of times.
        since = measurement.time - outage.start + 5e-7
        is_on = (since >= 0.0) & (since < outage.duration)
        first = where(is_on & ~memory.is_begun, measurement, memory.first)
        after.append(OutageState(memory.is_begun | is_on, first))
        measurement = where(is_on, _spoil_channel(outage, measurement, first), measurement)
    return tuple(after), measurement


def _spoil_channel(outage: Outage, now: Measurement, first: Measurement) -> Measurement:
    def replace_numbers(numbers: Array, then: Array) -> Array:
        match outage.kind:
            case "missing":
                return jnp.full_like(numbers, jnp.nan)
            case "nan":
                return numbers.at[(0,) * numbers.ndim].set(jnp.nan)
            case "frozen":
                return then
            case _:
                return numbers + outage.error

    state, then = now.state, first.state
    match outage.channel:
        case "wind":
            return now._replace(wind=replace_numbers(now.wind, first.wind))
        case "thrust":
            each = jax.vmap(lambda new, old: replace_numbers(new[None], old[None])[0])(now.thrust, first.thrust)
            return now._replace(thrust=jnp.where(outage.jets, each, now.thrust))
        case "joints":
            position = replace_numbers(state.joint_position, then.joint_position)
            velocity = state.velocity.at[6:].set(replace_numbers(state.velocity[6:], then.velocity[6:]))
            return now._replace(state=state._replace(joint_position=position, velocity=velocity))
        case "base_position":
            position = replace_numbers(state.base_position, then.base_position)
            return now._replace(state=state._replace(base_position=position))
        case "base_rotation":
            if outage.kind == "wrong":
                turn = axis_angle(jnp.array([1.0, 0.0, 0.0], now.wind.dtype), outage.error)
                rotation = multiply(turn, state.base_rotation)
            else:
                rotation = replace_numbers(state.base_rotation, then.base_rotation)
            return now._replace(state=state._replace(base_rotation=rotation))
        case _:
            velocity = state.velocity.at[:6].set(replace_numbers(state.velocity[:6], then.velocity[:6]))
            return now._replace(state=state._replace(velocity=velocity))
