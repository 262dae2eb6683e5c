"""What the topics of an MCAP file hold of a flight, whatever encodes their messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from jax_aero.body.spatial import rotation_from_rpy, wxyz_from_rotation
from jax_aero.view.recording import Recording

WORLD = "world"
"""Name of the inertial frame."""


class Topic(NamedTuple):
    """A topic of an MCAP file.

    Attributes
    ----------
    schema, definition
        Name and text of the schema of its messages.
    message
        Function from the number of a tick and its time stamp [ns] to the encoded message; `None` for no message.
    metadata
        Facts about the topic.
    """

    name: str
    schema: str
    definition: bytes
    message: Callable[[int, int], bytes | None]
    metadata: Mapping[str, str] = {}


def body_poses(recording: Recording) -> tuple[Any, Any]:
    """Return the positions [m] and quaternions of all bodies, (n, bodies, 3) and (n, bodies, 4)."""
    instants = [recording.at(time) for time in recording.signals["time"]]
    positions = np.array([now.body_positions for now in instants])
    return positions, wxyz_from_rotation(np.array([now.body_rotations for now in instants]))


def setpoints(recording: Recording) -> tuple[Any, Any]:
    """Return the positions [m] of the set-point, which are those of the centre of mass, and its quaternions."""
    desired = wxyz_from_rotation(rotation_from_rpy(recording.signals["base_rpy_setpoint"]))
    return recording.signals["com_setpoint"], desired


def wrenches(recording: Recording) -> dict[str, Any]:
    """Return the wrenches of the log by their names, (n, 6); inertial axes."""
    robot, log = recording.robot, recording.signals
    found = {"unmodelled": log["unmodelled_wrench"]} if "unmodelled_wrench" in log else {}
    if "foot_wrench" in log:
        found |= {foot: log["foot_wrench"][:, index] for index, foot in enumerate(robot.foot_names)}
    return found


def named(names: str, numbers: Any) -> dict[str, float]:
    """Return numbers by names of one letter."""
    return dict(zip(names, map(float, numbers), strict=True))


def xyzw(wxyz: Any) -> dict[str, float]:
    """Return the entries of a quaternion by their names."""
    return named("xyzw", (*wxyz[1:], wxyz[0]))
