"""Late and lost commands in JAX against the Rust crate: what acts, and a closed loop."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.config import ActuationConfig
from jax_aero.control.measurement import Measurement
from jax_aero.sim.actuation import LOST, actuation
from jax_aero.sim.plant import Acting
from jax_aero.types import State

EXPERIMENT = "test2_observer"
FIRST = Measurement(
    jnp.zeros(()), State(jnp.zeros(3), jnp.eye(3), jnp.zeros(1), jnp.zeros(7)), jnp.zeros(1), jnp.zeros(3)
)
"""Of a robot with one joint and one jet."""


@pytest.mark.parametrize(("delay", "substeps"), [(0, 1), (3, 1), (3, 4), (9, 4)])
def test_a_delay_of_some_steps_shifts_commands_by_them(delay, substeps):
    step, ticks = 0.01 / substeps, 8
    config = ActuationConfig(torque_delay=delay * step, thrust_delay=delay * step)
    way = actuation(config, 0.01, substeps, ticks)
    state, torques, rates = way.start(FIRST), [], []
    for tick in range(ticks):
        commanded = Acting(jnp.array([-float(tick)]), (jnp.array([float(tick)]),) * substeps)
        state, acting = way.act(state, commanded)
        torques += [float(torque[0]) for torque in acting.torques]
        rates.append(float(acting.thrust_rate[0]))
    expected = np.maximum(np.arange(ticks * substeps) - delay, 0) // substeps
    np.testing.assert_array_equal(torques, expected)
    np.testing.assert_array_equal(rates, -expected.reshape(ticks, substeps).mean(axis=1))


def test_lost_commands_are_drawn_before_the_flight():
    config = ActuationConfig(drop=0.3, jitter=0.02, thrust_delay=0.01, seed=7)
    way = actuation(config, 0.01, 1, 4000)
    lag = np.asarray(way.lag)
    lost = lag[:, 0] == LOST
    np.testing.assert_array_equal(lost, lag[:, 1] == LOST)
    assert abs(lost.mean() - 0.3) < 0.03
    np.testing.assert_array_equal(lag[~lost, 0], lag[~lost, 1] + 1)
    assert set(lag[~lost, 1]) == {0, 1, 2}
    assert way.ticks == 4


@pytest.mark.parametrize(
    ("substeps", "latency"), [(1, {"torque": 0.01, "thrust": 0.03}), (2, {"torque": 0.008, "thrust": 0.025})]
)
def test_a_flight_with_late_and_lost_commands(substeps, latency, fly_both):
    """Both engines draw the same delays and losses, compensate what is known, and the robot moves alike."""
    changes = {
        "controller.estimator": {"latency": latency},
        "simulator.duration": 0.6,
        "simulator.substeps": substeps,
        "simulator.actuation": {
            "thrust_delay": 0.03,
            "torque_delay": 0.01 / substeps,
            "jitter": 0.01,
            "drop": 0.2,
            "seed": 3,
        },
    }
    expected, _ = fly_both(rust.load_config(EXPERIMENT, changes))
    assert expected.outcome == "completed"
    at_once = rust.fly(rust.load_config(EXPERIMENT, {**changes, "simulator.actuation": {}}))
    assert np.abs(at_once.log["joint_position"] - expected.log["joint_position"]).max() > 1e-3


def test_late_commands_have_derivatives():
    """A torque counts after its delay, not before."""

    def second(torques):
        way = actuation(ActuationConfig(torque_delay=0.01), 0.01, 1, 3)
        state = way.start(FIRST)
        for torque in torques:
            state, acting = way.act(state, Acting(jnp.zeros(1), (torque[None],)))
        return acting.torques[0][0]

    np.testing.assert_array_equal(jax.grad(second)(jnp.array([1.0, 2.0, 3.0])), [0.0, 1.0, 0.0])
