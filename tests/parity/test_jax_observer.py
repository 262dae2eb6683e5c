"""The observer in JAX against the Rust crate: over a flight, and its law."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.typed import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.control import tick
from jax_aero.control.estimate import disturbance_observer
from jax_aero.control.estimate.disturbance_observer import ObserverGains
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


def test_the_law_on_every_axis():
    """`w (1 − exp(−K_o t))`, as the crate's own test has it."""
    config = ObserverGains(*(np.float64(value) for value in (2.0, 5.0, 600.0, 100.0)))
    wrench = jnp.array([30.0, -50.0, 70.0, 3.0, -5.0, 7.0])
    rate = jnp.array([-11.0, 13.0, 17.0, -1.9, 2.3, 2.9])
    times = 0.01 * jnp.arange(200)

    def one(state, time):
        state = disturbance_observer.update(config, jnp.array(0.01), state, (rate + wrench) * time, rate)
        return state, state.wrench

    _, found = jax.lax.scan(one, disturbance_observer.start(wrench), times)
    gains = np.repeat([2.0, 5.0], 3)
    expected = wrench * -np.expm1(-np.outer(times, gains))
    # A momentum near 200 N s rounds by 3e-14 N s, a tick divides by 0.01 s.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_the_first_tick_has_no_slope():
    """Nothing is compared in it."""
    config = ObserverGains(*(np.float64(value) for value in (2.0, 5.0, 600.0, 100.0)))

    def total(momentum):
        state = disturbance_observer.update(
            config, jnp.array(0.01), disturbance_observer.start(momentum), momentum, 0.0 * momentum
        )
        return state.wrench.sum()

    assert np.array_equal(jax.grad(total)(jnp.ones(6)), np.zeros(6))
