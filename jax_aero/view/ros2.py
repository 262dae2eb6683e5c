"""Topics of an MCAP file as messages of ROS 2, by `rosbags`: standard types, and every signal as a `Float64MultiArray`.

The dimensions of an array are labelled; the topic's metadata hold unit, meaning and the names of the entries. Stamps
are seconds since the flight began.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.view.recording import Recording, axes_of, entries_of
from jax_aero.view.topics import WORLD, Content, Form, Forms, Topic, force_and_torque, named, signal_of, topics_of, xyzw

BAG = "metadata.yaml"
"""Name of the file that makes a bag of a folder with an MCAP file."""

FOREVER = {"sec": 9223372036, "nsec": 854775807}
"""Longest duration of ROS 2: 2⁶³ − 1 ns."""

LATCHED = {
    "history": 1, "depth": 1, "reliability": 1, "durability": 1, "deadline": FOREVER, "lifespan": FOREVER,
    "liveliness": 1, "liveliness_lease_duration": FOREVER, "avoid_ros_namespace_conventions": False,
}  # fmt: skip
"""Quality of service of a message for whoever listens later too: the last one, reliable, `transient_local`."""

QOS = "offered_qos_profiles"
"""Key of the quality of service of a topic, a list in YAML."""

Message = Callable[[Any, dict[str, Any]], Any]
"""Function from the values and the header of a message to the message."""


def describe_bag(file: str, topics: Sequence[tuple[Topic, int]], end: int) -> str:
    """Return the metadata of a bag of one file, with the number of messages of each topic, until `end` [ns]."""

    def about(topic: Topic) -> dict[str, str]:
        quality = topic.metadata.get(QOS, "")
        return {"name": topic.name, "type": topic.schema, "serialization_format": "cdr", QOS: quality}

    described = [{"topic_metadata": about(topic), "message_count": count} for topic, count in topics]
    information = {
        "version": 5, "storage_identifier": "mcap", "relative_file_paths": [file], "duration": {"nanoseconds": end},
        "starting_time": {"nanoseconds_since_epoch": 0}, "message_count": sum(count for _, count in topics),
        "topics_with_message_count": described, "compression_format": "", "compression_mode": "",
    }  # fmt: skip
    return json.dumps({"rosbag2_bagfile_information": information}, indent=1) + "\n"


def encode(kind: str, message: Mapping[str, Any]) -> bytes:
    """Return a message in CDR.

    >>> encode("std_msgs/msg/String", {"data": "up"}).hex(" ")
    '00 01 00 00 03 00 00 00 75 70 00'
    """
    return bytes(_store().serialize_cdr(_typed(kind, message), kind))


@cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def _typed(kind: str, message: Mapping[str, Any]) -> Any:
    """Return a message as an object of its type."""
    parts = {name: _part(form, message[name]) for name, form in _store().fielddefs[kind][1]}
    return _store().types[kind](**parts)


def _part(form: Any, value: Any) -> Any:
    """Return a field: of a type by its name, a list of one or of numbers, or plain."""
    node, inner = form
    if node.name == "NAME":
        return _typed(inner, value)
    if node.name == "BASE":
        return value
    (item, kind), _ = inner
    if item.name == "NAME":
        return [_typed(kind, each) for each in value]
    return value if kind[0] == "string" else np.asarray(value, kind[0])


def topics(recording: Recording) -> Iterator[Topic]:
    """Yield the topics that viewers draw, as far as the signals are there, and one for every signal."""
    return topics_of(recording, FORMS, [_base(recording)] if "base_velocity" in recording.signals else [])


def _form(content: Content, kind: str, message: Message, metadata: Mapping[str, str] = {}) -> Form:
    def encoded(values: Any, stamp: int) -> bytes:
        header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": WORLD}
        return encode(kind, message(values, header))

    if content.is_latched:
        metadata = {**metadata, QOS: json.dumps([LATCHED])}  # JSON is YAML too
    definition, _ = _store().generate_msgdef(kind, ros_version=2)
    return Form(kind, definition.encode(), encoded, metadata)


def _base(recording: Recording) -> Content:
    """Return pose and velocity of the base, the latter in its own axes."""
    log = recording.signals
    i_from_b = rust.rotation_from_wxyz(log["base_quaternion"])
    parts = [np.einsum("nji,nj->ni", i_from_b, part) for part in np.split(log["base_velocity"], 2, axis=1)]
    signals = [log["base_position"], log["base_quaternion"], *parts]
    return Content("/odom", "odometry", lambda tick: [signal[tick] for signal in signals])


def _odometry(content: Content, recording: Recording) -> Form:
    def odometry(values: Any, header: dict[str, Any]) -> Any:
        position, wxyz, linear, angular = values
        unknown, twist = [0.0] * 36, {"linear": named("xyz", linear), "angular": named("xyz", angular)}
        return {
            "header": header,
            "child_frame_id": recording.robot.body_names[0],
            "pose": {"pose": _pose(position, wxyz), "covariance": unknown},
            "twist": {"twist": twist, "covariance": unknown},
        }

    return _form(content, "nav_msgs/msg/Odometry", odometry)


def _joints(content: Content, recording: Recording) -> Form:
    def joints(parts: Any, header: dict[str, Any]) -> Any:
        numbers = dict(zip(("position", "velocity", "effort"), parts, strict=True))
        return {"header": header, "name": recording.robot.joint_names, **numbers}

    return _form(content, "sensor_msgs/msg/JointState", joints)


def _signal(content: Content, recording: Recording) -> Form:
    name = signal_of(content)
    entries = ",".join("/".join(entry) for entry in entries_of(name, recording.robot))
    facts = {"unit": rust.signals()[name].unit, "meaning": rust.signals()[name].meaning, "entries": entries}
    return _form(content, "std_msgs/msg/Float64MultiArray", _array(name, recording), facts)


def _transforms(frames: Any, header: dict[str, Any]) -> Any:
    transforms = [
        {
            "header": {**header, "frame_id": parent},
            "child_frame_id": name,
            "transform": {"translation": named("xyz", position), "rotation": xyzw(wxyz)},
        }
        for parent, name, position, wxyz in frames
    ]
    return {"transforms": transforms}


def _array(name: str, recording: Recording) -> Message:
    """Return the messages of a signal."""
    sizes = [len(names) for names in axes_of(name, recording.robot)]
    labels = rust.signals()[name].dims[1:]
    # As the type defines it, the stride of a dimension includes the dimension itself.
    dims = [
        {"label": label, "size": size, "stride": int(np.prod(sizes[place:]))}
        for place, (label, size) in enumerate(zip(labels, sizes, strict=True))
    ]
    layout = {"dim": dims, "data_offset": 0}
    return lambda row, _: {"layout": layout, "data": row}


def _pose(position: Any, wxyz: Any) -> dict[str, Any]:
    return {"position": named("xyz", position), "orientation": xyzw(wxyz)}


def _stamped_pose(pose: Any, header: dict[str, Any]) -> Any:
    return {"header": header, "pose": _pose(*pose)}


def _wrench(wrench: Any, header: dict[str, Any]) -> Any:
    return {"header": header, "wrench": force_and_torque(wrench)}


FORMS: Forms = {
    "text": lambda content, _: _form(content, "std_msgs/msg/String", lambda text, _: {"data": text}),
    "poses": lambda content, _: _form(content, "tf2_msgs/msg/TFMessage", _transforms),
    "pose": lambda content, _: _form(content, "geometry_msgs/msg/PoseStamped", _stamped_pose),
    "odometry": _odometry,
    "joints": _joints,
    "wrench": lambda content, _: _form(content, "geometry_msgs/msg/WrenchStamped", _wrench),
    "signal": _signal,
}
