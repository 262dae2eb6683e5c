"""Heights above the ground in flight: when a step is accepted, and that nothing depends on them before a descent."""

import numpy as np
import pytest

from jax_aero import rust

HOVER = {"mission": {}, "simulator.ground_height": -2.0}
START = 2.0
"""When the ground seems to rise by 0.5 m [s]."""


def flown(height, duration=START + 1.0, **changes):
    keys = HOVER | {"simulator.sensors.height": height, "simulator.duration": duration} | changes
    return rust.fly(rust.load_config("robot", keys)).log


@pytest.mark.parametrize("period", [0.0, 0.05])
def test_a_step_of_the_ground_is_accepted_when_the_gate_has_grown_to_it(period):
    """`0.3 (1 + A) = 0.5` of M102 is at an age of A = 0.67 s, since the last height, which is up to a period older."""
    step = {"channel": "height", "start": START, "kind": "wrong", "error": -0.5}
    log = flown({"period": period}, **{"disturbances.outages": [step]})
    held = log["time"][(log["degraded_modes"].astype(int) & rust.MODES["ground_held"]) > 0]
    assert held[0] > START
    assert held[-1] - START == pytest.approx(0.66, abs=0.02 + period)


def test_a_robot_that_does_not_descend_does_not_use_its_height():
    one, other = (flown({"bias": bias}, duration=1.0) for bias in (0.0, -0.5))
    assert (other["raw_height"][1:] < one["raw_height"][1:]).all()
    for name in ("base_position", "joint_torque", "thrust"):
        assert np.array_equal(one[name], other[name]), name
