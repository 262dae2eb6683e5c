"""Two faults at once, of every pair of kinds, drawn: each is found as alone, and each detector as its reference finds.

A reference takes nothing of what another detector finds in the same tick, so the order of detectors has no meaning.
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
    "a weak arm": {"joint_limited"},
    "late torques": {"late"},
    "no momentum": {"joints_predicted", "rotation_predicted", "velocity_predicted"},
    "no thrusts": {"thrust_modelled"},
    "no position": {"position_predicted"},
    "no wind": {"wind_held"},
}
"""What says that a fault of each kind is found."""

WITHIN = {"a stop": 0.1, "a wrong sensor": 0.1, "a weak arm": 0.6, "late torques": 1.1}
"""Time in which a fault of these kinds is found where the momentum is measured [s]; an outage is found at once."""


def fault(kind: str, rng: np.random.Generator, start: float) -> dict[str, Any]:
    """Return a fault of a kind that begins then [s]."""
    jet = str(rng.choice(JETS))
    channels = {"no momentum": ["joints", "base_rotation", "base_velocity"], "no thrusts": ["thrust"]}
    channels |= {"no position": ["base_position"], "no wind": ["wind"]}
    if kind == "a stop":
        return {"disturbances.jets.failure": {"jet": jet, "kind": "off", "time": start}}
    if kind == "a weak arm":
        joint = str(rng.choice(["l_shoulder_pitch", "r_shoulder_pitch"]))
        return {"disturbances.joints": [{"joint": joint, "kind": "weak", "start": start}]}
    if kind == "late torques":
        return {"simulator.actuation.torque_delay": 0.01}
    outage = {"start": start, "duration": GAP, "kind": "missing"}
    if kind == "a wrong sensor":
        error = float(rng.choice([-1.0, 1.0]) * rng.uniform(25.0, 60.0))
        outage = {"start": start, "kind": "wrong", "channel": "thrust", "jet": jet, "error": error}
    else:
        outage |= {"channel": str(rng.choice(channels[kind]))}
    return {"disturbances.outages": [outage]}


@pytest.mark.parametrize("pair", [*itertools.combinations(MODES, 2)], ids=" and ".join)
def test_two_faults_are_found_as_each_alone(pair):
    rng = np.random.default_rng([*map(ord, "".join(pair))])
    starts = {kind: 0.0 if kind == "late torques" else float(rng.uniform(2.2, 2.6)) for kind in pair}
    first, second = (fault(kind, rng, starts[kind]) for kind in pair)
    both = {"disturbances.outages": [of for one in (first, second) for of in one.get("disturbances.outages", [])]}
    always = {
        "simulator.duration": 3.3,
        "simulator.ground_height": -10.0,
        "mission": MISSION,
        "controller.channels.jump": True,
        "controller.fault_detection": rust.load_config("robot")["controller"]["fault_detection"],
    }
    config = rust.load_config("test2_observer", always | first | second | both)
    ticks = flights.fly(config)
    apart, _, shares = joints.follow(config, ticks)
    assert apart is None
    assert engines.follow(config, ticks)[0] is None
    assert latency.follow(config, ticks, shares=shares)[0]
    assert limits.follow(config, ticks, shares) == []
    if "a stop" not in pair:  # in a descent the set-point that is given is not the one that is said
        assert tracking_error.follow(config, ticks)[0]
    for kind in pair:
        told = [each.measured.time for each in ticks if MODES[kind] & {*each.tick.degraded_modes}]
        late = min((time for time in told if time >= starts[kind]), default=np.inf) - starts[kind]
        waits = GAP + PAUSE if "no momentum" in pair else 0.0
        assert late <= (WITHIN[kind] + waits if kind in WITHIN else config["controller"]["time_step"]), kind
