"""Late and lost commands in JAX against the Rust crate: what acts, and a closed loop."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.config import ActuationConfig
from jax_aero.sim import actuation

EXPERIMENT = "test2_observer"


@pytest.mark.parametrize(("delay", "substeps"), [(0, 1), (3, 1), (3, 4), (9, 4)])
def test_a_delay_of_some_steps_shifts_commands_by_them(delay, substeps):
    step, ticks = 0.01 / substeps, 8
    config = ActuationConfig(torque_delay=delay * step, thrust_delay=delay * step)
    way, state = actuation.start(config, 0.01, substeps, ticks, jets=1, joints=1)
    torques, rates = [], []
    for tick in range(ticks):
        sent = actuation.send(way, state, jnp.array([-float(tick)]), jnp.array([float(tick)]))
        torques += [float(actuation.acting(sent.torque, substep, substeps)[0]) for substep in range(substeps)]
        rates.append(float(actuation.mean(sent.thrust_rate, substeps)[0]))
        state = sent._replace(
            thrust_rate=actuation.hold(sent.thrust_rate, substeps), torque=actuation.hold(sent.torque, substeps)
        )
    expected = np.maximum(np.arange(ticks * substeps) - delay, 0) // substeps
    np.testing.assert_array_equal(torques, expected)
    np.testing.assert_array_equal(rates, -expected.reshape(ticks, substeps).mean(axis=1))


def test_lost_commands_are_drawn_before_the_flight():
    config = ActuationConfig(drop=0.3, jitter=0.02, thrust_delay=0.01, seed=7)
    way, _ = actuation.start(config, 0.01, 1, 4000, jets=4, joints=23)
    lag = np.asarray(way.lag)
    lost = lag[:, 0] == actuation.LOST
    np.testing.assert_array_equal(lost, lag[:, 1] == actuation.LOST)
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
        way, state = actuation.start(ActuationConfig(torque_delay=0.01), 0.01, 1, 3, jets=1, joints=1)
        for torque in torques:
            sent = actuation.send(way, state, jnp.zeros(1), torque[None])
            state = sent._replace(torque=actuation.hold(sent.torque, 1))
        return state.torque.held[0]

    np.testing.assert_array_equal(jax.grad(second)(jnp.array([1.0, 2.0, 3.0])), [0.0, 1.0, 0.0])
