"""A controller and its copy that hear the same measurements stay together."""

import json

import numpy as np
import pytest

from jax_aero import memory, rust
from jax_aero.base import places

PARTS = {"mk3_robot", "mk3_design", "mk3_robot_take_off in the air"}
"""Shipped controllers whose copy parts from them in a hover: a list that only shrinks."""

STANDING = {"robot_take_off", "mk3_robot_take_off"}
"""Those whose copy parts from them while their feet carry: a list that only shrinks."""


def shipped():
    """Return a flight for every controller and robot of the experiments, those with feet in the air too."""
    found = {}
    for name in places.names("experiments"):
        config = rust.load_config(name)
        key = json.dumps([config["robot"], config["controller"]], sort_keys=True, default=str)
        found.setdefault(key, (name, config))
    flights = dict(found.values())
    for name in STANDING:
        flown = rust.load_config(name.removesuffix("_take_off"))
        flights[f"{name} in the air"] = {**flown, "controller": rust.load_controller(name)}
    return flights


SHIPPED = shipped()


def test_every_controller_has_a_flight():
    """By what identifies it: its configuration, with the numbers of its robot."""
    flown = [config["controller"] for config in SHIPPED.values()]
    for name in places.names("control"):
        assert rust.load_controller(name) in flown, name


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_controller_keeps_its_copy(name):
    """It hovers, or stands; one that does not is listed."""
    found = memory.growth(SHIPPED[name])
    assert found.stays == (name not in PARTS | STANDING), found


@pytest.mark.parametrize(
    ("setting", "stays"),
    [
        ({"controller.estimator.joint_observer": 0.02, "controller.disturbance_observer.gain_force": 3.0}, False),
        ({"controller.estimator.joint_observer": 0.05}, True),
        ({"controller.estimator.joint_observer": 0.02, "controller.disturbance_observer.gain_force": 2.0}, True),
    ],
)
def test_the_observers_of_joints_and_force_decide(setting, stays):
    """iRonCub-Mk3: 1.014 a tick at 0.5 Hz is ten times in 1.65 s, as a replay of its log parts from it."""
    found = memory.growth(rust.load_config("mk3_robot", setting))
    assert found.stays == stays
    if not stays:
        assert found.greatest == pytest.approx(1.014, abs=0.002)
        assert found.frequency == pytest.approx(0.5, abs=0.1)
        assert "tenfold in 1." in str(found)


@pytest.mark.parametrize("growth", [0.98, 1.0, 1.014])
def test_eigenvalues_are_those_of_the_map(growth):
    """A rotation by 0.03 rad a tick that grows, beside a mode that decays, seen by three numbers of four states."""
    turn = growth * np.array([[np.cos(0.03), -np.sin(0.03)], [np.sin(0.03), np.cos(0.03)]])
    tick = np.block([[turn, np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([0.9, 0.3])]])
    seen, state, ticks = np.random.default_rng(1).normal(size=(3, 4)), np.array([1.0, 0.0, 5.0, 5.0]), []
    for _ in range(400):
        ticks.append(seen @ state)
        state = tick @ state
    found = memory.eigenvalues([np.array(ticks)])
    assert abs(found[0]) == pytest.approx(growth, abs=1e-6)
    assert abs(np.angle(found[0])) == pytest.approx(0.03, abs=1e-6)


def test_what_has_no_memory_has_no_growth():
    assert memory.growth(rust.load_config("platform_hover")).greatest == 0.0
