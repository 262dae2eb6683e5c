"""A flight for other viewers: MCAP for Foxglove, PlotJuggler and Rerun, CSV for PlotJuggler.

An MCAP file has a topic `/signals/NAME` for every signal, with names for its entries and its unit in the schema, and
these in schemas that viewers draw:

    /tf                  foxglove.FrameTransforms   poses of all bodies, under the names of their URDF links
    /base, /setpoint     foxglove.PoseInFrame       pose of the base; its set-point, at that of the centre of mass
    /joint_states        foxglove.JointStates       position, velocity, commanded torque
    /wrench/...          geometry_msgs/WrenchStamped unmodelled wrench at the centre of mass; wrenches on the feet
    /robot_description   std_msgs/String            the URDF

Messages are JSON, which holds every bit of a number; null stands for NaN. The metadata `flight` hold title, outcome,
engine and configuration.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from jax_aero import rust
from jax_aero.files import complete_file
from jax_aero.io import make_portable
from jax_aero.result import Progress
from jax_aero.view import check_out, require
from jax_aero.view.recording import Recording, axes_of

WORLD = "world"
"""Name of the inertial frame."""

encode = msgspec.json.Encoder().encode
"""Function from a document to its JSON: every bit of a number, and null for NaN."""

METADATA = "flight"
"""Name of the metadata record of an MCAP file."""


def entries_of(signal: str, robot: rust.Robot) -> list[tuple[str, ...]]:
    """Return the names of the entries of a signal's row, one for each of its dimensions; empty names for a scalar.

    >>> entries_of("wind", rust.Robot("configs/robot/sparrow.toml"))
    [('x',), ('y',), ('z',)]
    """
    return list(itertools.product(*axes_of(signal, robot)))


def column_name(signal: str, entry: Sequence[str]) -> str:
    """Return the name of a scalar in a table: `aero_force_sim/head/x`; PlotJuggler makes a tree of it."""
    return "/".join([signal, *entry])


def write_csv(recording: Recording, out: Path) -> None:
    """Write a table with a header, a row for each tick, and `time` as the first column; missing numbers are empty.

    Raises
    ------
    Refused
        If `out` is not a `.csv` file in an existing folder.
    """
    check_out(out, ".csv")
    columns, names = [], []
    for signal in recording.signals:
        rows = recording.rows(signal)
        names += [column_name(signal, entry) for entry in entries_of(signal, recording.robot)]
        columns.append(rows)
    table = np.concatenate(columns, axis=1)
    with complete_file(out) as draft, draft.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for row in table.tolist():
            file.write(",".join("" if number != number else repr(number) for number in row) + "\n")


def write_mcap(recording: Recording, out: Path, progress: Progress | None = None) -> None:
    """Write an MCAP file, as the head of this module describes it.

    Raises
    ------
    Refused
        If `out` is not an `.mcap` file in an existing folder, or if the package `mcap` is not installed.
    """
    check_out(out, ".mcap")
    require(["mcap"], "writing an MCAP file", "logs")
    from mcap.writer import Writer

    times = recording.signals["time"]
    stamps = np.rint(times * 1e9).astype(np.int64).tolist()
    topics = [*_viewer_topics(recording), *_signal_topics(recording)]
    with complete_file(out) as draft, draft.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("", f"jax-aero {rust.__version__}")
        channels = []
        for topic, name, properties, message in topics:
            schema = writer.register_schema(name, "jsonschema", encode(_object(properties, title=name)))
            channels.append((writer.register_channel(topic, "json", schema), message))
        writer.add_metadata(METADATA, _facts(recording))
        for tick, stamp in enumerate(stamps):
            for channel, message in channels:
                found = message(tick, {"sec": stamp // 10**9, "nsec": stamp % 10**9})
                if found is not None:
                    writer.add_message(channel, stamp, encode(found), stamp)
            if progress is not None:
                progress(tick + 1, len(stamps))
        writer.finish()


def _facts(recording: Recording) -> dict[str, str]:
    facts = {"title": recording.title, "outcome": recording.verdict}
    if recording.config is not None:
        facts["config"] = encode(make_portable(recording.config)).decode()
    return facts


Message = Callable[[int, dict[str, int]], Any]
"""Function from the number of a tick and its time stamp to the message; `None` for no message."""
Topic = tuple[str, str, dict[str, Any], Message]
"""Topic, name of its schema, properties of a message, and its messages."""

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


def _viewer_topics(recording: Recording) -> Iterator[Topic]:
    """Yield the topics that viewers draw, as far as the signals are there."""
    robot, log = recording.robot, recording.signals
    urdf = {"data": robot.urdf_text}
    yield "/robot_description", "std_msgs/String", {"data": TEXT}, lambda tick, _: urdf if tick == 0 else None

    instants = [recording.at(time) for time in log["time"]]
    positions = np.array([now.body_positions for now in instants]).tolist()
    rotations = wxyz_from_rotation([now.body_rotations for now in instants]).tolist()

    def transforms(tick: int, stamp: dict[str, int]) -> Any:
        frames = [
            {
                "timestamp": stamp,
                "parent_frame_id": WORLD,
                "child_frame_id": name,
                "translation": _named("xyz", position),
                "rotation": _xyzw(wxyz),
            }
            for name, position, wxyz in zip(robot.body_names, positions[tick], rotations[tick], strict=True)
        ]
        return {"transforms": frames}

    yield "/tf", "foxglove.FrameTransforms", {"transforms": _list(TRANSFORM)}, transforms

    def pose(position: Any, wxyz: Any) -> Message:
        return lambda tick, stamp: {
            "timestamp": stamp,
            "frame_id": WORLD,
            "pose": {"position": _named("xyz", position[tick]), "orientation": _xyzw(wxyz[tick])},
        }

    yield "/base", "foxglove.PoseInFrame", POSE, pose(log["base_position"], log["base_quaternion"])
    desired = np.array([wxyz_from_rpy(*rpy) for rpy in log["base_rpy_setpoint"]])
    yield "/setpoint", "foxglove.PoseInFrame", POSE, pose(log["com_setpoint"], desired)

    if {"joint_velocity", "joint_torque"} <= log.keys():
        parts = [log[name].tolist() for name in ("joint_position", "joint_velocity", "joint_torque")]

        def joints(tick: int, stamp: dict[str, int]) -> Any:
            rows = zip(robot.joint_names, *(part[tick] for part in parts), strict=True)
            return {"timestamp": stamp, "joints": [dict(zip(JOINT, row, strict=True)) for row in rows]}

        yield "/joint_states", "foxglove.JointStates", {"timestamp": STAMP, "joints": _list(JOINT)}, joints

    def wrench(rows: Any) -> Message:
        return lambda tick, stamp: {
            "header": {"stamp": stamp, "frame_id": WORLD},
            "wrench": {"force": _named("xyz", rows[tick, :3]), "torque": _named("xyz", rows[tick, 3:])},
        }

    wrenches = {"unmodelled": log.get("unmodelled_wrench")}
    if "foot_wrench" in log:
        wrenches |= {foot: log["foot_wrench"][:, index] for index, foot in enumerate(robot.foot_names)}
    for name, rows in wrenches.items():
        if rows is not None:
            yield f"/wrench/{name}", "geometry_msgs/WrenchStamped", WRENCH, wrench(rows)


def _signal_topics(recording: Recording) -> Iterator[Topic]:
    """Yield a topic for every signal."""
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


def _named(names: str, numbers: Any) -> dict[str, Any]:
    return dict(zip(names, map(float, numbers), strict=True))


def _xyzw(wxyz: Any) -> dict[str, Any]:
    return _named("xyzw", (*wxyz[1:], wxyz[0]))


def wxyz_from_rpy(roll: float, pitch: float, yaw: float) -> Any:
    """Return the quaternion (4,) of Rz(yaw) Ry(pitch) Rx(roll), with w ≥ 0."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle / 2), np.sin(angle / 2)) for angle in (roll, pitch, yaw))
    along_zy = np.array([cy * cp, -sy * sp, cy * sp, sy * cp])  # Rz Ry
    w, x, y, z = along_zy
    wxyz = np.array([w * cr - x * sr, x * cr + w * sr, y * cr + z * sr, z * cr - y * sr])
    return wxyz if wxyz[0] >= 0.0 else -wxyz


def wxyz_from_rotation(rotations: Any) -> Any:
    """Return the quaternions (..., 4) of rotation matrices (..., 3, 3), with w ≥ 0."""
    r = np.asarray(rotations)
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(r, (-2, -1), (0, 1))
    # 4 q qᵀ for q = (w, x, y, z); its column with the greatest entry on the diagonal, divided by the root of that.
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    greatest = np.argmax(np.einsum("ii...->i...", products), axis=0)
    columns = np.take_along_axis(products, greatest[None, None], axis=1)[:, 0]
    wxyz = np.moveaxis(columns / np.linalg.norm(columns, axis=0), 0, -1)
    return np.where(wxyz[..., :1] < 0.0, -wxyz, wxyz)
