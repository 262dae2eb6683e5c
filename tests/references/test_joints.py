"""What the crate finds of each joint is what the reference finds, in every tick of flights with a fault of one.

The controllers have no estimator, so that positions and velocities are those that the channels let pass.
"""

from __future__ import annotations

import pytest

from jax_aero import rust
from tests.references import flights, joints
from tests.references.joints import FREE, STUCK, WEAK, Joints

MISSION = {"forward_turbo": [[2.0, 4.0]], "yaw_left": [[2.5, 4.0]]}


def fly(changes, reference=Joints):
    """Return whether a flight agrees in every tick, and what is found in each, (ticks, n)."""
    detection = rust.load_config("robot")["controller"]["fault_detection"]["joints"]
    always = {
        "simulator.duration": 4.5,
        "controller.channels.jump": True,
        "controller.fault_detection.joints": detection,
        "mission": MISSION,
    }
    config = rust.load_config("test2_observer", always | changes)
    apart, found, _ = joints.follow(config, flights.fly(config), reference)
    return apart is None, found


def fault(joint, kind, start=2.2):
    return {"disturbances.joints": [{"joint": joint, "kind": kind, "start": start}]}


def outage(channel, start, duration):
    return {"channel": channel, "kind": "missing", "start": start, "duration": duration}


WRONG_AT_FIRST = outage("base_position", 0.0, 0.005) | {"kind": "wrong", "error": 0.4}
"""A flight begins again where its first position was wrong."""


FLIGHTS = {
    "nothing": ({}, 0),
    "a stuck joint": (fault("torso_pitch", "stuck"), STUCK),
    "a weak joint": (fault("torso_pitch", "weak"), WEAK),
    "a weak arm": (fault("l_shoulder_pitch", "weak"), WEAK),
    "a free arm": (fault("l_shoulder_pitch", "free"), FREE),
    "a free torso": (fault("torso_yaw", "free"), FREE),
    "a weak joint in gaps": (
        fault("torso_pitch", "weak")
        | {"disturbances.outages": [outage("joints", 2.25, 0.03), outage("base_rotation", 2.32, 0.02)]},
        WEAK,
    ),
    "a weak joint after a new beginning": (
        fault("torso_pitch", "weak") | {"disturbances.outages": [WRONG_AT_FIRST]},
        WEAK,
    ),
}


@pytest.mark.parametrize("flight", FLIGHTS)
def test_joints_are_what_the_reference_finds(flight):
    changes, kind = FLIGHTS[flight]
    agrees, found = fly(changes)
    assert agrees
    assert kind in found.max(axis=1)


def test_wrong_references_are_refused(monkeypatch):
    """Each of these numbers shows; those of displacements, and of how long m stays, do not in so few flights."""
    faulty = [FLIGHTS[name][0] for name in ("a stuck joint", "a weak joint in gaps", "a free arm")]
    wrong = {"FAST": 0.06, "SLOW": 0.8, "REACH": 2.0, "DISPLACED": 0.2, "SETTLING": 2.6, "PAUSE": 0.4}
    for name, value in (wrong | {"FREE_SHARE": 0.0, "WHOLE_SHARE": 0.5}).items():
        with monkeypatch.context() as patch:
            patch.setattr(joints, name, value)
            assert not all(fly(changes)[0] for changes in faulty), name
