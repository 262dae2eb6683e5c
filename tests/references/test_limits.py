"""Each limit acts on its own axis in its unit: bounds of every tick are those of numbers that are read once more."""

from __future__ import annotations

import re

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base import places
from jax_aero.verify import everything
from tests.references import flights, joints, limits
from tests.references.limits import Limits

OF_LAW = {
    "controller.bounds.joint_velocity_max_deg": 40.0,
    "controller.torque.torque_max": 7.0,
    "controller.torque.torque_rate_max": 5.0,
}
"""Limits that the law sets, of revolute joints alone [deg/s, N m, N m/s]."""

DETECTION = rust.load_config("robot")["controller"]["fault_detection"]
FAULTS = {
    "controller.channels.jump": True,
    "controller.fault_detection": DETECTION,
    "mission": {"forward_turbo": [[2.0, 4.0]], "yaw_left": [[2.5, 4.0]]},
}


@pytest.fixture
def slider(tmp_path):
    """The robot with joints of both kinds, each of whose limits is another number."""
    source, rng = places.find("robot", "slider"), np.random.default_rng(0)

    def drawn(found: re.Match[str]) -> str:
        most, least = rng.uniform(46.0, 49.0), rng.uniform(1.0, 12.0)
        return f"thrust_min = {least}\nthrust_max = {most}"

    text = re.sub(r"thrust_min = .*\nthrust_max = .*", drawn, source.read_text(encoding="utf-8"))
    (tmp_path / "slider.toml").write_text(text, encoding="utf-8")
    (tmp_path / "slider.urdf").write_bytes(source.with_suffix(".urdf").read_bytes())
    return {"robot": str(tmp_path / "slider.toml")}


@pytest.mark.parametrize("changes", [{}, everything.OTHERWISE, OF_LAW, everything.OTHERWISE | OF_LAW])
def test_limits_are_those_of_the_files(slider, changes):
    config = rust.load_config(everything.FILE, slider | changes)
    assert limits.follow(config, flights.fly(config)) == []


def stops(time):
    return {"disturbances.jets.failure": {"jet": "l_arm_jet", "kind": "off", "time": time}}


def fault(joint, kind):
    return {"disturbances.joints": [{"joint": joint, "kind": kind, "start": 2.2}]}


@pytest.mark.parametrize(
    ("changes", "mode"),
    [
        (stops(0.3) | {"simulator.duration": 1.0}, "descending"),
        (fault("torso_pitch", "stuck") | {"simulator.duration": 4.3}, "joint_limited"),
        (fault("torso_pitch", "stuck") | stops(4.2) | {"simulator.duration": 4.8}, "descending"),
        (fault("torso_pitch", "weak") | {"simulator.duration": 3.2}, "joint_limited"),
        (fault("l_shoulder_pitch", "free") | {"simulator.duration": 2.7}, "joint_limited"),
    ],
)
def test_limits_of_faults_are_those_of_their_axes(changes, mode):
    """Of the stopped engine, of a joint with a fault, and of all revolute joints without an engine."""
    config = rust.load_config("test2_observer", FAULTS | changes)
    ticks = flights.fly(config)
    _, _, shares = joints.follow(config, ticks)
    assert mode in ticks[-1].tick.degraded_modes
    assert limits.follow(config, ticks, shares) == []


def test_wrong_limits_are_refused(slider, monkeypatch):
    """Each by 1 %, and of the next axis; the steepness of thrusts is not that of joints."""
    config = rust.load_config(everything.FILE, slider | everything.OTHERWISE | OF_LAW)
    ticks, right = flights.fly(config), Limits.__init__

    def refused(change) -> list[str]:
        def wrong(own, config):
            right(own, config)
            change(own)

        with monkeypatch.context() as patch:
            patch.setattr(Limits, "__init__", wrong)
            return limits.follow(config, ticks)

    assert refused(lambda _: None) == []
    for name in ("fast", "strong", "quick", "rate"):
        for change in (lambda x: 1.01 * x, lambda x: np.roll(x, 1)):
            assert refused(lambda own, name=name, change=change: setattr(own, name, change(getattr(own, name)))), name
    for name in ("ends", "thrust"):
        for end in range(2):
            for change in (lambda x: 1.01 * x, lambda x: np.roll(x, 1)):

                def turn(own, name=name, end=end, change=change):
                    both = list(getattr(own, name))
                    both[end] = change(both[end])
                    setattr(own, name, both)

                assert refused(turn), (name, end)
    assert refused(lambda own: setattr(own, "steep", own.steep[::-1]))
