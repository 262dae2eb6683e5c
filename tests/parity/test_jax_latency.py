"""Latencies that are measured in flight: JAX against the Rust crate."""

from __future__ import annotations

import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.control.modes import MODES

HALF = {"torque": 0.005, "thrust": 0.005}
EXACT_STEPS = {"simulator.sensors.joints.resolution": 0.0}
"""Steps of encoders multiply rounding."""

FLIGHTS = {
    "unknown": (
        "test2_observer",
        {
            "controller.latency_monitor.torque_max": 0.007,
            "simulator.actuation": {"torque_delay": 0.01, "thrust_delay": 0.02},
        },
        True,
    ),
    "a gap": (
        "test2_observer",
        {
            "controller.estimator.latency": HALF,
            "simulator.actuation": {"torque_delay": 0.005, "thrust_delay": 0.0},
            "simulator.substeps": 2,
            "disturbances.outages": [
                {"channel": "joints", "start": 0.904, "duration": 0.05, "kind": "missing"},
                {"channel": "thrust", "start": 1.404, "duration": 0.05, "kind": "missing"},
            ],
        },
        False,
    ),
    "sensors": ("test2_sensors", {**EXACT_STEPS, "simulator.actuation": {"torque_delay": 0.0}}, False),
    "two rates": (
        "test2_sensors",
        {**EXACT_STEPS, "controller.torque.steps": 2, "simulator.substeps": 2, "controller.estimator.latency": HALF},
        False,
    ),
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_both_engines_measure_the_same(name, measured):
    experiment, changes, is_late = FLIGHTS[name]
    changes = {**changes, "simulator.duration": 1.8}
    table = rust.load_config(experiment, changes)
    theirs, ours = rust.fly(table), sim.fly(table)
    np.testing.assert_array_equal(ours.log["degraded_modes"], theirs.log["degraded_modes"])
    assert (theirs.log["degraded_modes"].astype(int) & MODES["late"]).any() == is_late
    for signal in ("measured_torque_latency", "measured_thrust_latency"):
        known = np.isfinite(theirs.log[signal])
        np.testing.assert_array_equal(np.isfinite(ours.log[signal]), known)
        assert known.any() or (name, signal) == ("a gap", "measured_thrust_latency")
        difference = np.abs(ours.log[signal] - theirs.log[signal])[known].max(initial=0.0)
        measured(signal, difference, 1e-7, because="rounding of a flight, divided by what little a delay changes")
