"""Ticks, flights, gradients and environments where JAX promotes neither types nor ranks.

They are traced, not run, since promotion depends on types and shapes alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from jax_aero import rust, sim
from jax_aero.env import FlightEnv, Task

FLIGHTS: dict[str, dict[str, Any]] = {
    "test2_sensors": {
        "wind": {"profile": "turbulent", "velocity": [0.0, -10.0, 0.0], "std": [1.0, 1.0, 1.0]}
        | {"ramp_start": 0.0, "ramp_end": 1.0, "time_scale": 1.0, "seed": 1},
        "controller.estimator.latency": {"torque": 0.008, "thrust": 0.025},
        "simulator.substeps": 2,
        "simulator.actuation": {"torque_delay": 0.005, "drop": 0.1},
        "simulator.jets": {"dynamics": "throttled"},
        "disturbances.jets": {"thrust_limit_scale": 0.9, "limit_is_known": True},
    },
    "robustness_mpc": {},
    "min_time": {"disturbances.aero_estimate.scale": 0.9, "disturbances.model_error.mass_scale": 1.1},
    "test1_published": {},
}


@pytest.fixture(autouse=True)
def strict(x64: None) -> Iterator[None]:
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        yield


@pytest.mark.parametrize("name", FLIGHTS)
def test_ticks(name: str) -> None:
    jax.eval_shape(sim.step, *sim.prepare(rust.load_config(name, FLIGHTS[name])), jnp.array(0))


def test_the_gradient_of_a_flight() -> None:
    def cost(scenario: sim.Scenario, start: sim.FlightState) -> jax.Array:
        _, errors = sim.rollout(scenario, start, 3, lambda row: row["rotation_error"] ** 2)
        return jnp.sum(errors)

    jax.eval_shape(jax.grad(cost, allow_int=True), *sim.prepare(rust.load_config("test2")))


def test_an_environment() -> None:
    env = FlightEnv(Task(profile="gust"))
    jax.eval_shape(env.step, jax.eval_shape(env.reset, jax.random.key(0)), jnp.zeros(env.action_size))
