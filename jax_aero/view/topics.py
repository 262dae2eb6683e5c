"""The topics of an MCAP file of a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain, repeat
from typing import Any, NamedTuple

import numpy as np

from jax_aero import rust
from jax_aero.body.spatial import rotation_from_rpy, wxyz_from_rotation
from jax_aero.view.recording import Recording

WORLD = "world"
"""Name of the inertial frame."""


class Content(NamedTuple):
    """What a topic of an MCAP file holds, whatever encodes its messages.

    Attributes
    ----------
    kind
        `text`; `poses`, each with the frame that it is in and the name of its own; `pose`; `odometry`; `joints`;
        `wrench`; or `signal`.
    at
        Function from the number of a tick to the values of its message; `None` for no message.
    is_latched
        Whether its only message is one for whoever listens later too.
    """

    topic: str
    kind: str
    at: Callable[[int], Any]
    is_latched: bool = False


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


class Form(NamedTuple):
    """How the messages of a topic are encoded.

    Attributes
    ----------
    schema, definition
        Name and text of their schema.
    encode
        Function from the values of a message and its time stamp [ns] to the encoded message.
    metadata
        Facts about the topic.
    """

    schema: str
    definition: bytes
    encode: Callable[[Any, int], bytes]
    metadata: Mapping[str, str] = {}


Forms = Mapping[str, Callable[[Content, Recording], Form]]
"""Forms of topics, by the kind of their content."""


def topics_of(recording: Recording, forms: Forms, more: Iterable[Content] = ()) -> Iterator[Topic]:
    """Yield what viewers draw, every signal, and more, in these forms."""
    for content in chain(contents(recording), more):
        form = forms[content.kind](content, recording)

        def message(tick: int, stamp: int, content: Content = content, form: Form = form) -> bytes | None:
            values = content.at(tick)
            return None if values is None else form.encode(values, stamp)

        yield Topic(content.topic, form.schema, form.definition, message, form.metadata)


def contents(recording: Recording) -> Iterator[Content]:
    """Yield what viewers draw, as far as the signals are there, and every signal; inertial axes, quaternions `wxyz`."""
    robot, log = recording.robot, recording.signals
    yield Content("/robot_description", "text", lambda tick: robot.urdf_text if tick == 0 else None, is_latched=True)
    instants = [recording.at(time) for time in log["time"]]
    positions = np.array([now.body_positions for now in instants]).tolist()
    turns = wxyz_from_rotation(np.array([now.body_rotations for now in instants])).tolist()
    names = robot.body_names
    yield Content("/tf", "poses", lambda tick: list(zip(repeat(WORLD), names, positions[tick], turns[tick])))
    fixed = [
        (names[body], link, position.tolist(), wxyz_from_rotation(rotation).tolist())
        for link, (body, (rotation, position)) in robot.links().items()
        if link not in names
    ]
    if fixed:
        yield Content("/tf_static", "poses", lambda tick: fixed if tick == 0 else None, is_latched=True)
    desired = wxyz_from_rotation(rotation_from_rpy(log["base_rpy_setpoint"]))
    yield Content("/setpoint", "pose", lambda tick: (log["com_setpoint"][tick], desired[tick]))
    if {"joint_velocity", "joint_torque"} <= log.keys():
        parts = [log[name] for name in ("joint_position", "joint_velocity", "joint_torque")]
        yield Content("/joint_states", "joints", lambda tick: [part[tick] for part in parts])
    wrenches = {"unmodelled": log["unmodelled_wrench"]} if "unmodelled_wrench" in log else {}
    feet = log.get("foot_wrench", log.get("raw_foot_wrench"))  # a log of others has what was measured
    if feet is not None:
        wrenches |= {foot: feet[:, index] for index, foot in enumerate(robot.foot_names)}
    for name, rows in wrenches.items():
        yield Content(f"/wrench/{name}", "wrench", rows.__getitem__)
    for name in rust.signals():
        if name in log:
            yield Content(f"/signals/{name}", "signal", recording.rows(name).__getitem__)


def force_and_torque(wrench: Any) -> dict[str, Any]:
    """Return a wrench (6,) by the names of its parts."""
    return {"force": named("xyz", wrench[:3]), "torque": named("xyz", wrench[3:])}


def signal_of(content: Content) -> str:
    """Return the name of the signal that a topic holds."""
    return content.topic.rpartition("/")[2]


def named(names: str, numbers: Any) -> dict[str, float]:
    """Return numbers by names of one letter."""
    return dict(zip(names, map(float, numbers), strict=True))


def xyzw(wxyz: Any) -> dict[str, float]:
    """Return the entries of a quaternion by their names."""
    return named("xyzw", (*wxyz[1:], wxyz[0]))
