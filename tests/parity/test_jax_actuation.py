"""Late and lost commands in JAX against the Rust crate: what acts, and a closed loop."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero.config import ActuationConfig
from jax_aero.control.measurement import Measurement
from jax_aero.sim.actuation import actuation
from jax_aero.sim.plant import Acting
from jax_aero.types import State

FIRST = Measurement(
    jnp.zeros(()), State(jnp.zeros(3), jnp.eye(3), jnp.zeros(1), jnp.zeros(7)), jnp.zeros(1), jnp.zeros(3)
)
"""Of a robot with one joint and one jet."""


def test_late_commands_have_derivatives():
    """A torque counts after its delay, not before."""

    def second(torques):
        way = actuation(ActuationConfig(torque_delay=0.01), 0.01, 1, 3)
        state = way.start(FIRST)
        for torque in torques:
            state, acting = way.act(state, Acting(jnp.zeros(1), torque[None, None]))
        return acting.torques[0, 0]

    np.testing.assert_array_equal(jax.grad(second)(jnp.array([1.0, 2.0, 3.0])), [0.0, 1.0, 0.0])
