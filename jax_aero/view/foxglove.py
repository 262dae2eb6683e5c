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
from jax_aero.view.topics import WORLD, Content, Form, Forms, Topic, force_and_torque, named, signal_of, topics_of, xyzw

encode = msgspec.json.Encoder().encode
"""Function from a document to its JSON: every bit of a number, and null for NaN."""


Message = Callable[[Any, dict[str, int]], Any]
"""Function from the values and the time stamp of a message to the message."""

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


def topics(recording: Recording) -> Iterator[Topic]:
    """Yield the topics that viewers draw, and one for every signal."""
    log = recording.signals
    base = Content("/base", "pose", lambda tick: (log["base_position"][tick], log["base_quaternion"][tick]))
    return topics_of(recording, FORMS, [base])


def _form(schema: str, properties: Mapping[str, Any], message: Message) -> Form:
    def encoded(values: Any, stamp: int) -> bytes:
        return encode(message(values, {"sec": stamp // 10**9, "nsec": stamp % 10**9}))

    return Form(schema, encode(_object(properties, title=schema)), encoded)


def _joints(_: Content, recording: Recording) -> Form:
    def joints(parts: Any, stamp: dict[str, int]) -> Any:
        rows = zip(recording.robot.joint_names, *(part.tolist() for part in parts), strict=True)
        return {"timestamp": stamp, "joints": [dict(zip(JOINT, row, strict=True)) for row in rows]}

    return _form("foxglove.JointStates", {"timestamp": STAMP, "joints": _list(JOINT)}, joints)


def _signal(content: Content, recording: Recording) -> Form:
    name = signal_of(content)
    signal, entries = rust.signals()[name], [entry or ("value",) for entry in entries_of(name, recording.robot)]
    number = NUMBER | {"description": f"{signal.meaning} [{signal.unit}]"}
    properties = _nested(entries, [number] * len(entries), _object)
    return _form(f"jax_aero.{name}", properties, lambda row, _: _nested(entries, row.tolist()))


def _transforms(frames: Any, stamp: dict[str, int]) -> Any:
    transforms = [
        {
            "timestamp": stamp,
            "parent_frame_id": parent,
            "child_frame_id": name,
            "translation": named("xyz", position),
            "rotation": xyzw(wxyz),
        }
        for parent, name, position, wxyz in frames
    ]
    return {"transforms": transforms}


def _pose(pose: Any, stamp: dict[str, int]) -> Any:
    position, wxyz = pose
    return {
        "timestamp": stamp,
        "frame_id": WORLD,
        "pose": {"position": named("xyz", position), "orientation": xyzw(wxyz)},
    }


def _wrench(wrench: Any, stamp: dict[str, int]) -> Any:
    return {"header": {"stamp": stamp, "frame_id": WORLD}, "wrench": force_and_torque(wrench)}


def _nested(entries: Sequence[tuple[str, ...]], values: Sequence[Any], wrap: Callable[[Any], Any] = dict) -> Any:
    """Return nested tables of the values, by the names of each entry; `wrap` makes the inner ones."""
    if entries and len(entries[0]) > 1:
        groups = itertools.groupby(zip(entries, values, strict=True), lambda pair: pair[0][0])
        return {name: wrap({entry[1]: value for entry, value in group}) for name, group in groups}
    return {entry[0]: value for entry, value in zip(entries, values, strict=True)}


FORMS: Forms = {
    "text": lambda *_: _form("std_msgs/String", {"data": TEXT}, lambda text, _: {"data": text}),
    "poses": lambda *_: _form("foxglove.FrameTransforms", {"transforms": _list(TRANSFORM)}, _transforms),
    "pose": lambda *_: _form("foxglove.PoseInFrame", POSE, _pose),
    "joints": _joints,
    "wrench": lambda *_: _form("geometry_msgs/WrenchStamped", WRENCH, _wrench),
    "signal": _signal,
}
