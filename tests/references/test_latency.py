"""The crate's latencies are the reference's in every tick, and so is whether commands are late."""

import numpy as np
import pytest

from jax_aero import rust
from tests.references import latency
from tests.references.latency import Latencies

TOLERANCE = 1e-12
"""Difference of latencies by rounding: 1e-16 of 0.3 s, times 300 ticks of sums and a curvature of 1/30 of L [s]."""


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
    """Return latencies and findings of every tick of a flight: of the reference, and of the crate."""
    config = rust.load_config(name, {"simulator.duration": 3.5} | changes)
    judge, flight = reference(config, rust.Robot(config["robot"])), rust.Flight(config)
    ours, theirs = [], []
    while not flight.has_ended:
        measured = flight.measurement
        flight.step()
        found, is_late = judge.measure(measured, flight.last)
        ours.append([*found, is_late])
        theirs.append([*flight.last.measured_latency, "late" in flight.last.degraded_modes])
    return np.array(ours), np.array(theirs), flight


def agree(ours, theirs) -> bool:
    return np.allclose(ours, theirs, rtol=0.0, atol=TOLERANCE, equal_nan=True)


@pytest.mark.parametrize("flight", FLIGHTS)
def test_latencies_are_those_of_the_reference(flight):
    ours, theirs, flown = fly(*FLIGHTS[flight])
    assert agree(ours, theirs)
    assert np.isfinite(theirs[:, 0]).sum() > 100
    late = bool(theirs[:, 2].any())
    assert late == ("late" in flight or FLIGHTS[flight][1].items() >= LATE.items())
    if flight == "late thrusts":
        assert np.isfinite(theirs[:, 1]).any()
    if flight == "a stuck joint":
        assert 1 in flown.last.joint_condition


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
    assert agree(*fly("robot", few)[:2])
    for wrong in (without_friction, of_this_tick):
        assert not agree(*fly("robot", few, wrong)[:2])
    for name, value in {"MEMORY": 2.9, "DELAY_MAX": 0.26, "SETTLING": 3.2, "SLIP": 0.03}.items():
        with monkeypatch.context() as patch:
            patch.setattr(latency, name, value)
            assert not agree(*fly("robot", few)[:2]), name
