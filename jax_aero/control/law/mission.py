"""The mission of a controller: commands of an autopilot, or a recorded reference."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.config import MissionConfig
from jax_aero.control.law.recorded import Recording, read_reference, recording
from jax_aero.types import Array, leaf, pytree


class AutopilotCommand(NamedTuple):
    """Commands of one tick: -1, 0 or 1 in the robot's forward, left, up axes."""

    forward: Float[Array, ""]
    vertical: Float[Array, ""]
    nose_down: Float[Array, ""]
    """Rotation about the left axis."""
    yaw: Float[Array, ""]
    """Rotation about the vertical, positive to the left."""
    turbo: Bool[Array, ""]
    """Whether the forward speed is boosted."""
    lands: Bool[Array, ""]
    """Whether the robot is to land: near the ground it descends slowly."""


@pytree
class Commands:
    """Commands of the autopilot: for each motion, open intervals (k, 2) of time [s]."""

    up: Float[Array, "_ 2"]
    down: Float[Array, "_ 2"]
    land: Float[Array, "_ 2"]
    forward: Float[Array, "_ 2"]
    forward_turbo: Float[Array, "_ 2"]
    pitch_up: Float[Array, "_ 2"]
    yaw_left: Float[Array, "_ 2"]


def commands(mission: MissionConfig) -> Commands:
    """Return the commands of a configured mission."""
    lists = {item.name: leaf(getattr(mission, item.name) or ()) for item in fields(Commands)}
    return Commands(**{name: intervals.reshape(-1, 2) for name, intervals in lists.items()})


def autopilot_command(mission: Commands, time: Float[Array, ""]) -> AutopilotCommand:
    """Return the command at `time` [s]; a command is active inside its open intervals."""
    time = jnp.asarray(time)
    # A tick at the end of an interval is outside; the margin prevents rounding of k · 0.01 from moving it inside.
    margin = jnp.maximum(1e-9, 4.0 * float(np.finfo(time.dtype).eps) * jnp.abs(time))

    def is_active(intervals: Array) -> Array:
        return jnp.any((time > intervals[:, 0] + margin) & (time < intervals[:, 1] - margin))

    def flag(intervals: Array) -> Array:
        return is_active(intervals).astype(time.dtype)

    turbo, lands = is_active(mission.forward_turbo), is_active(mission.land)
    return AutopilotCommand(
        forward=(turbo | is_active(mission.forward)).astype(time.dtype),
        vertical=flag(mission.up) - (is_active(mission.down) | lands).astype(time.dtype),
        nose_down=-flag(mission.pitch_up),
        yaw=flag(mission.yaw_left),
        turbo=turbo,
        lands=lands,
    )


Mission: TypeAlias = Commands | Recording
"""The autopilot's commands, or recorded set-points."""


def load_mission(mission: MissionConfig) -> Mission:
    """Return the mission of a configuration; reads its file, if it names one."""
    return commands(mission) if mission.file is None else recording(read_reference(mission.file))
