"""Many flights in JAX at once, split over two devices, against the Rust crate."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.sim import batch

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import json, sys
import jax
from jax_aero import sim
flights = sim.fly_batch(json.load(sys.stdin), lambda done, total: print(done, total))
print(json.dumps([jax.device_count(), *([f.outcome, f.fall_time, f.fall_reason, f.summary] for f in flights)]))
"""


def test_flights_on_two_devices():
    """Three flights on two devices, so that one flies twice and is dropped; the second one is lost, and ends there."""
    changes = {"simulator.duration": 1.5, "wind.ramp_start": 0.2, "wind.ramp_end": 0.8, "wind.velocity": [0, -6.0, 0]}
    tables = [
        rust.load_config(ROOT / "configs" / "experiments" / "test2.toml", changes | more)
        for more in ({}, {"simulator.fall.com_error": 0.02}, {"controller.momentum.c0": 40.0, "title": "softer"})
    ]
    # Two devices are made of one processor; compiled without optimisation, which takes half the time.
    flags = os.environ.get("XLA_FLAGS", "")
    flags += " --xla_force_host_platform_device_count=2 --xla_backend_optimization_level=0"
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        input=json.dumps(tables),
        env=os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    devices, *ours = json.loads(done[-1])
    assert devices == 2
    assert done[-2] == "3 3"
    expected = rust.fly_batch(tables)
    assert [flight.outcome for flight in expected] == ["completed", "fell", "completed"]
    for (outcome, fall_time, fall_reason, summary), flight in zip(ours, expected, strict=True):
        assert (outcome, fall_time, fall_reason) == (flight.outcome, flight.fall_time, flight.fall_reason)
        for name in flight.summary.keys() - {"max_kkt", "max_qp_iterations"}:
            assert summary[name] == pytest.approx(flight.summary[name], rel=1e-9, abs=1e-9), name


def test_flights_of_one_structure_fly_together(monkeypatch):
    """Flights are sorted by structure and length; what is the same in all of them is not copied."""
    names = ("test2", "test1", "test2", "test2_published")
    tables = [
        rust.load_config(ROOT / "configs" / "experiments" / f"{name}.toml", {"wind.velocity": [0, -speed, 0]})
        for speed, name in enumerate(names)
    ]
    asked = []

    def fly(group, shared, size, full_log, devices):
        asked.append((group.places, size, shared.count(False)))
        return [f"flight {place}" for place in group.places]

    def prepare(config, robot, backend):
        return (config.controller, config.wind), config.simulator.initial

    # Structure is all that counts here; a real flight of each would compile.
    monkeypatch.setattr(batch, "prepare", prepare)
    monkeypatch.setattr(batch, "_fly_together", fly)
    assert sim.fly_batch(tables) == [f"flight {place}" for place in range(4)]
    assert asked == [([0, 2], 2, 1), ([1], 1, 0), ([3], 1, 0)]
    asked.clear()
    sim.fly_batch(tables[::2] * 3, most_together=4)
    assert asked == [([0, 1, 2, 3], 4, 1), ([4, 5], 4, 1)]


def test_a_flight_that_cannot_be_flown_is_named():
    table = rust.load_config(ROOT / "configs" / "experiments" / "test2.toml")
    spoilt = table | {"wind": {"profile": "storm"}}
    with pytest.raises(ValueError, match=r"flight 1 of the batch: `wind.profile` is 'storm'"):
        sim.fly_batch([table, spoilt])


def test_the_places_of_a_batch():
    assert [batch._power_of_two(n) for n in (1, 2, 3, 4, 5, 64, 65)] == [1, 2, 4, 4, 8, 64, 128]
    same, different = np.ones(3), np.zeros(3)
    assert batch._shared([(same, same), (same, different)]) == (True, False)
