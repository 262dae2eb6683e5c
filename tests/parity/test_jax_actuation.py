"""Late and lost commands in JAX against the Rust crate: what acts, and a closed loop."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.config import ActuationConfig
from jax_aero.control.measurement import Measurement
from jax_aero.sim.actuation import actuation
from jax_aero.sim.plant import Acting
from jax_aero.types import State

EXPERIMENT = "test2_observer"
FIRST = Measurement(
    jnp.zeros(()), State(jnp.zeros(3), jnp.eye(3), jnp.zeros(1), jnp.zeros(7)), jnp.zeros(1), jnp.zeros(3)
)
"""Of a robot with one joint and one jet."""


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
            state, acting = way.act(state, Acting(jnp.zeros(1), torque[None, None]))
        return acting.torques[0, 0]

    np.testing.assert_array_equal(jax.grad(second)(jnp.array([1.0, 2.0, 3.0])), [0.0, 1.0, 0.0])
