"""The observer in JAX against the Rust crate: over a flight, and its law."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.control import tick
from jax_aero.types import State

pytestmark = pytest.mark.usefixtures("x64")

TOLERANCE = 1e-10
LIMITS = {"gain_force": 4.0, "gain_moment": 7.0, "force_max": 8.0, "moment_max": 0.5}


@pytest.fixture(scope="module")
def flown():
    """A flight in which both limits are reached, as the crate flies it, with the ticks of its own controller."""
    changes = {
        "simulator.duration": 3.0,
        "wind.ramp_start": 0.2,
        "wind.ramp_end": 1.0,
        "controller.disturbance_observer": LIMITS,
    }
    table = rust.load_config("test1_observer", changes)
    log = rust.fly(table).log
    rotations = np.stack([rust.rotation_from_wxyz(wxyz) for wxyz in log["base_quaternion"]])
    velocity = np.concatenate([log["base_velocity"], log["joint_velocity"]], axis=1)
    states = State(log["base_position"], rotations, log["joint_position"], velocity)
    return table, (log["time"], states, log["thrust"], log["wind"])


def crate_wrenches(table, measurements):
    controller, found = rust.Controller(table), []
    times, states, thrusts, winds = measurements
    for index, time in enumerate(times):
        state = rust.State(*(part[index] for part in states))
        found.append(controller.tick(state, thrusts[index], winds[index], time).unmodelled_wrench)
    return np.array(found)


def test_a_flight(flown, agree):
    """The whole controller in both languages."""
    table, measurements = flown
    config = scenario_config(table)
    robot = load_robot(config.robot)
    params = tick.momentum_controller(config, robot)

    @jax.jit
    def scan(measurements):
        def one(memory, measurement):
            memory, _, _ = tick.tick(params, robot, memory, *measurement)
            return memory, memory.observer.wrench

        first = tick.init(params, robot, jax.tree.map(lambda leaf: leaf[0], measurements[1]))
        return jax.lax.scan(one, first, measurements)[1]

    ours = np.asarray(scan(jax.tree.map(jnp.asarray, measurements)))
    theirs = crate_wrenches(table, measurements)
    agree("unmodelled_wrench", ours, theirs, TOLERANCE)
    largest = np.abs(theirs).max(axis=0)
    assert largest[:3].max() == LIMITS["force_max"], "the limit of the force is reached"
    assert largest[3:].max() == LIMITS["moment_max"], "the limit of the moment is reached"
    assert np.ptp(theirs, axis=0).min() > 0.01
