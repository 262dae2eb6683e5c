"""Two faults at once, of every pair of kinds, drawn: each is found as alone, and each detector as its reference finds.

A reference takes nothing of what another detector finds in the same tick, so the order of detectors has no meaning.

Some faults of joints are not found before the robot is lost: by M143 a joint is suspected only while its unexplained
torque is more than τ_0 and what the unexplained force and moment of the whole robot account for. These are too great
beside a stopped engine, and for a stuck joint beside a free arm (`UNFOUND`). Not drawn are a stuck `torso_yaw` or
`torso_roll`, whose torques mostly stay below τ_0 in this flight, and a free torso, with which the robot turns over
before its suspicion has lasted for `confirmation`. An arm that is freed while its stop holds it is not found either.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from jax_aero import rust
from tests.references import engines, flights, joints, latency, limits, tracking_error

MISSION = {"forward_turbo": [[2.0, 4.0]], "yaw_left": [[2.5, 4.0]]}
JETS = ("l_arm_jet", "r_arm_jet", "chest_l_jet", "chest_r_jet")
GAP, PAUSE = 0.1, 0.2
"""Duration of an outage, and of what joints wait after it [s]."""

MODES = {
    "a stop": {"engine_limited", "engine_stopped"},
    "a wrong sensor": {"thrust_modelled"},
    "late torques": {"late"},
    "no momentum": {"joints_predicted", "rotation_predicted", "velocity_predicted"},
    "no thrusts": {"thrust_modelled"},
    "no position": {"position_predicted"},
    "no wind": {"wind_held"},
}
"""What says that a fault of each kind is found."""

ARMS = ["l_shoulder_pitch", "r_shoulder_pitch"]
JOINTS = {
    "a weak arm": ("weak", joints.WEAK, ARMS),
    "a stuck torso": ("stuck", joints.STUCK, ["torso_pitch"]),
    "a free arm": ("free", joints.FREE, ["l_shoulder_pitch"]),
}
"""Kind and condition of each fault of a joint, and the joints that may have it."""

UNFOUND = {"a stuck torso": {"a stop", "a free arm"}, "a free arm": {"a stop"}}
"""Beside which faults one is not found."""

WITHIN = {"a stop": 0.1, "a wrong sensor": 0.1, "a weak arm": 0.6, "late torques": 1.1}
WITHIN |= {"a stuck torso": 1.8, "a free arm": 0.4}
"""Time in which a fault of these kinds is found where the momentum is measured [s]; an outage is found at once. A joint
that is stuck is found once it is commanded to move."""

KINDS = [*MODES, *JOINTS]

LATER = 0.3
"""How much after the other fault an arm is freed, since the robot is lost within a second of it [s]."""


def fault(kind: str, rng: np.random.Generator, start: float) -> dict[str, Any]:
    """Return a fault of a kind that begins then [s]."""
    jet = str(rng.choice(JETS))
    channels = {"no momentum": ["joints", "base_rotation", "base_velocity"], "no thrusts": ["thrust"]}
    channels |= {"no position": ["base_position"], "no wind": ["wind"]}
    if kind == "a stop":
        return {"disturbances.jets.failure": {"jet": jet, "kind": "off", "time": start}}
    if kind in JOINTS:
        name, _, places = JOINTS[kind]
        return {"disturbances.joints": [{"joint": str(rng.choice(places)), "kind": name, "start": start}]}
    if kind == "late torques":
        return {"simulator.actuation.torque_delay": 0.01}
    outage = {"start": start, "duration": GAP, "kind": "missing"}
    if kind == "a wrong sensor":
        error = float(rng.choice([-1.0, 1.0]) * rng.uniform(25.0, 60.0))
        outage = {"start": start, "kind": "wrong", "channel": "thrust", "jet": jet, "error": error}
    else:
        outage |= {"channel": str(rng.choice(channels[kind]))}
    return {"disturbances.outages": [outage]}


def says(kind: str, its: dict[str, Any], tick: rust.Tick, names: list[str]) -> bool:
    """Return whether a tick says that a fault is found."""
    if kind in JOINTS:
        (one,) = its["disturbances.joints"]
        return bool(tick.joint_condition[names.index(one["joint"])] == JOINTS[kind][1])
    return bool(MODES[kind] & {*tick.degraded_modes})


@pytest.mark.parametrize("pair", [*itertools.combinations(KINDS, 2)], ids=" and ".join)
def test_two_faults_are_found_as_each_alone(pair):
    rng = np.random.default_rng([*map(ord, "".join(pair))])
    starts = {kind: 0.0 if kind == "late torques" else float(rng.uniform(2.2, 2.6)) for kind in pair}
    if "a free arm" in pair:
        starts["a free arm"] = max(starts.values()) + LATER
    first, second = (fault(kind, rng, starts[kind]) for kind in pair)
    both = {
        f"disturbances.{name}": [of for one in (first, second) for of in one.get(f"disturbances.{name}", [])]
        for name in ("outages", "joints")
    }
    always = {
        "simulator.duration": 4.5 if "a stuck torso" in pair else 3.3,
        "simulator.ground_height": -10.0,
        "mission": MISSION,
        "controller.channels.jump": True,
        "controller.fault_detection": rust.load_config("robot")["controller"]["fault_detection"],
    }
    config = rust.load_config("test2_observer", always | first | second | both)
    ticks, names = flights.fly(config), rust.Robot(config["robot"]).joint_names
    apart, _, shares = joints.follow(config, ticks)
    assert apart is None
    assert engines.follow(config, ticks)[0] is None
    assert latency.follow(config, ticks, shares=shares)[0]
    assert limits.follow(config, ticks, shares) == []
    if "a stop" not in pair:  # in a descent the set-point that is given is not the one that is said
        assert tracking_error.follow(config, ticks)[0]
    for kind, its in zip(pair, (first, second), strict=True):
        if UNFOUND.get(kind, set()) & {*pair}:
            continue
        found = [each.measured.time for each in ticks if says(kind, its, each.tick, names)]
        late = min((time for time in found if time >= starts[kind]), default=np.inf) - starts[kind]
        waits = GAP + PAUSE if "no momentum" in pair else 0.0
        assert late <= (WITHIN[kind] + waits if kind in WITHIN else config["controller"]["time_step"]), kind
