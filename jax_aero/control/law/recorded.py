"""A precomputed reference: `mission = { file = "…" }`.

Equation M49 of `docs/model`.
"""

from __future__ import annotations

from os import PathLike
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jax_aero import rust
from jax_aero.body.spatial import exp_so3, log_so3, multiply, rotation_from_rpy
from jax_aero.types import Array, leaf


class RecordedReference(NamedTuple):
    """A precomputed reference, sample by sample; missing derivatives are computed by differences."""

    times: Float[Array, " k"]
    """Times [s], increasing."""
    com_position: Float[Array, "k 3"]
    """Position of the centre of mass [m]."""
    rpy: Float[Array, "k 3"]
    """Roll, pitch, yaw of the base [rad]."""
    com_velocity: Float[Array, "k 3"] | None
    """Velocity of the centre of mass [m/s]."""
    com_acceleration: Float[Array, "k 3"] | None
    """Acceleration of the centre of mass [m/s²]."""
    com_jerk: Float[Array, "k 3"] | None
    """Jerk of the centre of mass [m/s³]."""


class RecordedMotion(NamedTuple):
    """Motion of a recorded reference, at one time or, with an additional first axis, at every sample."""

    com: Float[Array, "4 3"]
    """Position of the centre of mass and its first three derivatives [m, m/s, m/s², m/s³]."""
    rotation: Float[Array, "3 3"]
    """`inertial_from_base`."""
    angular_velocity: Float[Array, "3"]
    """Angular velocity of the base [rad/s, base axes]."""


class Recording(NamedTuple):
    """A recorded reference with all derivatives."""

    times: Float[Array, " k"]
    """Times [s], increasing."""
    samples: RecordedMotion
    """Motion at every sample."""
    turns: Float[Array, "k-1 3"]
    """Rotation vector from each sample to the next, in the base axes of the former [rad]."""


def read_reference(path: str | PathLike[str]) -> RecordedReference:
    """Read a recorded reference: CSV with 7, 10, 13 or 16 columns named in the header; `#` begins a comment.

    Raises
    ------
    ConfigError
        If the file is invalid; the message names the line and what was expected.
    """
    rows = rust.recorded_reference(path)
    columns = [leaf(rows[:, first : first + 3]) for first in range(1, rows.shape[1], 3)]
    known: list[Any] = [*columns, None, None, None]
    return RecordedReference(leaf(rows[:, 0]), *known[:5])


@jax.jit
def recording(recorded: RecordedReference) -> Recording:
    """Complete the samples: derivatives by differences, rotations between samples, angular velocities."""
    times = jnp.asarray(recorded.times)
    com = [jnp.asarray(recorded.com_position)]
    for known in (recorded.com_velocity, recorded.com_acceleration, recorded.com_jerk):
        com.append(_differences(times, com[-1]) if known is None else jnp.asarray(known))
    rotations = jax.jit(rotation_from_rpy)(recorded.rpy)
    turns = log_so3(multiply(jnp.swapaxes(rotations[:-1], 1, 2), rotations[1:]))
    rates = turns / jnp.diff(times)[:, None]
    # Mean of the rates before and after; at the ends there is only one.
    mean = 0.5 * (jnp.concatenate([rates[:1], rates]) + jnp.concatenate([rates, rates[-1:]]))
    return Recording(times, RecordedMotion(jnp.stack(com, axis=1), rotations, mean), turns)


def motion_at(recording: Recording, time: Float[Array, ""]) -> RecordedMotion:
    """Return the reference at `time` [s]; before the first and after the last sample it is at rest there.

    Between samples position, velocity and acceleration each follow the cubic whose slopes at both samples are the next
    derivative; jerk and angular velocity are interpolated linearly, and the base rotates at a constant rate.
    """
    times = recording.times
    before = jnp.clip(jnp.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)
    a, b = (jax.tree.map(lambda leaf, at=at: leaf[at], recording.samples) for at in (before, before + 1))
    h = times[before + 1] - times[before]
    s = jnp.clip((time - times[before]) / h, 0.0, 1.0)
    r = 1.0 - s
    cubics = (
        a.com[:3] * (r * r * (1.0 + 2.0 * s))
        + b.com[:3] * (s * s * (1.0 + 2.0 * r))
        + (a.com[1:] * r - b.com[1:] * s) * (h * s * r)
    )
    com = jnp.concatenate([cubics, a.com[3:] + s * (b.com[3:] - a.com[3:])])
    # The last sample itself belongs to the recording.
    moves = (time >= times[0]) & (time <= times[-1])
    return RecordedMotion(
        com=jnp.where(moves | (jnp.arange(4) == 0)[:, None], com, 0.0),
        rotation=multiply(a.rotation, exp_so3(recording.turns[before] * s)),
        angular_velocity=jnp.where(moves, a.angular_velocity + s * (b.angular_velocity - a.angular_velocity), 0.0),
    )


def _differences(times: Array, values: Array) -> Array:
    """Slopes at the samples: of the parabola through each sample and its neighbours; at the ends, of the line."""
    steps = jnp.diff(times)[:, None]
    slopes = jnp.diff(values, axis=0) / steps
    inner = (slopes[:-1] * steps[1:] + slopes[1:] * steps[:-1]) / (steps[:-1] + steps[1:])
    return jnp.concatenate([slopes[:1], inner, slopes[-1:]])
