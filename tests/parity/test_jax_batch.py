"""Many flights of the JAX implementation at once, split over two devices, against the Rust crate."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
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
print(json.dumps([jax.device_count(), *([f.outcome, f.lost_time, f.lost_reason, f.summary] for f in flights)]))
"""


def test_flights_on_two_devices(measured):
    """Three flights on two devices, so that one flies twice and is dropped; the second one is lost, and ends there."""
    changes = {"simulator.duration": 1.5, "wind.ramp_start": 0.2, "wind.ramp_end": 0.8, "wind.velocity": [0, -6.0, 0]}
    tables = [
        rust.load_config("test2", changes | more)
        for more in ({}, {"simulator.fall.com_error": 0.02}, {"controller.momentum.c0": 40.0, "title": "softer"})
    ]
    # Two devices are made of one processor.
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
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
    for (outcome, lost_time, lost_reason, summary), flight in zip(ours, expected, strict=True):
        assert (outcome, lost_time, lost_reason) == (flight.outcome, flight.lost_time, flight.lost_reason)
        known = {name for name, figure in flight.summary.items() if not np.isnan(figure)}
        assert {name for name, figure in summary.items() if not np.isnan(figure)} == known
        for name in known - {"max_kkt", "max_qp_iterations"}:
            measured(name, abs(summary[name] - flight.summary[name]), 1e-9 * (1.0 + abs(flight.summary[name])))


@pytest.fixture
def counted(monkeypatch):
    """Replace a tick by one that computes next to nothing; return how often it was traced, each time for how many."""
    traced = []

    def step(scenario, state, tick):
        traced.append(scenario.controller.time_step.shape)
        plant = state.plant.robot
        zeros = jnp.zeros_like(plant.base_position)
        row = {"time": tick * scenario.plant.time_step, "com_position": scenario.wind.velocity}
        row |= {"rotation_error": zeros[0], "thrust": state.plant.jets.thrust, "joint_position": plant.joint_position}
        row |= {"joint_torque": plant.joint_position, "aero_force_sim": zeros[None], "aero_force_control": zeros[None]}
        row |= {"degraded_modes": zeros[0]}
        return state, row

    monkeypatch.setattr(batch, "step", step)
    monkeypatch.setattr(batch, "CHUNK", 2)
    compiled = batch._compile_chunk
    compiled.cache_clear()
    yield traced
    compiled.cache_clear()


def flights(*changes):
    for change in changes:
        yield rust.load_config("test2", {"simulator.duration": 0.03} | change)


def test_what_differs_does_not_decide_what_compiles(counted):
    """One compilation for every batch of a structure, whichever numbers differ, and for each chunk and part of it."""
    winds = [{"wind.velocity": [0.0, -speed, 0.0]} for speed in (1.0, 2.0, 3.0)]
    found = sim.fly_batch(flights(*winds), full_log=True, most_together=4)
    assert [flight["com_position"][0, 1] for flight in found] == [-1.0, -2.0, -3.0]
    assert [len(flight["time"]) for flight in found] == [4, 4, 4]  # 3 ticks and the end, in chunks of 2
    sim.fly_batch(flights({}, {}, {}), full_log=True, most_together=4)
    sim.fly_batch(
        flights({}, {"controller.momentum.c0": 40.0}, {"simulator.fall.com_error": 0.1}), full_log=True, most_together=4
    )
    sim.fly_batch(flights(*winds, *winds, {}), full_log=True, most_together=4)
    assert len(counted) == 1


def test_flights_of_another_structure_fly_apart(counted):
    """Another switch is another structure, and so is a sensor that looks further back."""
    sensors = [{"simulator.sensors": {"base_position": {"delay": delay}}} for delay in (0.01, 0.03, 0.03)]
    found = sim.fly_batch(flights({}, {"controller.lever_arm": "unrotated"}, {}, *sensors), full_log=True)
    assert len(found) == 6
    assert len(counted) == 4


def test_the_desired_posture_is_the_measured_one(counted):
    """Not the true one, which encoders with steps do not see."""
    coarse = {"simulator.sensors": {"joints": {"resolution": 0.01}}}
    (found,) = sim.fly_batch(flights(coarse))
    expected = rust.fly(*flights(coarse)).joint_setpoint
    np.testing.assert_allclose(found.joint_setpoint, expected, rtol=0, atol=1e-15)


def test_numbers_go_to_the_device_once(counted, monkeypatch):
    """Every chunk but the first gets arrays that are there already."""
    sim.fly_batch(flights({}, {}), full_log=True)
    compiled = batch._compile_chunk
    kinds = []

    def compile_recorded(*static):
        fly = compiled(*static)

        def call(leaves, state, first):
            kinds.extend(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves((leaves, state)))
            return fly(leaves, state, first)

        return call

    monkeypatch.setattr(batch, "_compile_chunk", compile_recorded)
    sim.fly_batch(flights({}, {}), full_log=True)
    assert kinds
    assert all(kinds)


def test_a_network_is_read_once_and_shared(counted, monkeypatch):
    """Its weights are neither read nor copied for every flight."""
    read = []
    load = batch.load_network

    def read_and_count(card, robot):
        read.append(card)
        return load(card, robot)

    monkeypatch.setattr(batch, "load_network", read_and_count)
    network = {
        "model": "network",
        "card": str(next((ROOT / "configs/aero/networks").rglob("*.json"))),
        "air_density": 1.225,
    }
    tables = list(
        flights(
            {"simulator.aero": network, "controller.aero": network},
            {"simulator.aero": network, "controller.aero": network},
        )
    )
    with jax.enable_x64(True):
        groups = batch.group_flights(tables)
    assert len(read) == 1
    (group,) = groups
    scenario = jax.tree.unflatten(group.structure, group.is_shared)
    assert all(jax.tree.leaves((scenario.plant.aero.network, scenario.controller.aero.network, scenario.plant.robot)))
    assert not any(jax.tree.leaves((scenario.controller.momentum, scenario.wind, scenario.plant.jets)))


def test_a_flight_that_cannot_be_flown_is_named():
    table = rust.load_config("test2")
    spoilt = table | {"wind": {"profile": "storm"}}
    with pytest.raises(ValueError, match=r'flight 1 of the batch: .*`wind.profile` is "storm"'):
        sim.fly_batch([table, spoilt])


@pytest.mark.parametrize("most", [0, -1])
def test_a_number_of_flights_is_positive(most):
    with pytest.raises(ValueError, match=rf"`most_together` is {most}; expected at least 1"):
        sim.fly_batch([], most_together=most)


def test_the_size_of_a_batch():
    """At most a seventh flies in vain beyond eight flights; parts of a batch are of one size."""
    sizes = [batch.batch_size(n, 1, 64) for n in (1, 2, 3, 5, 9, 48, 50, 64, 65, 100, 640)]
    assert sizes == [1, 2, 4, 8, 16, 48, 56, 64, 40, 56, 64]
    assert batch.batch_size(3, 2, 64) == 4
    assert batch.batch_size(7, 1, 4) == 4
