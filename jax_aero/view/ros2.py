"""Topics of an MCAP file as messages of ROS 2, by `rosbags`: standard types, and every signal as a `Float64MultiArray`.

The dimensions of an array are labelled; the topic's metadata hold unit, meaning and the names of the entries. Stamps
are seconds since the flight began.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.view.recording import Recording, axes_of, entries_of
from jax_aero.view.topics import WORLD, Topic, body_poses, named, setpoints, wrenches, xyzw

BAG = "metadata.yaml"
"""Name of the file that makes a bag of a folder with an MCAP file."""

Message = Callable[[int, dict[str, int]], Any]
"""Function from the number of a tick and its time stamp to the message; `None` for no message."""


def describe_bag(file: str, counts: Mapping[tuple[str, str], int], end: int) -> str:
    """Return the metadata of a bag of one file, with the messages of each topic and type, until `end` [ns]."""
    about = {"serialization_format": "cdr", "offered_qos_profiles": ""}
    topics = [
        {"topic_metadata": {"name": topic, "type": kind, **about}, "message_count": count}
        for (topic, kind), count in counts.items()
    ]
    information = {
        "version": 5, "storage_identifier": "mcap", "relative_file_paths": [file], "duration": {"nanoseconds": end},
        "starting_time": {"nanoseconds_since_epoch": 0}, "message_count": sum(counts.values()),
        "topics_with_message_count": topics, "compression_format": "", "compression_mode": "",
    }  # fmt: skip
    return json.dumps({"rosbag2_bagfile_information": information}, indent=1) + "\n"  # JSON is YAML too


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
    for name, kind, message, metadata in _topics(recording):

        def encoded(tick: int, stamp: int, message: Message = message, kind: str = kind) -> bytes | None:
            found = message(tick, {"sec": stamp // 10**9, "nanosec": stamp % 10**9})
            return None if found is None else encode(kind, found)

        definition, _ = _store().generate_msgdef(kind, ros_version=2)
        yield Topic(name, kind, definition.encode(), encoded, metadata)


def _topics(recording: Recording) -> Iterator[tuple[str, str, Message, dict[str, str]]]:
    robot, log = recording.robot, recording.signals
    urdf = {"data": robot.urdf_text}
    yield "/robot_description", "std_msgs/msg/String", lambda tick, _: urdf if tick == 0 else None, {}

    positions, rotations = (part.tolist() for part in body_poses(recording))

    def transforms(tick: int, stamp: dict[str, int]) -> Any:
        bodies = zip(robot.body_names, positions[tick], rotations[tick], strict=True)
        return {
            "transforms": [
                {
                    "header": _header(stamp),
                    "child_frame_id": name,
                    "transform": {"translation": named("xyz", position), "rotation": xyzw(wxyz)},
                }
                for name, position, wxyz in bodies
            ]
        }

    yield "/tf", "tf2_msgs/msg/TFMessage", transforms, {}

    if "base_velocity" in log:
        unknown = [0.0] * 36
        # In axes of the base.
        i_from_b = rust.rotation_from_wxyz(log["base_quaternion"])
        linear, angular = (
            np.einsum("nji,nj->ni", i_from_b, part) for part in np.split(log["base_velocity"], 2, axis=1)
        )

        def odometry(tick: int, stamp: dict[str, int]) -> Any:
            twist = {"linear": named("xyz", linear[tick]), "angular": named("xyz", angular[tick])}
            pose = _pose(log["base_position"][tick], log["base_quaternion"][tick])
            return {
                "header": _header(stamp),
                "child_frame_id": robot.body_names[0],
                "pose": {"pose": pose, "covariance": unknown},
                "twist": {"twist": twist, "covariance": unknown},
            }

        yield "/odom", "nav_msgs/msg/Odometry", odometry, {}

    desired = setpoints(recording)

    def setpoint(tick: int, stamp: dict[str, int]) -> Any:
        return {"header": _header(stamp), "pose": _pose(*(part[tick] for part in desired))}

    yield "/setpoint", "geometry_msgs/msg/PoseStamped", setpoint, {}

    if {"joint_velocity", "joint_torque"} <= log.keys():
        signals = {"position": "joint_position", "velocity": "joint_velocity", "effort": "joint_torque"}

        def joints(tick: int, stamp: dict[str, int]) -> Any:
            numbers = {field: log[name][tick] for field, name in signals.items()}
            return {"header": _header(stamp), "name": robot.joint_names, **numbers}

        yield "/joint_states", "sensor_msgs/msg/JointState", joints, {}

    def wrench(rows: Any) -> Message:
        return lambda tick, stamp: {
            "header": _header(stamp),
            "wrench": {"force": named("xyz", rows[tick, :3]), "torque": named("xyz", rows[tick, 3:])},
        }

    for name, rows in wrenches(recording).items():
        yield f"/wrench/{name}", "geometry_msgs/msg/WrenchStamped", wrench(rows), {}

    for name, signal in rust.signals().items():
        if name in log:
            yield (
                f"/signals/{name}",
                "std_msgs/msg/Float64MultiArray",
                _array(name, recording),
                {
                    "unit": signal.unit,
                    "meaning": signal.meaning,
                    "entries": ",".join("/".join(entry) for entry in entries_of(name, recording.robot)),
                },
            )


def _array(name: str, recording: Recording) -> Message:
    """Return the messages of a signal."""
    sizes = [len(names) for names in axes_of(name, recording.robot)]
    labels = rust.signals()[name].dims[1:]
    # As the type defines it, the stride of a dimension includes the dimension itself.
    dims = [
        {"label": label, "size": size, "stride": int(np.prod(sizes[place:]))}
        for place, (label, size) in enumerate(zip(labels, sizes, strict=True))
    ]
    layout, rows = {"dim": dims, "data_offset": 0}, recording.rows(name)
    return lambda tick, _: {"layout": layout, "data": rows[tick]}


def _header(stamp: dict[str, int]) -> dict[str, Any]:
    return {"stamp": stamp, "frame_id": WORLD}


def _pose(position: Any, wxyz: Any) -> dict[str, Any]:
    return {"position": named("xyz", position), "orientation": xyzw(wxyz)}
