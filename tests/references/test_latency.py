"""The crate's latencies are the reference's in every tick, and so is whether commands are late."""

import numpy as np
import pytest

from jax_aero import rust
from tests.references import flights, latency
from tests.references.latency import Latencies


def outage(channel: str, kind: str, start: float, duration: float, error: float = 1.0) -> dict:
    return {"channel": channel, "kind": kind, "start": start, "duration": duration, "error": error}


LATE = {"simulator.actuation.torque_delay": 0.02}
IDEAL = {
    "simulator.jets.dynamics": "ideal",
    "controller.mpc.nonlinear_descent": False,
    "controller.jet_dynamics": "ideal",
    "controller.fault_detection.latency.thrust_max": 0.05,
    "disturbances.pushes": [{"body": "root_link", "force": [0.0, 150.0, 100.0], "start": 0.8, "duration": 0.2}],
}
STUCK = {
    "disturbances.joints": [{"joint": "torso_pitch", "kind": "stuck", "start": 2.2}],
    "mission": {"forward_turbo": [[2.0, 4.0]], "yaw_left": [[2.5, 4.0]]},
    "simulator.duration": 5.0,
}
FLIGHTS = {
    "in time": ("robot", {}),
    "late torques": ("robot", LATE),
    "another robot": ("mk3_robot", {}),
    "half a tick": ("robot", {"controller.estimator.latency.torque": 0.015}),
    "old joints": ("robot", {"controller.estimator.joint_position.delay": 0.01}),
    "late thrusts": ("robot", IDEAL | {"simulator.actuation.thrust_delay": 0.15}),
    "gaps": (
        "robot",
        LATE
        | {
            "disturbances.outages": [
                outage("joints", "missing", 1.0, 0.035),
                outage("base_rotation", "missing", 1.7, 0.1),
                outage("thrust", "missing", 2.0, 0.05),
                outage("base_rotation", "missing", 2.4, 0.3),
            ]
        },
    ),
    "wrong velocities": ("robot", LATE | {"disturbances.outages": [outage("base_velocity", "wrong", 1.2, 0.05, 9.0)]}),
    "a stuck joint": ("robot", LATE | STUCK),
}


def fly(name: str, changes: dict, reference=Latencies):
    """Return whether a flight agrees, the latencies and findings of each of its ticks, and the ticks."""
    config = rust.load_config(name, {"simulator.duration": 3.5} | changes)
    ticks = flights.fly(config)
    return *latency.follow(config, ticks, reference), ticks


@pytest.mark.parametrize("flight", FLIGHTS)
def test_latencies_are_those_of_the_reference(flight):
    agrees, theirs, ticks = fly(*FLIGHTS[flight])
    assert agrees
    assert np.isfinite(theirs[:, 0]).sum() > 100
    late = bool(theirs[:, 2].any())
    assert late == ("late" in flight or FLIGHTS[flight][1].items() >= LATE.items())
    if flight == "late thrusts":
        assert np.isfinite(theirs[:, 1]).any()
    if flight == "a stuck joint":
        assert 1 in ticks[-1].tick.joint_condition


def without_friction(config, robot):
    found = Latencies(config, robot)
    found.friction[:] = 0.0
    return found


def of_this_tick(config, robot):
    found = Latencies(config, robot)
    found.lead = 0
    return found


def test_wrong_references_are_refused(monkeypatch):
    """Each mistake shows in a flight of a second; so it would in the crate."""
    few = {"simulator.duration": 1.0}
    assert fly("robot", few)[0]
    for wrong in (without_friction, of_this_tick):
        assert not fly("robot", few, wrong)[0]
    for name, value in {"MEMORY": 2.9, "DELAY_MAX": 0.26, "SETTLING": 3.2, "SLIP": 0.03}.items():
        with monkeypatch.context() as patch:
            patch.setattr(latency, name, value)
            assert not fly("robot", few)[0], name
