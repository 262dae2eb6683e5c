"""A flight as messages of ROS 2, read back by `rosbags`."""

from __future__ import annotations

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.view import export, recording, ros2
from jax_aero.view.topics import wxyz_from_rotation

pytest.importorskip("mcap", reason="mcap is not installed: make setup")
rosbags = pytest.importorskip("rosbags.highlevel", reason="rosbags is not installed: make setup")


def test_numbers_begin_at_multiples_of_their_size():
    """Counted from the end of the four bytes of the encapsulation; a text ends with a zero, which its length counts."""
    stamp = {"sec": -2, "nanosec": 7}
    joints = {"name": ["a"], "position": [1.0], "velocity": [], "effort": [-0.5]}
    message = {"header": {"stamp": stamp, "frame_id": "ab"}, **joints}
    expected = [
        "00 01 00 00",
        "fe ff ff ff 07 00 00 00",
        "03 00 00 00 61 62 00 00",  # and to the next multiple of 4
        "01 00 00 00 02 00 00 00 61 00 00 00",
        "01 00 00 00 00 00 00 00 00 00 f0 3f",  # 32 bytes: no gap before the number
        "00 00 00 00",
        "01 00 00 00 00 00 00 00 00 00 e0 bf",
    ]
    assert ros2.encode("sensor_msgs/msg/JointState", message) == bytes.fromhex("".join(expected))
    time = {"layout": {"dim": [], "data_offset": 0}, "data": [1.0]}  # 4 + 4 + 4 bytes, then a gap of 4
    content = ros2.encode("std_msgs/msg/Float64MultiArray", time)[4:]
    assert content == bytes(8) + b"\1\0\0\0" + bytes(4) + np.array([1.0], "<f8").tobytes()


@pytest.fixture(scope="module")
def flight():
    """With sensors, joints that are not measured for a while, and feet."""
    outage = {"channel": "joints", "kind": "missing", "start": 0.02, "duration": 0.02}
    changes = {"simulator.duration": 0.1, "disturbances.outages": [outage]}
    config = rust.load_config("test2_sensors", changes)
    return recording.from_flight(rust.fly(config), config, "short")


@pytest.fixture(scope="module")
def bag(flight, tmp_path_factory):
    """Folder with the file and its metadata."""
    folder = tmp_path_factory.mktemp("bag")
    export.write_mcap(flight, folder / "flight.mcap", profile="ros2")
    assert {path.name for path in folder.iterdir()} == {"flight.mcap", "metadata.yaml"}
    return folder


@pytest.fixture(scope="module")
def read(bag):
    """Messages by topic, with their stamps; encoded anew they have the same bytes."""
    found = {}
    with rosbags.AnyReader([bag]) as reader:
        for connection, stamp, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            again = reader.typestore.serialize_cdr(message, connection.msgtype)
            assert bytes(again) == bytes(content), connection.topic
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


def vector(part, names="xyz"):
    return np.array([getattr(part, name) for name in names])


def test_types_are_those_of_ros(bag):
    """Their hashes, by which ROS 2 compares types, are those of ROS 2 Humble."""
    from rosbags.typesys import Stores, get_typestore

    humble = get_typestore(Stores.ROS2_HUMBLE)
    with rosbags.AnyReader([bag]) as reader:
        kinds = {connection.msgtype for connection in reader.connections}
        for kind in kinds:
            assert reader.typestore.hash_rihs01(kind) == humble.hash_rihs01(kind), kind
    assert len(kinds) == 7


def test_a_bag_has_the_flight(read, flight):
    log, robot, k = flight.signals, flight.robot, 7
    stamp = 70_000_000
    assert [message.data for _, message in read["/robot_description"]] == [robot.urdf_text]
    once = ("/robot_description", "/tf_static")
    assert all(len(messages) == (log["time"].size, 1)[topic in once] for topic, messages in read.items())

    at, odometry = read["/odom"][k]
    assert (at, odometry.header.stamp.sec, odometry.header.stamp.nanosec) == (stamp, 0, stamp)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("world", robot.body_names[0])
    pose, twist = odometry.pose.pose, odometry.twist.twist
    np.testing.assert_array_equal(vector(pose.position), log["base_position"][k])
    np.testing.assert_array_equal(vector(pose.orientation, "wxyz"), log["base_quaternion"][k])
    i_from_b = rust.rotation_from_wxyz(log["base_quaternion"][k])
    velocity = np.concatenate([i_from_b @ vector(twist.linear), i_from_b @ vector(twist.angular)])
    np.testing.assert_allclose(velocity, log["base_velocity"][k], rtol=1e-13, atol=1e-15)

    frames = read["/tf"][k][1].transforms
    assert [frame.child_frame_id for frame in frames] == list(robot.body_names)
    now = flight.at(log["time"][k])
    for frame, position, rotation in zip(frames, now.body_positions, now.body_rotations, strict=True):
        np.testing.assert_array_equal(vector(frame.transform.translation), position)
        np.testing.assert_array_equal(vector(frame.transform.rotation, "wxyz"), wxyz_from_rotation(rotation))

    fixed = {frame.child_frame_id: frame for frame in read["/tf_static"][0][1].transforms}
    assert fixed.keys() == robot.links().keys() - {*robot.body_names}
    for name, frame in fixed.items():
        body, (_, position) = robot.links()[name]
        assert frame.header.frame_id == robot.body_names[body]
        np.testing.assert_array_equal(vector(frame.transform.translation), position)

    joints = read["/joint_states"][k][1]
    assert joints.name == list(robot.joint_names)
    for field, signal in (("position", "joint_position"), ("velocity", "joint_velocity"), ("effort", "joint_torque")):
        np.testing.assert_array_equal(getattr(joints, field), log[signal][k])
    wrench = read["/wrench/unmodelled"][k][1].wrench
    np.testing.assert_array_equal([*vector(wrench.force), *vector(wrench.torque)], log["unmodelled_wrench"][k])
    np.testing.assert_array_equal(vector(read["/setpoint"][k][1].pose.position), log["com_setpoint"][k])


def test_a_viewer_that_starts_later_gets_what_is_sent_once(bag):
    with rosbags.AnyReader([bag]) as reader:
        lasting = {
            connection.topic: [profile.durability.name for profile in connection.ext.offered_qos_profiles]
            for connection in reader.connections
        }
    assert {topic for topic, durability in lasting.items() if durability == ["TRANSIENT_LOCAL"]} == {
        "/robot_description",
        "/tf_static",
    }


def test_a_bag_has_every_bit_of_every_signal(read, flight):
    assert np.isnan(flight.signals["raw_joint_position"]).any()
    for name, rows in flight.signals.items():
        messages = [message for _, message in read[f"/signals/{name}"]]
        data = np.array([message.data for message in messages])
        assert data.tobytes() == np.ascontiguousarray(flight.rows(name), dtype=float).tobytes(), name
        dims = messages[0].layout.dim
        assert tuple(dim.size for dim in dims) == rows.shape[1:]
        assert [dim.label for dim in dims] == list(rust.signals()[name].dims[1:])
        assert [dim.stride for dim in dims] == [int(np.prod(rows.shape[i:])) for i in range(1, rows.ndim)]


def test_a_topic_names_unit_and_entries(bag):
    from mcap.reader import make_reader

    with (bag / "flight.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    (topic,) = (channel for channel in summary.channels.values() if channel.topic == "/signals/aero_force_sim")
    assert topic.metadata["unit"] == rust.signals()["aero_force_sim"].unit
    assert topic.metadata["entries"].split(",")[:4] == ["head/x", "head/y", "head/z", "chest/x"]
