"""Topics of an MCAP file in JSON: Foxglove's schemas, which viewers draw, and every signal by the names of its entries.

JSON holds every bit of a number; null stands for NaN.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec

from jax_aero import rust
from jax_aero.view.recording import Recording, entries_of
from jax_aero.view.topics import WORLD, Topic, body_poses, named, setpoints, wrenches, xyzw

encode = msgspec.json.Encoder().encode
"""Function from a document to its JSON: every bit of a number, and null for NaN."""

Message = Callable[[int, dict[str, int]], Any]
"""Function from the number of a tick and its time stamp to the message; `None` for no message."""


def topics(recording: Recording) -> Iterator[Topic]:
    """Yield the topics that viewers draw, as far as the signals are there, and one for every signal."""
    for name, schema, properties, message in itertools.chain(_viewer_topics(recording), _signal_topics(recording)):

        def encoded(tick: int, stamp: int, message: Message = message) -> bytes | None:
            found = message(tick, {"sec": stamp // 10**9, "nsec": stamp % 10**9})
            return None if found is None else encode(found)

        yield Topic(name, schema, encode(_object(properties, title=schema)), encoded)


NUMBER: dict[str, Any] = {"type": ["number", "null"]}
TEXT: dict[str, Any] = {"type": "string"}


def _object(properties: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, **more}


def _list(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": _object(properties)}


STAMP = _object({"sec": {"type": "integer"}, "nsec": {"type": "integer"}}, title="time")
VECTOR = _object(dict.fromkeys("xyz", NUMBER))
QUATERNION = _object(dict.fromkeys("xyzw", NUMBER))
TRANSFORM = {
    "timestamp": STAMP,
    "parent_frame_id": TEXT,
    "child_frame_id": TEXT,
    "translation": VECTOR,
    "rotation": QUATERNION,
}
POSE = {"timestamp": STAMP, "frame_id": TEXT, "pose": _object({"position": VECTOR, "orientation": QUATERNION})}
JOINT = {"name": TEXT, "position": NUMBER, "velocity": NUMBER, "effort": NUMBER}
WRENCH = {
    "header": _object({"stamp": STAMP, "frame_id": TEXT}),
    "wrench": _object({"force": VECTOR, "torque": VECTOR}),
}


def _viewer_topics(recording: Recording) -> Iterator[tuple[str, str, dict[str, Any], Message]]:
    """Yield topic, schema, properties of a message, and messages of what viewers draw."""
    robot, log = recording.robot, recording.signals
    urdf = {"data": robot.urdf_text}
    yield "/robot_description", "std_msgs/String", {"data": TEXT}, lambda tick, _: urdf if tick == 0 else None

    positions, rotations = (part.tolist() for part in body_poses(recording))

    def transforms(tick: int, stamp: dict[str, int]) -> Any:
        frames = [
            {
                "timestamp": stamp,
                "parent_frame_id": WORLD,
                "child_frame_id": name,
                "translation": named("xyz", position),
                "rotation": xyzw(wxyz),
            }
            for name, position, wxyz in zip(robot.body_names, positions[tick], rotations[tick], strict=True)
        ]
        return {"transforms": frames}

    yield "/tf", "foxglove.FrameTransforms", {"transforms": _list(TRANSFORM)}, transforms

    def pose(position: Any, wxyz: Any) -> Message:
        return lambda tick, stamp: {
            "timestamp": stamp,
            "frame_id": WORLD,
            "pose": {"position": named("xyz", position[tick]), "orientation": xyzw(wxyz[tick])},
        }

    yield "/base", "foxglove.PoseInFrame", POSE, pose(log["base_position"], log["base_quaternion"])
    yield "/setpoint", "foxglove.PoseInFrame", POSE, pose(*setpoints(recording))

    if {"joint_velocity", "joint_torque"} <= log.keys():
        parts = [log[name].tolist() for name in ("joint_position", "joint_velocity", "joint_torque")]

        def joints(tick: int, stamp: dict[str, int]) -> Any:
            rows = zip(robot.joint_names, *(part[tick] for part in parts), strict=True)
            return {"timestamp": stamp, "joints": [dict(zip(JOINT, row, strict=True)) for row in rows]}

        yield "/joint_states", "foxglove.JointStates", {"timestamp": STAMP, "joints": _list(JOINT)}, joints

    def wrench(rows: Any) -> Message:
        return lambda tick, stamp: {
            "header": {"stamp": stamp, "frame_id": WORLD},
            "wrench": {"force": named("xyz", rows[tick, :3]), "torque": named("xyz", rows[tick, 3:])},
        }

    for name, rows in wrenches(recording).items():
        yield f"/wrench/{name}", "geometry_msgs/WrenchStamped", WRENCH, wrench(rows)


def _signal_topics(recording: Recording) -> Iterator[tuple[str, str, dict[str, Any], Message]]:
    """Yield the same for every signal."""
    for name, signal in rust.signals().items():
        if name not in recording.signals:
            continue
        entries = [entry or ("value",) for entry in entries_of(name, recording.robot)]
        number = NUMBER | {"description": f"{signal.meaning} [{signal.unit}]"}
        properties = _nested(entries, [number] * len(entries), _object)
        rows = recording.rows(name).tolist()

        def message(tick: int, _: Any, rows: Any = rows, entries: Any = entries) -> Any:
            return _nested(entries, rows[tick])

        yield f"/signals/{name}", f"jax_aero.{name}", properties, message


def _nested(entries: Sequence[tuple[str, ...]], values: Sequence[Any], wrap: Callable[[Any], Any] = dict) -> Any:
    """Return nested tables of the values, by the names of each entry; `wrap` makes the inner ones."""
    if entries and len(entries[0]) > 1:
        groups = itertools.groupby(zip(entries, values, strict=True), lambda pair: pair[0][0])
        return {name: wrap({entry[1]: value for entry, value in group}) for name, group in groups}
    return {entry[0]: value for entry, value in zip(entries, values, strict=True)}
