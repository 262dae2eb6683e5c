"""Disturbances in JAX against the Rust crate: flights that share one compilation."""

from __future__ import annotations

import numpy as np
import pytest

from jax_aero import rust

TOLERANCE = 1e-9
"""Relative to the largest value of a signal over the flight; below one, absolute."""

# What all have, so that they are of one structure: engines with estimators, turbulence, another robot, factors.
COMMON = {
    "simulator.duration": 4.0,
    "disturbances.model_error.mass_scale": 1.01,
    "disturbances.aero_estimate.drag": 0.8,
    "disturbances.aero_estimate.normal": 1.2,
}
TURBULENT = {
    "profile": "turbulent",
    "velocity": [1.0, -5.0, 0.0],
    "ramp_start": 0.3,
    "ramp_end": 1.5,
    "std": [0.5, 1.0, 0.3],
    "time_scale": 0.7,
    "seed": 11,
}
CASES = {
    "thrusts that are noisy, a jet that fades": {
        "controller.aero_feedback.momentum_rate": "moment",
        "disturbances.jets.failure": {"jet": "chest_l_jet", "time": 3.4, "kind": "off", "decay": 0.4},
        "disturbances.jets.measurement_noise": {"std": 2.0, "seed": 3},
    },
    "a jet that is weaker than it seems": {
        "controller.aero_feedback.momentum_rate": "force",
        "disturbances.jets.force_scale": {"r_arm_jet": 0.98},
    },
    "weak jets that are known to be weak": {
        "disturbances.aero_estimate.links": {"chest": 0.3, "l_upper_leg": 1.6},
        "disturbances.jets": {"thrust_limit_scale": 0.62, "limit_is_known": True},
    },
    "a jet that fails at once": {
        "disturbances.jets.failure": {"jet": "r_arm_jet", "time": 3.8, "kind": "off"},
    },
}


@pytest.fixture(scope="module")
def flights(fly_with_last_bits):
    """Every case as both engines fly it, and as the crate flies it after a change of last bits."""
    configs = []
    for changes in CASES.values():
        table = rust.load_config("sensor_noise", COMMON | changes) | {"wind": TURBULENT}
        rust.check_config(table)
        configs.append(table)
    return dict(zip(CASES, fly_with_last_bits(configs, (1, 2, 5)), strict=True))


@pytest.mark.parametrize("case", CASES)
def test_a_disturbed_flight(case, flights, measured):
    """To 1e-9, and where a flight multiplies rounding (a jet that is lost) to ten times what last bits change of it."""
    ours, expected, changed = flights[case]
    assert ours.outcome == expected.outcome == "completed"
    assert ours.log.keys() == expected.log.keys()
    sensitivity = 0.0
    worst = {}
    for name in expected.log.keys() - {"qp_kkt", "qp_iterations"}:
        scale = max(1.0, difference(expected[name], 0.0 * expected[name]))
        worst[name] = difference(ours[name], expected[name]) / scale
        own = (difference(flight[name], expected[name]) / scale for flight in changed)
        sensitivity = max(sensitivity, *own)
    for name, error in worst.items():
        measured(f"{case}: {name}", error, TOLERANCE + 10.0 * sensitivity)
    for name in expected.summary.keys() - {"max_kkt", "max_qp_iterations"}:
        size = 1.0 + abs(expected.summary[name])
        measured(name, abs(ours.summary[name] - expected.summary[name]), (1e-8 + 10.0 * sensitivity) * size)


def difference(ours, theirs):
    """Return the greatest difference; what neither knows (NaN) is equal."""
    is_unknown = np.isnan(ours) & np.isnan(theirs)
    return float(np.max(np.abs(np.where(is_unknown, 0.0, ours - theirs)), initial=0.0))


def test_the_disturbances_are_felt(flights):
    """Each case is what it says, so that agreement means something."""
    fading, _, weak, dead = (expected for _, expected, _ in flights.values())
    assert fading["thrust"][-1, 2] < 0.3 * fading["thrust"][330, 2]
    assert np.all(weak["thrust"][:, :2].max(axis=0) == 0.62 * 160.0)
    assert np.all(dead["thrust"][385:, 1] == 0.0)
    assert np.std(fading["wind"][200:, 1]) > 0.2
