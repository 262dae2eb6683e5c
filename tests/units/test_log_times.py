"""Times of recorded messages: those of recording, those that messages state, and clocks that are apart."""

import json
import warnings

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.body.spatial import wxyz_from_rotation
from jax_aero.view import logs, measured
from jax_aero.view.columns import Series

writer = pytest.importorskip("mcap.writer", reason="mcap is not installed: make setup")
ROWS = 60
NS = 10_000_000 * np.arange(ROWS)
"""Times of measurement [ns]."""
TOPICS = (
    {"raw_base_position": 3, "raw_base_quaternion": 4, "raw_base_velocity": 6},
    {"raw_joint_position": 23, "raw_joint_velocity": 23, "raw_thrust": 4},
)


@pytest.fixture(scope="module")
def config():
    return rust.load_config("test2", {"simulator.duration": 0.01 * (ROWS - 1)})


@pytest.fixture(scope="module")
def flown(config):
    log = dict(rust.fly(config).log)
    return log | {"raw_base_quaternion": np.asarray(wxyz_from_rotation(log["raw_base_rotation"]))}


def recorded(path, flown, clock, *, is_late):
    """Write the bodies' messages as they are measured, and the joints' as `clock` stamps them when recording."""
    with path.open("wb") as file:
        log = writer.Writer(file)
        log.start()
        for topic, signals, stamps in zip(("/base", "/joints"), TOPICS, (NS, clock), strict=True):
            channel = log.register_channel(topic, "json", 0)
            for k in range(ROWS):
                late = 3600 if is_late and topic == "/joints" else 0
                stamp = {"sec": 10**9 + late, "nanosec": int(NS[k])} if topic == "/joints" else 1e9 + 1e-9 * NS[k]
                message = {name: flown[name][k].tolist() for name in signals} | {"stamp": stamp}
                log.add_message(channel, 10**18 + int(stamps[k]), json.dumps(message).encode(), 0)
        log.finish()
    return path


def mapping(folder, *stamps):
    path = folder / "map.toml"
    entries = {
        name: [f"{topic}/{name}/{place}" for place in range(size)]
        for topic, signals in zip(("/base", "/joints"), TOPICS, strict=True)
        for name, size in signals.items()
    }
    entries |= {"time": list(stamps)} if stamps else {}
    path.write_text("\n".join(f"{name} = {{ columns = {json.dumps(names)} }}" for name, names in entries.items()))
    return path


def ticks(path, config, columns):
    log = logs.read(path, config, columns)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return measured.at_ticks(log, rust.Robot(config["robot"]), 0.01, path)


BURSTS, HOUR = NS // 50_000_000 * 50_000_000, NS + 3_600_000_000_000
BOTH = ("/joints/stamp", "/base/stamp")


@pytest.mark.parametrize(
    ("clock", "stamps", "is_late", "words"),
    [
        (BURSTS, (), False, "in bursts; expected times of measurement, which `time = "),
        (HOUR, (), False, r"`raw_\w+` \(0 to 0.59 s\) and `raw_\w+` \(3600 to 3600.59 s\) of .* do not overlap"),
        (NS, BOTH, True, "do not overlap"),
        (NS, BOTH[:1], False, "expected one of each topic, also of that of `/base/raw_base_position/0`"),
    ],
)
def test_times_that_are_none_of_measurement_are_refused_by_name(clock, stamps, is_late, words, flown, config, tmp_path):
    path = recorded(tmp_path / "log.mcap", flown, clock, is_late=is_late)
    with pytest.raises(Refused, match=words):
        ticks(path, config, mapping(tmp_path, *stamps))


@pytest.mark.parametrize("clock", [NS, BURSTS, HOUR])
def test_the_times_that_messages_state_are_theirs(clock, flown, config, tmp_path):
    path = recorded(tmp_path / "log.mcap", flown, clock, is_late=False)
    found = ticks(path, config, mapping(tmp_path, *BOTH)).signals
    np.testing.assert_allclose(found["time"], 1e-9 * NS, atol=3e-7)  # half of the last bit of seconds since 1970
    np.testing.assert_array_equal(found["raw_joint_position"], flown["raw_joint_position"])
    np.testing.assert_array_equal(found["raw_base_position"], flown["raw_base_position"])


def test_jitter_of_stamps_is_no_other_period(config, flown):
    """Of 2 ms, of which the median step of a log is 1 % off in 29 % of logs; another period is still refused."""
    robot = rust.Robot(config["robot"])
    names = [name for signals in TOPICS for name in signals]
    random = np.random.default_rng(0)
    for period, is_read in [(0.01, True)] * 20 + [(0.0103, False)] * 3:
        times = np.sort(period * np.arange(500) + 0.002 * random.standard_normal(500))
        rows = {name: [Series(times, np.resize(flown[name], (500, *flown[name].shape[1:])))] for name in names}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = measured.at_ticks(logs.Log(rows, config), robot, 0.01, "log").signals
        if is_read:
            assert 500 <= len(found["time"]) <= 503  # a step of two periods may be one of jitter
            rust.replay(config, found)
        else:
            with pytest.raises(ValueError, match="period of the log"):
                rust.replay(config, found)


def test_a_rotation_of_zeros_is_refused(flown, config, tmp_path):
    """It is what a logger writes before its first message."""
    turned = flown | {"raw_base_quaternion": flown["raw_base_quaternion"] * (np.arange(ROWS) > 3)[:, None]}
    path = recorded(tmp_path / "log.mcap", turned, NS, is_late=False)
    with pytest.raises(
        Refused, match=r"`raw_base_quaternion` of .* is 0 -?0 -?0 0 in row 1 at 0 s, .* 4 ticks; expected one"
    ):
        ticks(path, config, mapping(tmp_path, *BOTH))
