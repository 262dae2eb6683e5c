"""Logs are written for other viewers and read back, and replay through the tick."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from jax_aero import __main__ as commands
from jax_aero import rust
from jax_aero.base import places, sizes
from jax_aero.base.result import labels_of
from jax_aero.body.spatial import rpy_from_rotation, wxyz_from_rotation
from jax_aero.commands.replay import compare
from jax_aero.replay import refused
from jax_aero.results import manifest, record
from jax_aero.view import export, logs, matlab, measured, recording
from jax_aero.view.columns import read_mcap

mcap_reader = pytest.importorskip("mcap.reader", reason="mcap is not installed: make setup")


@pytest.fixture(scope="module")
def config():
    """With sensors, an estimator, and joints that are not measured for a while."""
    outage = {"channel": "joints", "kind": "missing", "start": 0.1, "duration": 0.05}
    return rust.load_config("test2_sensors", {"simulator.duration": 0.3, "disturbances.outages": [outage]})


@pytest.fixture(scope="module")
def flight(config):
    return rust.fly(config)


@pytest.fixture(scope="module")
def result(flight, config, tmp_path_factory):
    robot = rust.Robot(config["robot"])
    dataset = record.to_dataset(flight, robot, title="short", config_digest=rust.config_digest(config))
    folder = tmp_path_factory.mktemp("results") / "short"
    record.write_run(folder, dataset, {"title": "short", "config": manifest.make_portable(config)})
    return folder


def bits(rows):
    return np.ascontiguousarray(rows).tobytes()


def run(capsys, *words):
    status = commands.main([str(word) for word in words])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_a_file_has_exact_measurements_once(config, tmp_path):
    """Only the rotation, which the signal without `raw_` holds as a quaternion; with sensors all but the exact wind."""
    exact = rust.load_config("test2", {"simulator.duration": 0.1})
    for flown, expected in ((exact, 1), (config, 6)):
        flight, robot = rust.fly(flown), rust.Robot(flown["robot"])
        dataset = record.to_dataset(flight, robot, title="", config_digest="")
        assert sum(str(name).startswith("raw_") for name in dataset) == expected
        record.write_run(tmp_path / str(expected), dataset, {"config": manifest.make_portable(flown)})
        read = recording.read(tmp_path / str(expected)).signals
        assert all(bits(rows) == bits(flight.log[name]) for name, rows in read.items())
        assert read.keys() == flight.log.keys()
        assert next(iter(read)) == "time"


@pytest.mark.parametrize("form", ["nc", "mcap", "mat", "csv"])
def test_a_log_of_ours_replays_from_every_format(form, result, tmp_path, capsys):
    path, words = result, ()
    if form != "nc":
        path = tmp_path / f"log.{form}"
        assert run(capsys, "export", result, f"--{form}", "--out", path)[0] == 0
    if form == "csv":  # which holds no configuration; only the controller of this one is used
        words = ("--experiment", "test2_sensors")
    status, out, _ = run(capsys, "replay", path, *words)
    assert (status, out.splitlines()[-1]) == (0, "equal to the last bit: 23 of 23 signals")


def test_what_a_robot_measured_is_viewed_and_written_for_viewers(result, flight, tmp_path, capsys):
    """Of a log with nothing but what a tick was given."""
    whole, own = tmp_path / "whole.csv", tmp_path / "own.csv"
    assert run(capsys, "export", result, "--csv", "--out", whole)[0] == 0
    rows = pd.read_csv(whole)
    rows[[name for name in rows if name == "time" or name.startswith("raw_")]].to_csv(own, index=False)
    seen = measured.read_flight(own, rust.load_config("test2_sensors"), None, None)
    known = np.isfinite(flight.log["raw_joint_position"]).all(axis=1)
    assert 0 < known.sum() < known.size
    np.testing.assert_array_equal(seen.signals["joint_position"][known], flight.log["raw_joint_position"][known])
    assert all(np.isfinite(seen.signals[name]).all() for name in recording.SIGNALS)
    np.testing.assert_allclose(seen.signals["com_position"], flight.log["com_position"], atol=0.05)
    words = ("export", own, "--mcap", "--out", tmp_path / "own.mcap")
    assert [run(capsys, *words, *more)[0] for more in ((), ("--experiment", "test2_sensors"))] == [2, 0]
    assert "/signals/base_position/x" in read_mcap(tmp_path / "own.mcap", is_ours=True)[0]


def test_another_controller_differs_and_is_drawn(result, tmp_path, capsys):
    plot = tmp_path / "apart.png"
    kept = tmp_path / "kept.csv"
    status, out, _ = run(capsys, "replay", result, "--controller", "baseline", "--plot", plot, "--out", kept)
    assert status == 1
    assert "joint_torque" in out
    assert plot.stat().st_size > 1000
    header, *rows = kept.read_text().splitlines()
    assert header.startswith("time,")
    assert {"joint_torque/l_elbow", "thrust_rate/l_arm_jet"} <= {*header.split(",")}
    assert out.startswith(f"{len(rows)} ticks")
    status, _, err = run(capsys, "replay", result, "--plot", plot)
    assert (status, "is there already" in err) == (2, True)


def test_a_folder_of_an_experiment_flies_alone(tmp_path, capsys):
    out, changes = tmp_path / "own", {"simulator.duration": 0.1}
    assert run(capsys, "export", "test4", "--config", "--out", out)[0] == 0
    configs = [rust.load_config(name, changes) for name in ("test4", out / "experiments/test4.toml")]
    assert Path(configs[1]["robot"]).is_relative_to(out)
    first, second = (bits(rust.fly(config)["joint_torque"]) for config in configs)
    assert first == second
    assert run(capsys, "export", places.CONFIGS / "onboard/robot.toml", "--config", "--out", tmp_path / "board")[0] == 0
    assert (
        rust.load_onboard(tmp_path / "board/onboard/robot.toml")["controller"]
        == rust.load_onboard("robot")["controller"]
    )
    far = tmp_path / "far.toml"
    far.write_text(f'base = "{places.CONFIGS}/experiments/test2.toml"\n')
    status, _, err = run(capsys, "export", far, "--config", "--out", tmp_path / "no")
    assert (status, "by an absolute path" in err, (tmp_path / "no").exists()) == (2, True, False)


LIBRARY = next((places.HOME / "target").glob("*/deps/libflight.so"), None)


@pytest.mark.skipif(LIBRARY is None or shutil.which("cc") is None, reason="libflight is not built: make test")
def test_a_program_in_c_flies_the_same_from_a_folder(tmp_path, capsys):
    """Its robot, its network and its controller: all that `loop` prints but times."""
    out, program, source = tmp_path / "own", tmp_path / "loop", places.HOME / "rust" / "capi"
    assert run(capsys, "export", "robot", "--config", "--out", out)[0] == 0
    library = ["-L", LIBRARY.parent, "-lflight", f"-Wl,-rpath,{LIBRARY.parent}"]
    subprocess.run(["cc", "-I", source / "include", source / "examples/loop.c", *library, "-o", program], check=True)
    flown = []
    for folder in (places.CONFIGS, out):
        said = subprocess.check_output([program, folder / "experiments/robot.toml", "20"], text=True).splitlines()
        flown.append([line for line in said if line[:4] not in ("loop", "tick", "late")])
    assert flown[0] == flown[1]
    assert flown[0][1] == "not nominal      0 of 20"


def test_differences_are_those_of_the_signals():
    recorded = {"time": np.zeros(2), "thrust_rate": np.array([[1.0, np.nan], [2.0, 4.0]]), "qp_kkt": np.zeros((2, 2))}
    computed = {"time": np.array([0.0, 0.01]), "thrust_rate": np.array([[1.0, np.nan], [2.5, 4.0]])}
    (found,) = compare(recorded, computed)
    assert found == ("thrust_rate", 0.5, 0.01, 4.0)
    computed["thrust_rate"][1, 1] = np.nan
    assert np.isnan(compare(recorded, computed)[0].greatest)
    turned = np.array([[1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]])
    times, name = {"time": np.array([0.0, 0.01])}, "measured_base_quaternion"
    (same,) = compare(times | {name: turned}, times | {name: turned * [[1.0], [-1.0]]})
    assert same.greatest == 0.0  # both signs are one rotation


def test_a_robot_that_is_elsewhere_is_given(config, result, tmp_path, capsys):
    """The manifest of a result names no folder outside of the project."""
    facts = json.loads((result / recording.MANIFEST_FILE).read_text())
    facts["config"]["robot"] = "(outside the repository)/robot.toml"
    (tmp_path / recording.MANIFEST_FILE).write_text(json.dumps(facts))
    (tmp_path / "run.nc").write_bytes((result / "run.nc").read_bytes())
    status, _, err = run(capsys, "replay", tmp_path)
    assert (status, "give it with --robot FILE" in err) == (2, True)
    status, out, _ = run(capsys, "replay", tmp_path, "--robot", config["robot"])
    assert (status, out.splitlines()[-1]) == (0, "equal to the last bit: 23 of 23 signals")


@pytest.fixture(scope="module")
def written(result, tmp_path_factory):
    """Messages and schemas of the flight's MCAP file, by topic."""
    path = tmp_path_factory.mktemp("mcap") / "flight.mcap"
    export.write_mcap(recording.read(result), path)
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in mcap_reader.make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            entry = found.setdefault(channel.topic, (schema.name, json.loads(schema.data), []))
            entry[2].append((message.log_time, json.loads(message.data)))
    return found


def test_an_mcap_file_has_what_viewers_draw(written, flight, config):
    robot, log, k = rust.Robot(config["robot"]), flight.log, 20
    assert {topic: written[topic][0] for topic in written if not topic.startswith("/signals/")} == {
        "/robot_description": "std_msgs/String",
        "/tf": "foxglove.FrameTransforms",
        "/tf_static": "foxglove.FrameTransforms",
        "/base": "foxglove.PoseInFrame",
        "/setpoint": "foxglove.PoseInFrame",
        "/joint_states": "foxglove.JointStates",
        "/wrench/unmodelled": "geometry_msgs/WrenchStamped",
    }
    assert [message["data"] for _, message in written["/robot_description"][2]] == [robot.urdf_text]
    stamp, frames = written["/tf"][2][k]
    assert stamp == 200_000_000
    rotation = rust.rotation_from_wxyz(log["base_quaternion"][k])
    state = rust.State(log["base_position"][k], rotation, log["joint_position"][k], np.zeros(29))
    pose = rust.dynamics(robot, state)
    assert [frame["child_frame_id"] for frame in frames["transforms"]] == list(robot.body_names)
    for frame, position, rotation in zip(frames["transforms"], pose.body_positions, pose.body_rotations, strict=True):
        assert (frame["parent_frame_id"], frame["timestamp"]) == ("world", {"sec": 0, "nsec": stamp})
        assert list(frame["translation"].values()) == list(position)
        turn = rust.rotation_from_wxyz([frame["rotation"][letter] for letter in "wxyz"])
        np.testing.assert_allclose(turn, rotation, atol=1e-14)
    ((stamp, fixed),) = written["/tf_static"][2]
    assert (stamp, {*robot.links()}) == (
        0,
        {frame["child_frame_id"] for frame in (*frames["transforms"], *fixed["transforms"])},
    )
    for frame in fixed["transforms"]:
        body, (rotation, position) = robot.links()[frame["child_frame_id"]]
        assert frame["parent_frame_id"] == robot.body_names[body]
        assert list(frame["translation"].values()) == list(position)
        turn = rust.rotation_from_wxyz([frame["rotation"][letter] for letter in "wxyz"])
        np.testing.assert_allclose(turn, rotation, atol=1e-14)
    joints = written["/joint_states"][2][k][1]["joints"]
    assert [joint["name"] for joint in joints] == list(robot.joint_names)
    for name, signal in (("position", "joint_position"), ("velocity", "joint_velocity"), ("effort", "joint_torque")):
        assert [joint[name] for joint in joints] == list(log[signal][k])
    desired = written["/setpoint"][2][k][1]["pose"]["orientation"]
    found = rpy_from_rotation(rust.rotation_from_wxyz([desired[i] for i in "wxyz"]))
    assert np.allclose(found, log["base_rpy_setpoint"][k], atol=1e-14)


def test_an_mcap_file_has_every_bit_of_every_signal_with_its_unit(written, flight):
    for name, rows in flight.log.items():
        schema, about, messages = written[f"/signals/{name}"]
        assert schema == f"jax_aero.{name}"
        assert f"[{rust.signals()[name].unit}]" in json.dumps(about, ensure_ascii=False)
        found = [list(numbers(message)) for _, message in messages]
        assert bits(np.array(found, dtype=float)) == bits(np.reshape(rows, (len(rows), -1))), name
    assert {*flight.log} == {topic.removeprefix("/signals/") for topic in written if topic.startswith("/signals/")}
    assert written["/signals/aero_force_sim"][2][0][1]["head"].keys() == {"x", "y", "z"}
    assert written["/signals/raw_joint_position"][2][12][1]["torso_yaw"] is None


def numbers(message):
    for value in message.values():
        yield from numbers(value) if isinstance(value, dict) else [value]


@pytest.fixture(scope="module")
def logged(result, tmp_path_factory):
    """The flight as a log of the robot's own software."""
    path = tmp_path_factory.mktemp("matlab") / "flight.mat"
    matlab.write_mat(recording.read(result), path)
    return path


def test_a_matlab_file_is_read_by_the_rules_of_the_robots_visualizer(logged, flight, config):
    """Those of `robot-log-visualizer`, `matfile_signal_provider.py`: squeezed data, names behind references."""
    robot = rust.Robot(config["robot"])

    def texts(file, references):
        return ["".join(chr(letter[0]) for letter in file[reference]) for reference in references[0]]

    with h5py.File(logged) as file:
        root = file["robot_logger_device"]
        assert texts(file, root["description_list"]) == list(robot.joint_names)
        assert "".join(chr(letter[0]) for letter in root["yarp_robot_name"]) == robot.name
        for leaf, signal in {"joints_state/positions": "joint_position", "aero_force_sim": "aero_force_sim"}.items():
            data = np.squeeze(np.array(root[leaf]["data"]))
            assert bits(data) == bits(flight.log[signal].reshape(len(data), -1))
            assert bits(np.squeeze(np.array(root[leaf]["timestamps"]))) == bits(flight.log["time"])
        assert texts(root["aero_force_sim"], root["aero_force_sim"]["elements_names"])[:2] == ["head/x", "head/y"]
        assert texts(root["thrust"], root["thrust"]["units_of_measure"]) == ["N"] * 4


def test_a_matlab_file_of_ours_is_viewed_as_it_was_flown(logged, flight):
    seen = matlab.read_recording(logged, None)
    assert (seen.title, seen.verdict) == ("short", "completed")
    assert all(bits(rows) == bits(flight.log[name]) for name, rows in seen.signals.items())
    assert seen.signals.keys() == flight.log.keys()


def robot_log(path, data, names=("positions",)):
    """A log with the joints alone, stamped with the time of day."""
    with h5py.File(path, "w") as file:
        for name in names:
            leaf = file.create_group(f"robot_logger_device/joints_state/{name}")
            leaf["data"], leaf["timestamps"] = data, 1.7e9 + 0.01 * np.arange(3.0)[:, None]


def test_a_log_of_the_robot_has_its_joints_alone(logged, flight, config, tmp_path):
    """It is viewed where its base stays; without names of its elements it is refused."""
    path, robot = tmp_path / "log.mat", rust.Robot(config["robot"])
    with h5py.File(logged) as ours, h5py.File(path, "w") as theirs:
        ours.copy("#refs#", theirs, expand_refs=True)
        ours.copy("robot_logger_device/joints_state", theirs.create_group("robot_logger_device"), expand_refs=True)
        positions = theirs["robot_logger_device/joints_state/positions"]
        positions["elements_names"][...] = [
            [theirs["#refs#"][f"text{place}"].ref for place in range(len(robot.joint_names))]
        ]
    with pytest.raises(recording.Refused, match="does not name its robot"):
        matlab.read_recording(path, None)
    seen = matlab.read_recording(path, config["robot"])
    assert bits(seen.signals["joint_position"]) == bits(flight.log["joint_position"])
    assert not seen.signals["base_position"].any()
    robot_log(path, np.zeros((3, 1, len(robot.joint_names))))
    with pytest.raises(recording.Refused, match="has no column"):
        matlab.read_recording(path, config["robot"])


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda leaf: leaf.__delitem__("timestamps"), "has no data in `robot_logger_device`"),
        (lambda leaf: leaf.create_dataset("more", (1 << 40,), "i1", chunks=True), "bytes of numbers"),
        (lambda leaf: leaf.create_dataset("more", (4,), "u1", external=[("/etc/hostname", 0, 4)]), "in other files"),
        (lambda leaf: leaf.__setitem__("loop", leaf.parent), None),
    ],
)
def test_a_spoilt_matlab_file_is_refused(spoil, expected, tmp_path):
    robot_log(tmp_path / "log.mat", np.zeros((3, 1, 2)))
    with h5py.File(tmp_path / "log.mat", "a") as file:
        spoil(file["robot_logger_device/joints_state/positions"])
    if expected is None:  # a group that holds itself is read once
        assert list(matlab.read_mat(tmp_path / "log.mat")[0]) == [f"joints_state/positions/{place}" for place in "01"]
        return
    with pytest.raises(recording.Refused, match=expected):
        matlab.read_mat(tmp_path / "log.mat")


def test_a_csv_file_has_a_column_for_every_scalar(result, flight, tmp_path):
    export.write_csv(recording.read(result), tmp_path / "flight.csv")
    header, *rows = (tmp_path / "flight.csv").read_text().splitlines()
    names = header.split(",")
    assert names[0] == "time"
    assert len(names) == len({*names}) == sum(rows[0].size for rows in flight.log.values())
    assert {"thrust/l_arm_jet", "wind/y", "aero_force_sim/head/x", "raw_base_rotation/z/x"} <= {*names}
    cells = rows[12].split(",")
    assert cells[names.index("raw_joint_position/torso_yaw")] == ""
    assert float(cells[names.index("thrust/l_arm_jet")]) == flight["thrust"][12, 0]
    export.write_csv(recording.read(result), tmp_path / "few.csv", ["wind"])
    few = (tmp_path / "few.csv").read_text().splitlines()
    assert few[0] == "time,wind/x,wind/y,wind/z"
    assert few[13].split(",") == [cells[names.index(name)] for name in few[0].split(",")]
    with pytest.raises(recording.Refused, match="no signal `winds`"):
        export.write_csv(recording.read(result), tmp_path / "none.csv", ["winds"])


MAP = """
time = { columns = "stamp", scale = 1e-9 }
raw_base_position = { columns = ["px", "py", "pz"] }
raw_base_quaternion = { columns = ["qw", "qx", "qy", "qz"] }
raw_base_velocity = { columns = "v_{}" }
raw_joint_position = { columns = "q_{}", scale = 0.017453292519943295 }
raw_joint_velocity = { columns = "dq_{}" }
raw_thrust = { columns = "T_{}" }
raw_wind = { columns = ["wx", "wy", "wz"] }
joint_torque = { columns = "tau_{}" }
"""


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """A log of others at five times the rate of the ticks, from a flight of ours, with the mapping of its columns."""
    flown = rust.fly(rust.load_config("test2", {"simulator.duration": 0.2}))
    log, robot = flown.log, rust.Robot(rust.load_config("test2")["robot"])
    columns = {"stamp": 1e18 + np.arange(101) * 2e6}
    for letter, values in zip("xyz", log["raw_base_position"].T, strict=True):
        columns[f"p{letter}"] = values
    for letter, values in zip("wxyz", wxyz_from_rotation(log["raw_base_rotation"]).T, strict=True):
        columns[f"q{letter}"] = values
    for part, values in zip(labels_of(robot)["six"], log["raw_base_velocity"].T, strict=True):
        columns[f"v_{part}"] = values
    for j, joint in enumerate(robot.joint_names):
        columns |= {f"q_{joint}": np.degrees(log["raw_joint_position"][:, j])}
        columns |= {f"dq_{joint}": log["raw_joint_velocity"][:, j], f"tau_{joint}": log["joint_torque"][:, j]}
    columns |= {f"T_{jet}": log["raw_thrust"][:, j] for j, jet in enumerate(robot.jet_names)}
    columns |= {f"w{letter}": log["raw_wind"][:, j] for j, letter in enumerate("xyz")}
    rows = {name: values if name == "stamp" else np.repeat(values, 5)[:101] for name, values in columns.items()}
    folder = tmp_path_factory.mktemp("foreign")
    lines = [",".join(rows), *(",".join(map(repr, row)) for row in np.transpose(list(rows.values())).tolist())]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    (folder / "map.toml").write_text(MAP)
    return folder


@pytest.mark.parametrize(("steps", "rounding"), [(1, 1e-9), (5, np.inf)])
def test_a_faster_log_of_others_replays_at_the_ticks_and_at_those_of_the_torques(foreign, steps, rounding, capsys):
    """Rows every 2 ms: five in one tick of the law."""
    words = ("replay", foreign / "log.csv", "--experiment", "test2", "--map", foreign / "map.toml")
    status, out, err = run(capsys, *words, "--set", f"controller.torque.steps={steps}")
    assert status == 1, err
    assert out.startswith("21 ticks")
    assert differences(out)["joint_torque"] < rounding  # of degrees and quaternions


@pytest.mark.parametrize("command", ["replay", "identify", "export"])
def test_angles_in_degrees_are_refused_by_every_reader(command, foreign, tmp_path, capsys):
    (tmp_path / "map.toml").write_text(MAP.replace(", scale = 0.017453292519943295", ""))
    words = [command, foreign / "log.csv", "--experiment", "test2", "--map", tmp_path / "map.toml"]
    words += ["--csv", "--out", tmp_path / "out.csv"] if command == "export" else []
    status, _, err = run(capsys, *words)
    assert (status, "(deg?)" in err, "`raw_joint_position` of `" in err) == (2, True, True), err


def test_a_rotation_of_five_decimals_is_no_missing_one(tmp_path, capsys):
    """A hundredth of a milliradian moves torques by 1e-4 of their range; without attitude they are five times apart."""
    config = rust.load_config("test1", {"simulator.duration": 4.0})
    flown = rust.fly(config)
    export.write_csv(recording.from_flight(flown, config, "flown"), tmp_path / "log.csv")
    rows = pd.read_csv(tmp_path / "log.csv")
    rotation = [name for name in rows if name.startswith("raw_base_rotation/")]
    rows.assign(**rows[rotation].round(5)).to_csv(tmp_path / "log.csv", index=False)
    status, out, err = run(capsys, "replay", tmp_path / "log.csv", "--experiment", "test1")
    assert (status, err) == (1, "")
    assert 0.0 < differences(out)["joint_torque"] < 1e-3 * np.abs(flown.log["joint_torque"]).max()


def test_what_the_controller_refuses_is_counted(exact, tmp_path, capsys):
    """Three rows of a velocity that no robot reaches; what a flight's own modes say is known."""
    lines, _ = exact
    header, *rows = [line.split(",") for line in lines]
    for row in rows[20:23]:
        row[header.index("raw_base_velocity/linear_x")] = "1e4"
    without = header.index("degraded_modes")
    spoilt = [",".join([*row[:without], *row[without + 1 :]]) for row in (header, *rows)]
    (tmp_path / "log.csv").write_text("\n".join(spoilt))
    with pytest.warns(UserWarning, match=r"in their place in 3 of 51 ticks with numbers of `raw_base_velocity`"):
        assert run(capsys, "replay", tmp_path / "log.csv", "--experiment", "test2")[0] == 1
    velocity, modes = np.zeros((3, 6)), rust.MODES["velocity_predicted"] * np.array([1, 1, 0])
    velocity[1] = np.nan  # which is missing, not refused
    computed = {"degraded_modes": modes.astype(float)}
    assert refused({"raw_base_velocity": velocity}, computed) == {("raw_base_velocity",): 1}
    assert refused({"raw_base_velocity": velocity, **computed}, computed) == {}


def test_what_a_conversion_rounds_is_within_a_tolerance(foreign, capsys):
    """Degrees and quaternions: rounding, some 1e-16 of attitude, angles and rates, times the gains of the torques."""
    words = ("replay", foreign / "log.csv", "--experiment", "test2", "--map", foreign / "map.toml")
    for share, status in (("0", 1), ("1e-17", 1), ("1e-9", 0)):
        found, out, err = run(capsys, *words, "--tolerance", share)
        assert found == status, err
    assert out.splitlines()[-2:] == [
        "equal to the last bit: 0 of 1 signals",
        "within 1e-09 of their ranges: 1 of 1 signals",
    ]
    with pytest.raises(SystemExit):
        run(capsys, *words, "--tolerance", "-1")
    assert "expected a number from 0 to 1" in capsys.readouterr().err


@pytest.mark.parametrize(("error", "status"), [(0.9, 0), (1.1, 1), (np.nan, 1)])
def test_a_difference_beyond_the_tolerance_is_one(error, status, exact, tmp_path, capsys):
    """Of one torque in one tick; a tolerance is no licence for what is no number."""
    lines, flown = exact
    header, *rows = [line.split(",") for line in lines]
    column = next(place for place, name in enumerate(header) if name.startswith("joint_torque/"))
    most = float(np.abs(flown.log["joint_torque"]).max())
    rows[30][column] = repr(float(rows[30][column]) + error * 1e-4 * most) if np.isfinite(error) else ""
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in (header, *rows)))
    words = ("replay", tmp_path / "log.csv", "--experiment", "test2", "--tolerance", "1e-4")
    assert run(capsys, *words)[0] == status


def test_messages_of_others_replay(foreign, tmp_path, capsys):
    """One topic with all numbers, and the wind in another one that is slower."""
    from mcap.writer import Writer

    header, *rows = (foreign / "log.csv").read_text().splitlines()
    names = header.split(",")
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        state, wind = (writer.register_channel(topic, "json", 0) for topic in ("/state", "/wind"))
        other = writer.register_channel("/binary", "cdr", 0)
        for k, row in enumerate(rows):
            stamp = 10**15 + 2_000_000 * k
            numbers = dict(zip(names, map(float, row.split(",")), strict=True))
            writer.add_message(state, stamp, json.dumps(numbers).encode(), stamp)
            writer.add_message(other, stamp, b"\x00", stamp)
            if k % 20 == 0:
                writer.add_message(wind, stamp, json.dumps({"v": [numbers[f"w{i}"] for i in "xyz"]}).encode(), stamp)
        writer.finish()
    mapping = "\n".join(line for line in MAP.splitlines() if not line.startswith(("time", "raw_wind")))
    mapping = mapping.replace('columns = "', 'columns = "/state/')
    for name in ("px", "py", "pz", "qw", "qx", "qy", "qz"):
        mapping = mapping.replace(f'"{name}"', f'"/state/{name}"')
    mapping += '\nraw_wind = { columns = ["/wind/v/0", "/wind/v/1", "/wind/v/2"] }\n'
    (tmp_path / "map.toml").write_text(mapping)
    status, out, err = run(capsys, "replay", path, "--experiment", "test2", "--map", tmp_path / "map.toml")
    assert status == 1, err
    assert differences(out)["joint_torque"] < 1e-6  # before 5 s there is no wind


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda text: text.replace('"T_{}"', '"F_{}"'), "has no column `F_l_arm_jet`; did you mean"),
        (lambda text: text.replace("raw_thrust", "thrusts"), "there is no signal `thrusts`"),
        (lambda text: text.replace('["px", "py", "pz"]', '["px", "py"]'), "expected 3 names"),
        (lambda text: text.replace("scale = 1e-9", 'scale = "ns"'), "`time.scale` is"),
        (lambda text: text.replace('"stamp"', '"pz"'), "expected times that increase"),
        (lambda text: text.replace("scale = 1e-9", "scale = 1e6"), "expected at most 60 s between"),
        (lambda text: text.replace("raw_joint_position", "joint_position"), "has no `raw_joint_position`; expected"),
        (lambda text: text.replace("scale = 1e-9", "scale = 1e-8"), "period of the log is 0.02"),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused(change, expected, foreign, tmp_path, capsys):
    (tmp_path / "map.toml").write_text(change(MAP))
    words = ("--experiment", "test2", "--map", tmp_path / "map.toml")
    status, _, err = run(capsys, "replay", foreign / "log.csv", *words)
    assert (status, expected in err) == (2, True), err
    assert err.count("\n") == 1


# --- damaged and incomplete logs ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    """Lines of a flight with exact measurements as CSV, and the flight."""
    config = rust.load_config("test2", {"simulator.duration": 0.5})
    flown = rust.fly(config)
    path = tmp_path_factory.mktemp("exact") / "log.csv"
    export.write_csv(recording.from_flight(flown, config, "exact"), path)
    return path.read_text().splitlines(), flown


def differences(out):
    """Greatest differences by signal, from the printed table."""
    rows = (line.split() for line in out.splitlines()[3:-1])
    return {row[0]: float(row[1]) for row in rows}


def test_lost_rows_are_ticks_without_a_measurement(exact, tmp_path, capsys):
    """The controller flies on with its predictions: open loop, they come back to the log within rounding."""
    lines, flown = exact
    (tmp_path / "lost.csv").write_text("\n".join(lines[:21] + lines[26:41] + lines[42:]))
    message = r"no row for 5 ticks after row 20 at 0\.19 s, and for 1 in 1 other places; they are replayed as ticks"
    with pytest.warns(UserWarning, match=message):
        status, out, _ = run(capsys, "replay", tmp_path / "lost.csv", "--experiment", "test2")
    assert (status, out.splitlines()[0].split()[0]) == (1, "45")
    assert 0.0 < differences(out)["joint_torque"] < 1e-6 * np.abs(flown.log["joint_torque"]).max()


def test_the_ticks_of_lost_rows_are_the_missing_ones(exact, tmp_path):
    lines, flown = exact
    (tmp_path / "lost.csv").write_text("\n".join(lines[:21] + lines[26:]))
    config = rust.load_config("test2")
    log = logs.read(tmp_path / "lost.csv", config)
    with pytest.warns(UserWarning, match="no row for 5 ticks"):
        signals, is_recorded = measured.at_ticks(log, rust.Robot(config["robot"]), 0.01, Path("lost.csv"))
    np.testing.assert_array_equal(np.flatnonzero(~is_recorded), np.arange(20, 25))
    np.testing.assert_allclose(signals["time"], flown.log["time"], rtol=1e-14)
    for name, rows in signals.items():
        if name != "time":
            assert bits(rows[is_recorded]) == bits(flown.log[name][is_recorded]), name
            assert np.isnan(rows[20:25]).all()


def test_a_late_row_is_not_a_lost_one():
    """Rows that wait for each other, and a period a little off that of the ticks, have the ticks of the rows."""
    period, number = 0.01, np.arange(400)
    regular = 1.009 * period * number
    late = regular.copy()
    late[100:103] = late[103] - 1e-4 * np.arange(3, 0, -1)  # three at once
    late[200] += 0.9 * period
    for rows in (regular, late):
        ticks, is_lost = measured._add_lost(rows, period)
        assert not is_lost.any()
        assert bits(ticks) == bits(rows)
    lost = np.delete(late, [150, 151, 210, 300])
    ticks, is_lost = measured._add_lost(lost, period)
    np.testing.assert_array_equal(np.flatnonzero(is_lost), [150, 151, 210, 300])
    assert bits(ticks[~is_lost]) == bits(lost)
    np.testing.assert_allclose(ticks[is_lost], late[is_lost], atol=0.5 * period)


def test_doubled_times_are_the_later_row(exact, tmp_path, capsys):
    lines, _ = exact
    spoilt = ",".join(["0.29", *lines[20].split(",")[1:]])
    (tmp_path / "doubled.csv").write_text("\n".join([*lines[:30], spoilt, *lines[30:]]))
    with pytest.warns(UserWarning, match=r"row 31 of .* repeats the time of the row before, 0\.29 s; the later"):
        status, out, _ = run(capsys, "replay", tmp_path / "doubled.csv", "--experiment", "test2")
    assert (status, out.splitlines()[-1]) == (0, "equal to the last bit: 23 of 23 signals")


def test_rows_in_another_order_are_refused(exact, tmp_path, capsys):
    lines, _ = exact
    (tmp_path / "order.csv").write_text("\n".join(lines[:30] + lines[10:]))
    status, _, err = run(capsys, "replay", tmp_path / "order.csv", "--experiment", "test2")
    assert status == 2
    assert "row 30" in err
    assert "0.28 s" in err


def test_a_gap_in_a_faster_log_is_not_measured(foreign, tmp_path, capsys):
    """Rows every 2 ms, of which 30 ms are lost: the first tick after the last row is still within its reach."""
    header, *rows = (foreign / "log.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([header, *rows[:41], *rows[56:]]))
    words = ("--experiment", "test2", "--map", foreign / "map.toml")
    with pytest.warns(UserWarning, match=r"no row for 2 ticks after row 41 at 0\.08 s; "):
        status, out, _ = run(capsys, "replay", tmp_path / "log.csv", *words)
    assert (status, out.split()[0]) == (1, "19")


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_table_with_decimal_commas_is_read(separator, exact, tmp_path, capsys):
    text = "\n".join(exact[0]).replace(",", separator).replace(".", ",")
    (tmp_path / "table.csv").write_text(text, encoding="utf-8-sig")
    status, out, _ = run(capsys, "replay", tmp_path / "table.csv", "--experiment", "test2")
    assert (status, out.splitlines()[-1]) == (0, "equal to the last bit: 23 of 23 signals")


def test_an_mcap_file_that_was_cut_off_says_so(result, tmp_path, capsys):
    path = tmp_path / "flight.mcap"
    export.write_mcap(recording.read(result), path)
    content = path.read_bytes()
    for length in (8, 100, len(content) // 2, len(content) - 9, len(content) - 1):
        path.write_bytes(content[:length])
        status, _, err = run(capsys, "replay", path)
        assert status == 2
        assert "cut off" in err, length
        assert f"mcap recover {path} -o" in err


def test_the_configuration_is_found_without_an_index(result, tmp_path, capsys):
    """As in files of writers that index chunks alone."""
    from mcap.writer import IndexType, Writer

    export.write_mcap(recording.read(result), tmp_path / "whole.mcap")
    with (tmp_path / "whole.mcap").open("rb") as file, (tmp_path / "part.mcap").open("wb") as other:
        reader, writer = mcap_reader.make_reader(file), Writer(other, index_types=IndexType.CHUNK)
        writer.start()
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        channels = {}
        for _, channel, message in reader.iter_messages():
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(channel.topic, "json", 0)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    status, out, err = run(capsys, "replay", tmp_path / "part.mcap")
    assert (status, out.splitlines()[-1]) == (0, "equal to the last bit: 23 of 23 signals"), err


def test_what_does_not_fit_is_refused(result, foreign, tmp_path, capsys):
    (tmp_path / "empty.mcap").write_bytes(b"no such file")
    tables = {
        "text": "time,raw_wind/x\n0,b\n",
        "short": "time,a\n\n0,1\n1\n",
        "decimal": "time,a\n0,0,5,0\n",
        "thousands": "time;raw_wind/x\n0,5;1.000,5\n",
        "letter": "a letter\nof two lines\n",
        "empty": "",
    }
    for name, content in tables.items():
        (tmp_path / f"{name}.csv").write_text(content)
    (tmp_path / "latin.csv").write_bytes("time,größe\n0,1\n".encode("latin-1"))
    (tmp_path / "nothing.mcap").write_bytes(b"")
    csv = ("--experiment", "test2")
    export.write_mcap(recording.read(result), tmp_path / "damaged.mcap")
    content = bytearray((tmp_path / "damaged.mcap").read_bytes())
    content[len(content) // 2] ^= 0xFF  # within a compressed chunk
    (tmp_path / "damaged.mcap").write_bytes(content)
    refusals = {
        ("replay", result, "--set", "controller.torque.steps=10"): "whose ticks need the joints in between",
        ("replay", result, "--map", foreign / "map.toml"): "expected it with a file of .mcap, .mat, .csv, ",
        ("replay", foreign / "log.csv", "--experiment", "test2"): "expected a header with `time`",
        ("replay", foreign / "log.csv", "--map", foreign / "map.toml"): "expected --experiment NAME",
        ("replay", tmp_path / "empty.mcap"): "does not begin as an MCAP file",
        ("replay", tmp_path / "nothing.mcap"): "is empty; expected an MCAP file",
        ("replay", tmp_path / "nowhere.mcap"): "No such file",
        ("replay", tmp_path / "damaged.mcap"): "mcap recover",
        (
            "replay",
            tmp_path / "text.csv",
            *csv,
        ): f"column raw_wind/x in line 2 of `{tmp_path}/text.csv` is b; expected a number",
        ("replay", tmp_path / "short.csv", *csv): "number of cells in line 4 of",
        ("replay", tmp_path / "decimal.csv", *csv): "is 4; expected 2, as its header; with decimal commas",
        ("replay", tmp_path / "thousands.csv", *csv): "is 1.000,5; expected a number",
        ("replay", tmp_path / "letter.csv", *csv): "is a letter; expected a header with `time`",
        ("replay", tmp_path / "empty.csv", *csv): "is empty; expected a header with `time`",
        ("replay", tmp_path / "latin.csv", *csv): "expected text in UTF-8",
        ("replay", tmp_path / "nowhere.csv", *csv): "No such file",
        ("export", result, "--csv", "--out", tmp_path / "a.mcap"): "does not end in .csv",
        ("export", result, "--csv", "--ghost", result, "--out", tmp_path / "a.csv"): "expected --html",
        ("export", result, "--csv", "--profile", "ros2", "--out", tmp_path / "a.csv"): "expected --mcap",
    }
    for words, expected in refusals.items():
        status, _, err = run(capsys, *words)
        assert (status, expected in err) == (2, True), (words, err)
        assert err.count("\n") == 1, err


# --- logs of others as loggers write them


def others(foreign, change):
    """Header and rows of the log of others at the rate of its ticks, as `change` makes them."""
    header, *rows = [line.split(",") for line in (foreign / "log.csv").read_text().splitlines()]
    return "\n".join(",".join(row) for row in change(header, rows[::5])) + "\n"


def sparse(header, rows):
    """Rows of the base, of the joints 2 ms later, and of thrusts and wind 3 ms later at half the rate."""
    of_joint = [name.startswith(("q_", "dq_", "tau_")) for name in header]
    of_base = [name[0] in "pv" or name in ("qw", "qx", "qy", "qz") for name in header]
    sources = (
        (of_base, 0),
        (of_joint, 2_000_000),
        ([not (b or j) for b, j in zip(of_base, of_joint, strict=True)], 3_000_000),
    )
    yield header
    for number, row in enumerate(rows):
        for source, (is_own, delay) in enumerate(sources):
            if source < 2 or number % 2 == 0:
                cells = [cell if own else "" for cell, own in zip(row, is_own, strict=True)]
                yield [str(float(row[0]) + delay), *cells[1:]]


def filled(header, rows):
    """The same with empty cells filled from the row above."""
    last = [""] * len(header)
    yield header
    for row in list(sparse(header, rows))[1:]:
        last = [new or old for new, old in zip(row, last, strict=True)]
        yield last


@pytest.mark.parametrize("change", [sparse, filled])
def test_sources_that_fill_their_own_rows_replay(change, foreign, tmp_path, capsys):
    """Ticks begin where every source has written; the joints give their times."""
    (tmp_path / "log.csv").write_text(others(foreign, change))
    words = ("--experiment", "test2", "--map", foreign / "map.toml")
    status, out, err = run(capsys, "replay", tmp_path / "log.csv", *words)
    assert (status, err) == (1, "")
    assert 18 <= int(out.split()[0]) <= 21
    assert differences(out)["joint_torque"] < 1.0  # N m; the thrusts are those of up to two ticks before


def test_columns_that_nobody_names_hold_anything(exact, tmp_path, capsys):
    lines, _ = exact
    words = [line + (",mode", ",HOVER")[number > 0] for number, line in enumerate(lines)]
    (tmp_path / "log.csv").write_text("\n".join(words))
    status, out, err = run(capsys, "replay", tmp_path / "log.csv", "--experiment", "test2")
    assert (status, out.splitlines()[-1].split(":")[0]) == (0, "equal to the last bit"), err


def test_a_controller_without_estimator_needs_joint_velocities_by_name(foreign, tmp_path, capsys):
    mapping = "\n".join(line for line in MAP.splitlines() if not line.startswith("raw_joint_velocity"))
    (tmp_path / "map.toml").write_text(mapping)
    words = ("replay", foreign / "log.csv", "--map", tmp_path / "map.toml", "--experiment")
    status, _, err = run(capsys, *words, "test2")
    assert (status, "has no `raw_joint_velocity`" in err, "estimator needs none" in err) == (2, True, True)
    status, _, err = run(capsys, *words, "test2_sensors")
    assert status == 1, err


def test_marks_of_a_missing_value_are_named(foreign, tmp_path, capsys):
    def spoil(header, rows):
        wind = header.index("wx")
        yield header
        yield from (
            [*row[:wind], "99.0" if number in (3, 4) else row[wind], *row[wind + 1 :]]
            for number, row in enumerate(rows)
        )

    (tmp_path / "log.csv").write_text(others(foreign, spoil))
    (tmp_path / "map.toml").write_text(MAP.replace('["wx", "wy", "wz"]', '["wx", "wy", "wz"], missing = [99.0]'))
    words = ("replay", tmp_path / "log.csv", "--experiment", "test2", "--map")
    status, _, err = run(capsys, *words, foreign / "map.toml")
    assert (status, "column `wx`" in err, "is 99 in row 4" in err, "missing = [99]" in err) == (2, True, True, True)
    config = rust.load_config("test2")
    log = logs.read(tmp_path / "log.csv", config, tmp_path / "map.toml")
    wind = measured.at_ticks(log, rust.Robot(config["robot"]), 0.01, Path("log.csv")).signals["raw_wind"]
    assert np.flatnonzero(np.isnan(wind).any(axis=1)).tolist() == [3, 4]
    (tmp_path / "map.toml").write_text(MAP.replace('["wx", "wy", "wz"]', '["wx", "wy", "wz"], missing = []'))
    assert logs.read(tmp_path / "log.csv", config, tmp_path / "map.toml").signals["raw_wind"][0].rows[3] == 99.0


# --- what files of others need in memory


def test_gaps_are_few(exact, tmp_path, capsys):
    lines, _ = exact
    times = (f"{55.0 * (number - 29)}{line[line.index(',') :]}" for number, line in enumerate(lines[1:]))
    (tmp_path / "gaps.csv").write_text("\n".join([lines[0], *lines[1:30], *list(times)[30:]]))
    status, _, err = run(capsys, "replay", tmp_path / "gaps.csv", "--experiment", "test2")
    assert (status, "expected one in most of 0.01 s" in err) == (2, True), err


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_grows_is_not_decompressed(compression, tmp_path, capsys, monkeypatch):
    from mcap.writer import CompressionType, Writer

    path = tmp_path / "zeros.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=CompressionType[compression.upper()])
        writer.start()
        channel = writer.register_channel("/state", "json", 0)
        writer.add_message(channel, 0, b"[" + b"0," * (1 << 20) + b"0]", 0)
        writer.finish()
    assert path.stat().st_size < 20_000
    monkeypatch.setattr(sizes, "MAX_PART", 1 << 20)
    status, _, err = run(capsys, "replay", path, "--experiment", "test2")
    assert (status, "bytes in a chunk or more; expected at most" in err) == (2, True), err


def test_messages_of_many_numbers_are_counted(tmp_path, capsys, monkeypatch, result):
    export.write_mcap(recording.read(result), tmp_path / "log.mcap")
    monkeypatch.setattr(sizes, "MAX_NUMBERS", 1 << 16)
    status, _, err = run(capsys, "replay", tmp_path / "log.mcap")
    assert (status, "bytes of numbers or more; expected at most 65536" in err) == (2, True), err


def test_messages_are_in_the_order_of_their_times(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/state", "json", 0)
        for stamp in (30, 10, 20):
            writer.add_message(channel, 10**18 + stamp * 10**9, json.dumps({"n": stamp}).encode(), stamp)
        writer.finish()
    columns, config, _ = read_mcap(tmp_path / "log.mcap", is_ours=False)
    assert config is None
    assert [part.tolist() for part in columns["/state/n"]] == [[0.0, 10.0, 20.0], [10.0, 20.0, 30.0]]


@pytest.mark.parametrize("joint_observer", [0.02, 0.05])
def test_from_when_a_controllers_own_memory_does_not_reproduce_nothing_is_compared(joint_observer, tmp_path, capsys):
    """Of iRonCub-Mk3's log in single precision: with 0.02 s the controller's copy parts from it."""
    config = rust.load_config(
        "mk3_robot", {"simulator.duration": 8.0, "controller.estimator.joint_observer": joint_observer}
    )
    flight = rust.fly(config)
    single = {name: rows.astype(np.float32).astype(np.float64) for name, rows in flight.log.items()}
    single["time"] = flight.log["time"]
    dataset = record.to_dataset(
        replace(flight, log=single), rust.Robot(config["robot"]), title="", config_digest=rust.config_digest(config)
    )
    record.write_run(tmp_path / "single", dataset, {"title": "", "config": manifest.make_portable(config)})
    status, printed, _ = run(capsys, "replay", tmp_path / "single")
    assert status == 1
    told = re.search(r"not compared from (\S+) s on: the controller's own memory does not reproduce", printed)
    greatest = float(re.search(r"^joint_torque +(\S+)", printed, re.M)[1])
    if joint_observer == 0.02:
        assert 2.0 < float(told[1]) < 8.0
    else:
        assert told is None
    assert greatest < 0.2
