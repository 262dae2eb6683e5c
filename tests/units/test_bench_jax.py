"""The benchmark of the JAX twin measures functions of today: each of its cases can be traced."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.tools import bench_jax
from jax_aero import rust, sim
from jax_aero.base.typed_config import scenario_config
from jax_aero.types import State

pytestmark = pytest.mark.usefixtures("x64")


def test_the_cases_can_be_traced():
    scenario, start = sim.prepare(scenario_config(rust.load_config("test2")))
    cases = list(bench_jax.cases(scenario, start))
    for case in cases:
        jax.eval_shape(case.function, case.shared, case.samples[0])
    assert len(cases) == 5


def test_samples_are_spread_in_turns():
    """With differences of the velocities of a state, not of other numbers."""
    state = State(jnp.zeros(3), jnp.eye(3), jnp.zeros(2), jnp.zeros(8))
    states, ticks = bench_jax._spread([(state, jnp.asarray(4)), (state, jnp.asarray(5))], 5)
    assert ticks.tolist() == [4, 5, 4, 5, 4]
    assert states.velocity.shape == (5, 8)
    assert np.all(np.std(states.velocity, axis=0) > 0.0)
    assert not np.any(states.joint_position)
