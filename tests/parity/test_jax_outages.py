"""Outages in JAX against the Rust crate: what is predicted where measurements are missing, frozen or wrong."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import outages, rust, sim
from jax_aero.config import Outage as OutageConfig
from jax_aero.control import Measurement
from jax_aero.control.modes import MODES
from jax_aero.robot import load_robot
from jax_aero.types import State

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
EXPERIMENTS = CONFIGS / "experiments"

JUMP = {
    "wind": 5.0,
    "joint_position": 0.5,
    "joint_velocity": 30.0,
    "position": 0.3,
    "rotation": 0.2,
    "velocity": 1.0,
    "angular_velocity": 2.0,
}
ENGINES = {
    "time_constant": 0.5,
    "deviation_max": 15.0,
    "confirmation": 0.05,
    "descent": {
        "range_share_min": 0.3,
        "momentum": {"kp_linear": [0.0, 0.0, 0.1], "kd_linear": [0.3, 0.3, 0.6], "ko": 10.0, "c0": 50.0, "c1": 125.0},
        "joint_velocity_max_deg": 90.0,
        "torque_rate_max": 3000.0,
    },
}
SUPERVISOR = {"horizon": 0.3, "rotation": 0.05, "position": 0.05, "joint_velocity": 0.5, "confirmation": 0.03}
OUTAGES = [
    {"channel": "base_position", "start": 0.0, "duration": 0.01, "kind": "wrong", "error": 0.4},
    {"channel": "wind", "start": 0.0, "duration": 0.01, "kind": "wrong", "error": 20.0},  # outvoted by the next ones
    {"channel": "wind", "start": 0.3, "duration": 0.05, "kind": "missing"},
    {"channel": "wind", "start": 0.4, "duration": 1.0, "kind": "wrong", "error": 20.0},  # rejected for good
    {"channel": "thrust", "jet": "l_arm_jet", "start": 0.5, "kind": "nan"},
    {"channel": "base_velocity", "start": 0.6, "duration": 0.2, "kind": "frozen"},
    {"channel": "base_position", "start": 0.74, "duration": 0.02, "kind": "frozen"},  # new again after two ticks
    {"channel": "base_rotation", "start": 0.9, "duration": 0.1, "kind": "frozen"},
    {"channel": "base_position", "start": 1.1, "duration": 0.2, "kind": "wrong"},
    {"channel": "joints", "start": 1.4, "duration": 0.05, "kind": "nan"},
    {"channel": "base_position", "start": 1.5, "kind": "missing"},
    {"channel": "base_rotation", "start": 1.7, "duration": 0.1, "kind": "wrong", "error": 0.4},
]


def test_a_wrong_value_is_off_by_the_error_while_the_outage_lasts():
    config = OutageConfig(channel="wind", kind="wrong", start=0.4, duration=0.2, error=1.5)
    outage = outages.outages_of([config], load_robot(CONFIGS / "robot" / "platform.toml"))
    state, wind = State(np.zeros(3), np.eye(3), np.zeros(0), np.zeros(6)), np.array([1.0, -2.0, 3.0])
    measurement = jax.tree.map(jnp.asarray, Measurement(0.0, state, np.zeros(6), wind))
    held = outages.begin(outage, measurement.state, measurement.thrust)
    for time, error in ((0.39, 0.0), (0.4, 1.5), (0.59, 1.5), (0.6, 0.0)):
        held, seen = outages.spoil(outage, held, measurement._replace(time=jnp.array(time)))
        np.testing.assert_array_equal(seen.wind, measurement.wind + error)


def test_a_flight_with_outages_of_every_kind(measured):
    """One flight, every channel once and an engine; the robot begins to descend at its end, while it flies forward."""
    changes = {
        "simulator.duration": 2.4,
        "mission.forward": [[0.2, 2.4]],
        "wind.ramp_start": 0.1,
        "wind.ramp_end": 0.3,
        "controller.channels.wind_hold": 0.3,
        "controller.channels.wind_fade": 0.5,
        "controller.channels.descend_after": 0.7,
        "controller.channels.jump": JUMP,
        "controller.engines": ENGINES,
        "controller.supervisor": SUPERVISOR,
        "disturbances.outages": OUTAGES,
        "disturbances.jets.failure": {"jet": "chest_l_jet", "time": 2.1, "kind": "off", "decay": 0.3},
    }
    table = rust.load_config(EXPERIMENTS / "test2_observer.toml", changes)
    theirs = rust.fly(table)
    ours = sim.fly(table)
    assert ours.outcome == theirs.outcome == "completed"
    modes = theirs.log["degraded_modes"]
    np.testing.assert_array_equal(ours.log["degraded_modes"], modes)
    seen = set(np.unique(modes).astype(int))
    for mode in set(MODES) - {"feet_predicted", "clock_predicted", "joint_limited", "late", "residual_ignored"}:
        assert any(bits & MODES[mode] for bits in seen), f"{mode} is never reached"
    held = np.flatnonzero(modes.astype(int) & MODES["wind_held"])
    assert held.tolist() == [1, *range(30, 35), *range(40, len(modes))]
    for name in ("base_position", "joint_position", "thrust", "joint_torque", "unmodelled_wrench", "com_setpoint"):
        scale = max(1.0, np.abs(theirs.log[name]).max())
        difference = np.abs(ours.log[name] - theirs.log[name]).max() / scale
        measured(name, difference, 1e-9, because="rounding, as in flights without outages")
    assert all(np.any((modes.astype(int) & MODES["straying"]) == bits) for bits in (0, MODES["straying"]))

    table["controller"]["supervisor"]["descend"] = True
    theirs, ours = rust.fly(table), sim.fly(table)
    np.testing.assert_array_equal(ours.log["degraded_modes"], theirs.log["degraded_modes"])
    descends, strays = (theirs.log["degraded_modes"].astype(int) & MODES[mode] for mode in ("descending", "straying"))
    assert np.argmax(descends > 0) == np.argmax(strays > 0) + 1


def test_a_flight_begins_again_after_a_wrong_first_measurement(measured):
    """With encoders and a state estimator: both engines outvote the same measurement, and refer to the same one."""
    wrong = {"channel": "joints", "start": 0.0, "duration": 0.01, "kind": "wrong", "error": 0.15}
    changes = {"simulator.duration": 0.3, "disturbances.outages": [wrong]}
    table = rust.load_config(EXPERIMENTS / "test2_sensors.toml", changes)
    theirs, ours = rust.fly(table), sim.fly(table)
    assert ours.outcome == theirs.outcome == "completed"
    again = theirs.log["degraded_modes"].astype(int) & MODES["begun_again"]
    assert np.flatnonzero(again).tolist() == [2]
    np.testing.assert_array_equal(ours.log["degraded_modes"], theirs.log["degraded_modes"])
    right = rust.fly(rust.load_config(EXPERIMENTS / "test2_sensors.toml", {"simulator.duration": 0.3}))
    assert np.abs(theirs.joint_setpoint - right.joint_setpoint).max() < 0.075  # half of the error
    np.testing.assert_allclose(ours.joint_setpoint, theirs.joint_setpoint, rtol=0, atol=1e-12)
    (batched,) = sim.fly_batch([table])
    np.testing.assert_allclose(batched.joint_setpoint, theirs.joint_setpoint, rtol=0, atol=1e-12)
    for name in ("base_position", "joint_position", "joint_torque", "com_setpoint"):
        scale = max(1.0, np.abs(theirs.log[name]).max())
        difference = np.abs(ours.log[name] - theirs.log[name]).max() / scale
        measured(name, difference, 1e-9, because="rounding, as in flights without outages")


@pytest.mark.parametrize("estimator", [None, {"thrust": {"delay": 0.02}}])
def test_a_flight_begins_without_what_is_not_accepted(estimator, measured):
    """A first thrust and a first wind beyond the greatest count as none: the robot's weight is all that acts."""
    changes = {
        "simulator.duration": 0.05,
        "simulator.sensors": {"thrust": {"bias": 3000.0}},
        "disturbances.controller_wind": {"profile": "constant", "velocity": [0.0, -500.0, 0.0]},
    }
    if estimator is not None:
        changes["controller.estimator"] = estimator
    table = rust.load_config(EXPERIMENTS / "test2.toml", changes)
    theirs = rust.fly(table)
    ours = sim.fly(table)
    robot = rust.Robot(table["robot"])
    first = theirs.log["momentum_rate_estimate"][0, :3]
    # The air of a robot that has fallen for a tick, at 0.1 m/s: 0.006 N on 1 m².
    np.testing.assert_allclose(first, [0.0, 0.0, -robot.mass * robot.gravity], atol=0.05)
    for name in ("momentum_rate_estimate", "thrust_rate", "joint_torque", "degraded_modes"):
        scale = max(1.0, np.abs(theirs.log[name]).max())
        difference = np.abs(ours.log[name] - theirs.log[name]).max() / scale
        measured(name, difference, 1e-9, because="rounding, as in flights without outages")


@pytest.mark.parametrize(
    ("outage", "complaint"),
    [
        ({"channel": "wind", "start": 0.0, "kind": "nan"}, r"outages\[0\].start"),
        ({"channel": "wind", "jet": "l_arm_jet", "start": 1.0, "kind": "nan"}, r"outages\[0\].jet"),
        ({"channel": "thrust", "jet": "nose", "start": 1.0, "kind": "nan"}, r"outages\[0\].jet"),
    ],
)
def test_outages_that_mean_nothing_are_refused(outage, complaint):
    with pytest.raises(ValueError, match=complaint):
        rust.check_config(rust.load_config(EXPERIMENTS / "test2.toml", {"disturbances.outages": [outage]}))
