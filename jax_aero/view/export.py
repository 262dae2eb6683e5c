"""A flight for other viewers: MCAP for Foxglove, PlotJuggler, Rerun and ROS 2, CSV for PlotJuggler.

An MCAP file has a topic `/signals/NAME` for every signal, and these, which viewers draw, in JSON (profile `json`) or as
messages of ROS 2 (profile `ros2`):

    /tf, /tf_static      foxglove.FrameTransforms or tf2_msgs/TFMessage    poses of all bodies, and of other links in
                                                                          theirs; names are those of the URDF
    /base, /setpoint     foxglove.PoseInFrame                             pose of the base; its set-point, at that of
                                                                          the centre of mass
    /odom, /setpoint     nav_msgs/Odometry, geometry_msgs/PoseStamped     the same in ROS 2, with the base's velocity
    /joint_states        foxglove.JointStates or sensor_msgs/JointState   position, velocity, commanded torque
    /wrench/...          geometry_msgs/WrenchStamped                      unmodelled wrench at the centre of mass;
                                                                          wrenches on the feet
    /robot_description   std_msgs/String                                  the URDF

The metadata `flight` hold title, outcome, engine and configuration.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.files import complete_file, write_text
from jax_aero.base.terminal import Progress
from jax_aero.base.typed_config import make_portable
from jax_aero.view import Refused, check_out, foxglove, require, ros2
from jax_aero.view.recording import Recording, entries_of
from jax_aero.view.topics import Topic

METADATA = "flight"
"""Name of the metadata record of an MCAP file, and of the text of a MATLAB file."""


class Profile(NamedTuple):
    """Encoding of an MCAP file.

    Attributes
    ----------
    name
        Profile that the file states.
    schemas, messages
        Encodings of schemas and messages.
    topics
        Function from a flight to its topics.
    """

    name: str
    schemas: str
    messages: str
    topics: Callable[[Recording], Iterator[Topic]]


PROFILES = {
    "json": Profile("", "jsonschema", "json", foxglove.topics),
    "ros2": Profile("ros2", "ros2msg", "cdr", ros2.topics),
}


def column_name(signal: str, entry: Sequence[str]) -> str:
    """Return the name of a scalar in a table: `aero_force_sim/head/x`; PlotJuggler makes a tree of it."""
    return "/".join([signal, *entry])


def write_csv(recording: Recording, out: Path, signals: Sequence[str] = ()) -> None:
    """Write a table with a header, a row for each tick, and `time` as the first column; missing numbers are empty.

    It has these signals, or all.

    Raises
    ------
    Refused
        If `out` is not a `.csv` file in an existing folder, or there is no such signal.
    """
    check_out(out, ".csv")
    if unknown := [name for name in signals if name not in recording.signals]:
        raise Refused(f"there is no signal `{unknown[0]}`{places.did_you_mean(unknown[0], recording.signals)}")
    columns, names = [], []
    for signal in dict.fromkeys(["time", *signals]) if signals else recording.signals:
        rows = recording.rows(signal)
        names += [column_name(signal, entry) for entry in entries_of(signal, recording.robot)]
        columns.append(rows)
    table = np.concatenate(columns, axis=1)
    with complete_file(out) as draft, draft.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for row in table.tolist():
            file.write(",".join("" if number != number else repr(number) for number in row) + "\n")


def write_mcap(recording: Recording, out: Path, progress: Progress | None = None, profile: str = "json") -> None:
    """Write an MCAP file of a profile, as the head of this module describes it; for ROS 2 its bag's metadata beside it.

    Raises
    ------
    Refused
        If `out` is not an `.mcap` file in an existing folder, or if `mcap` or `rosbags` is not installed.
    """
    check_out(out, ".mcap")
    require(["mcap", "rosbags"], "writing an MCAP file", "logs")
    from mcap.writer import Writer

    stamps = np.rint(recording.signals["time"] * 1e9).astype(np.int64).tolist()
    form = PROFILES[profile]
    with complete_file(out) as draft, draft.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(form.name, f"jax-aero {rust.__version__}")
        channels = []
        counts: Counter[str] = Counter()
        for topic in form.topics(recording):
            schema = writer.register_schema(topic.schema, form.schemas, topic.definition)
            channel = writer.register_channel(topic.name, form.messages, schema, dict(topic.metadata))
            channels.append((channel, topic))
        writer.add_metadata(METADATA, facts_of(recording))
        for tick, stamp in enumerate(stamps):
            for channel, topic in channels:
                encoded = topic.message(tick, stamp)
                if encoded is not None:
                    writer.add_message(channel, stamp, encoded, stamp)
                    counts[topic.name] += 1
            if progress is not None:
                progress(tick + 1, len(stamps))
        writer.finish()
    if profile == "ros2":
        written = [(topic, counts[topic.name]) for _, topic in channels if counts[topic.name]]
        write_text(out.with_name(ros2.BAG), ros2.describe_bag(out.name, written, stamps[-1]))


def facts_of(recording: Recording) -> dict[str, str]:
    """Return title, outcome and configuration of a flight as texts."""
    facts = {"title": recording.title, "outcome": recording.verdict}
    if recording.config is not None:
        facts["config"] = msgspec.json.encode(make_portable(recording.config)).decode()
    return facts
