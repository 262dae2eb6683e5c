"""Topics of an MCAP file as messages of ROS 2, in CDR: standard types, and every signal as a `Float64MultiArray`.

The dimensions of an array are labelled; the topic's metadata hold unit, meaning and the names of the entries. Stamps
are seconds since the flight began.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.view.recording import Recording, axes_of, entries_of
from jax_aero.view.topics import WORLD, Topic, body_poses, named, setpoints, wrenches, xyzw

FIELDS: dict[str, dict[str, str]] = {
    "builtin_interfaces/Time": {"sec": "int32", "nanosec": "uint32"},
    "geometry_msgs/Point": dict.fromkeys("xyz", "float64"),
    "geometry_msgs/Pose": {"position": "geometry_msgs/Point", "orientation": "geometry_msgs/Quaternion"},
    "geometry_msgs/PoseStamped": {"header": "std_msgs/Header", "pose": "geometry_msgs/Pose"},
    "geometry_msgs/PoseWithCovariance": {"pose": "geometry_msgs/Pose", "covariance": "float64[36]"},
    "geometry_msgs/Quaternion": dict.fromkeys("xyzw", "float64"),
    "geometry_msgs/Transform": {"translation": "geometry_msgs/Vector3", "rotation": "geometry_msgs/Quaternion"},
    "geometry_msgs/TransformStamped": {
        "header": "std_msgs/Header",
        "child_frame_id": "string",
        "transform": "geometry_msgs/Transform",
    },
    "geometry_msgs/Twist": {"linear": "geometry_msgs/Vector3", "angular": "geometry_msgs/Vector3"},
    "geometry_msgs/TwistWithCovariance": {"twist": "geometry_msgs/Twist", "covariance": "float64[36]"},
    "geometry_msgs/Vector3": dict.fromkeys("xyz", "float64"),
    "geometry_msgs/Wrench": {"force": "geometry_msgs/Vector3", "torque": "geometry_msgs/Vector3"},
    "geometry_msgs/WrenchStamped": {"header": "std_msgs/Header", "wrench": "geometry_msgs/Wrench"},
    "nav_msgs/Odometry": {
        "header": "std_msgs/Header",
        "child_frame_id": "string",
        "pose": "geometry_msgs/PoseWithCovariance",
        "twist": "geometry_msgs/TwistWithCovariance",
    },
    "sensor_msgs/JointState": {
        "header": "std_msgs/Header",
        "name": "string[]",
        "position": "float64[]",
        "velocity": "float64[]",
        "effort": "float64[]",
    },
    "std_msgs/Float64MultiArray": {"layout": "std_msgs/MultiArrayLayout", "data": "float64[]"},
    "std_msgs/Header": {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
    "std_msgs/MultiArrayDimension": {"label": "string", "size": "uint32", "stride": "uint32"},
    "std_msgs/MultiArrayLayout": {"dim": "std_msgs/MultiArrayDimension[]", "data_offset": "uint32"},
    "std_msgs/String": {"data": "string"},
    "tf2_msgs/TFMessage": {"transforms": "geometry_msgs/TransformStamped[]"},
}
"""Fields of the messages, in order, with their types."""

NUMBERS = {"int32": "i", "uint32": "I", "float64": "d"}
"""Formats of numbers in `struct`."""

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""First bytes of a message in CDR."""

BAG = "metadata.yaml"
"""Name of the file that makes a bag of a folder with an MCAP file."""

Message = Callable[[int, dict[str, int]], Any]
"""Function from the number of a tick and its time stamp to the message; `None` for no message."""


def define(kind: str) -> str:
    """Return the definition of a message and of those within it, in the form `ros2msg`."""
    kinds = [kind]
    for each in kinds:
        inner = (field.partition("[")[0] for field in FIELDS[each].values())
        kinds += [name for name in dict.fromkeys(inner) if name in FIELDS and name not in kinds]
    texts = ["".join(f"{field} {name}\n" for name, field in FIELDS[each].items()) for each in kinds]
    others = (f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in zip(kinds[1:], texts[1:], strict=True))
    return "".join([texts[0], *others])


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
    """Return a message in CDR, XCDR1 with little-endian numbers.

    >>> encode("std_msgs/String", {"data": "up"}).hex(" ")
    '00 01 00 00 03 00 00 00 75 70 00'
    """
    written = bytearray(LITTLE_ENDIAN)
    _write(written, kind, message)
    return bytes(written)


def _write(to: bytearray, kind: str, value: Any) -> None:
    item, is_array, length = kind.rstrip("]").partition("[")
    if kind == "string":
        text = value.encode() + b"\0"
        _write_numbers(to, "I", [len(text)])
        to += text
    elif is_array:
        if not length:
            _write_numbers(to, "I", [len(value)])
        if item in NUMBERS:
            _write_numbers(to, NUMBERS[item], value)
        else:
            for each in value:
                _write(to, item, each)
    elif kind in NUMBERS:
        _write_numbers(to, NUMBERS[kind], [value])
    else:
        for name, field in FIELDS[kind].items():
            _write(to, field, value[name])


def _write_numbers(to: bytearray, form: str, values: Any) -> None:
    """Write numbers, which begin at a multiple of their size, counted from the end of `LITTLE_ENDIAN`."""
    if len(values):
        to += bytes((len(LITTLE_ENDIAN) - len(to)) % struct.calcsize(form))
        to += struct.pack(f"<{len(values)}{form}", *values)


def topics(recording: Recording) -> Iterator[Topic]:
    """Yield the topics that viewers draw, as far as the signals are there, and one for every signal."""
    for name, kind, message, metadata in _topics(recording):

        def encoded(tick: int, stamp: int, message: Message = message, kind: str = kind) -> bytes | None:
            found = message(tick, {"sec": stamp // 10**9, "nanosec": stamp % 10**9})
            return None if found is None else encode(kind, found)

        yield Topic(name, kind.replace("/", "/msg/"), define(kind).encode(), encoded, metadata)


def _topics(recording: Recording) -> Iterator[tuple[str, str, Message, dict[str, str]]]:
    robot, log = recording.robot, recording.signals
    urdf = {"data": robot.urdf_text}
    yield "/robot_description", "std_msgs/String", lambda tick, _: urdf if tick == 0 else None, {}

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

    yield "/tf", "tf2_msgs/TFMessage", transforms, {}

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

        yield "/odom", "nav_msgs/Odometry", odometry, {}

    desired = setpoints(recording)

    def setpoint(tick: int, stamp: dict[str, int]) -> Any:
        return {"header": _header(stamp), "pose": _pose(*(part[tick] for part in desired))}

    yield "/setpoint", "geometry_msgs/PoseStamped", setpoint, {}

    if {"joint_velocity", "joint_torque"} <= log.keys():
        signals = {"position": "joint_position", "velocity": "joint_velocity", "effort": "joint_torque"}

        def joints(tick: int, stamp: dict[str, int]) -> Any:
            numbers = {field: log[name][tick] for field, name in signals.items()}
            return {"header": _header(stamp), "name": robot.joint_names, **numbers}

        yield "/joint_states", "sensor_msgs/JointState", joints, {}

    def wrench(rows: Any) -> Message:
        return lambda tick, stamp: {
            "header": _header(stamp),
            "wrench": {"force": named("xyz", rows[tick, :3]), "torque": named("xyz", rows[tick, 3:])},
        }

    for name, rows in wrenches(recording).items():
        yield f"/wrench/{name}", "geometry_msgs/WrenchStamped", wrench(rows), {}

    for name, signal in rust.signals().items():
        if name in log:
            yield (
                f"/signals/{name}",
                "std_msgs/Float64MultiArray",
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
