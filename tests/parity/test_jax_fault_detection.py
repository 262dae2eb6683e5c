"""The crate with its fault detection flies as JAX without it while nothing fails, and as itself without one.

What fault detection answers, JAX refuses.
"""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.base import places, tables
from jax_aero.base.typed_config import scenario_config
from jax_aero.verify.flight import NOT_COMPARED

DETECTORS = ("channels", "fault_detection")


def healthy():
    """Flights of controllers with an observer, an estimator or a predictive law, in which nothing fails."""
    for name in places.names("experiments"):
        table = rust.load_config(name)
        controller, jets = table["controller"], table["disturbances"]["jets"]
        watches = any(controller.get(part) for part in ("disturbance_observer", "estimator", "mpc"))
        if watches and table.get("backend") != "mujoco" and "failure" not in jets:
            yield name


HEALTHY = tuple(healthy())
OF_EVERY_KIND = (
    *("mk3_min_jerk_mpc", "robustness_mpc", "robustness_observer"),
    *("test1_published_observer", "test2_sensors", "test2_sensors_mpc", "robot", "mk3_robot"),
)
"""Of those that JAX flies too: observer, estimator, predictive law, network, robot, and all that a robot meets."""


def test_flights_of_every_kind_are_healthy():
    assert {*OF_EVERY_KIND} < {*HEALTHY}


@pytest.mark.parametrize("name", HEALTHY)
def test_the_guard_does_nothing_while_nothing_fails(name):
    """To the last bit."""
    table = rust.load_config(name)
    if table["controller"].get("mpc"):
        table["simulator"]["duration"] = 12.0  # until the mission has begun
    without = {key: value for key, value in table["controller"].items() if key not in DETECTORS}
    guarded, free = rust.fly(table), rust.fly(table | {"controller": without})
    assert not guarded["degraded_modes"].any()
    for signal in guarded.log.keys() - set(NOT_COMPARED):
        np.testing.assert_array_equal(guarded[signal], free[signal], err_msg=signal)


# iRonCub-Mk3's flights compile for two minutes each.
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name.startswith("mk3") else name for name in OF_EVERY_KIND]
)
def test_jax_flies_as_the_guarded_crate(name, fly_both):
    """Into a wind that rises at once; networks in double precision."""
    table = rust.load_config(name)
    duration = 0.3 if table["controller"].get("mpc") else 1.5
    table["wind"] |= {"ramp_start": 0.0, "ramp_end": 0.5 * duration}
    simulator = table["simulator"]
    simulator["duration"] = duration
    for model in (simulator["aero"], table["controller"]["aero"]):
        if model["model"] == "network":
            model["precision"] = "f64"
    expected, _ = fly_both(table)
    assert not expected["degraded_modes"].any()


REFUSED = {
    "disturbances.outages": [{"channel": "wind", "start": 1.0, "kind": "missing"}],
    "disturbances.joints": [{"joint": "l_elbow", "kind": "stuck", "start": 1.0}],
    "disturbances.jets.failure": {"jet": "l_arm_jet", "time": 1.0, "kind": "off"},
    "disturbances.jets.thrust_limit_scale": 0.7,
    "controller.torque.steps": 5,
    "own_controller": {"file": __file__, "name": "healthy"},
    "simulator.sensors.base_position.period": 0.05,
    "simulator.sensors.base_angular_velocity.gaps": 0.2,
}


@pytest.mark.parametrize("key", REFUSED)
def test_what_the_crate_alone_flies_is_refused(key):
    table = rust.load_config("test2_observer", {key: REFUSED[key], "simulator.substeps": 5})
    with pytest.raises(ValueError, match=rf"`{key}` is .*; expected .*; the crate flies it \(`backend = \"rust\"`\)"):
        sim.prepare(table, dtype=np.float32)


def test_engines_of_shafts_are_refused():
    shaft = tables.read(places.CONFIGS / "engines/jetcat_p300.toml")
    for key in ("simulator.jets", "controller"):
        jets = {"simulator.jets.dynamics": "throttled"} if key == "simulator.jets" else {}
        with pytest.raises(ValueError, match=rf"`{key}\.shaft` is given; expected none"):
            sim.prepare(rust.load_config("test2", jets | {f"{key}.shaft": shaft}), dtype=np.float32)


@pytest.mark.parametrize("key", ["fuel", "ground"])
def test_what_this_engine_has_not_is_refused(key):
    config = scenario_config(rust.load_config("test2"))
    simulator = msgspec.structs.replace(config.simulator, **{key: object()})
    with pytest.raises(ValueError, match=rf"`simulator\.{key}` is given; expected none"):
        sim.prepare(msgspec.structs.replace(config, simulator=simulator), dtype=np.float32)


def test_what_no_monitor_would_find_is_flown():
    failure = {"disturbances.jets.failure": REFUSED["disturbances.jets.failure"]}
    changes = failure | {"controller.fault_detection.engines": False}
    sim.prepare(rust.load_config("test2_observer", changes), dtype=np.float32)


def test_a_known_limit_is_that_of_the_controllers_model():
    jets = {"thrust_limit_scale": 0.7, "limit_is_known": True}
    scenario, _ = sim.prepare(rust.load_config("test2_observer", {"disturbances.jets": jets}), dtype=np.float32)
    limits = (robot.jets.thrust_max for robot in (scenario.controller_model, scenario.plant.robot))
    np.testing.assert_allclose(next(limits), 0.7 * next(limits), rtol=1e-6)
