"""Outages of measurements: missing, frozen or wrong channels.

Equation M104 of `docs/model.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.config import Outage as OutageConfig
from jax_aero.robot import RobotModel
from jax_aero.spatial import axis_angle, multiply
from jax_aero.types import Array, State, Static, leaf, pytree, where


class Sample(NamedTuple):
    """Measured values of a tick."""

    state: State
    thrust: Float[Array, " j"]
    """Thrusts [N]."""
    wind: Float[Array, "3"]
    """Wind [m/s, inertial axes]."""


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
    """Measurements at the start of an outage."""

    is_begun: Bool[Array, ""]
    sample: Sample


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
    nothing = Sample(state, thrust, jnp.zeros_like(state.base_position))
    return tuple(OutageState(jnp.array(False), nothing) for _ in outages)


def spoil(
    outages: Sequence[Outage], held: Sequence[OutageState], time: Float[Array, ""], sample: Sample
) -> tuple[tuple[OutageState, ...], Sample]:
    """Apply the outages to the measurement at `time` [s]."""
    after = []
    for outage, memory in zip(outages, held, strict=True):
        # Half a microsecond allows for rounding of times.
        since = time - outage.start + 5e-7
        is_on = (since >= 0.0) & (since < outage.duration)
        first = where(is_on & ~memory.is_begun, sample, memory.sample)
        after.append(OutageState(memory.is_begun | is_on, first))
        sample = where(is_on, _spoil_sample(outage, sample, first), sample)
    return tuple(after), sample


def _spoil_sample(outage: Outage, sample: Sample, before: Sample) -> Sample:
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

    state, then = sample.state, before.state
    match outage.channel:
        case "wind":
            return sample._replace(wind=replace_numbers(sample.wind, before.wind))
        case "thrust":
            each = jax.vmap(lambda now, was: replace_numbers(now[None], was[None])[0])(sample.thrust, before.thrust)
            return sample._replace(thrust=jnp.where(outage.jets, each, sample.thrust))
        case "joints":
            position = replace_numbers(state.joint_position, then.joint_position)
            velocity = state.velocity.at[6:].set(replace_numbers(state.velocity[6:], then.velocity[6:]))
            return sample._replace(state=state._replace(joint_position=position, velocity=velocity))
        case "base_position":
            position = replace_numbers(state.base_position, then.base_position)
            return sample._replace(state=state._replace(base_position=position))
        case "base_rotation":
            if outage.kind == "wrong":
                turn = axis_angle(jnp.array([1.0, 0.0, 0.0], sample.wind.dtype), outage.error)
                rotation = multiply(turn, state.base_rotation)
            else:
                rotation = replace_numbers(state.base_rotation, then.base_rotation)
            return sample._replace(state=state._replace(base_rotation=rotation))
        case _:
            velocity = state.velocity.at[:6].set(replace_numbers(state.velocity[:6], then.velocity[:6]))
            return sample._replace(state=state._replace(velocity=velocity))
