"""References of the JAX floor against the Rust crate's, tick by tick, for every envelope."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import reference
from jax_aero.config import flight_config
from jax_aero.control import references

pytestmark = pytest.mark.usefixtures("x64")

EXPERIMENTS = Path(__file__).resolve().parents[2] / "configs" / "experiments"
START = (np.array([-0.00365, 0.00041, 0.751881]), np.array([0.0, 0.0, np.pi]))
# Positions of 80 m are rounded to 1e-14; three differentiations at T = 1.5 s and 5 ms make 1e-12 of it.
TOLERANCE = {"com_jerk": 1e-11}


@pytest.mark.parametrize("name", ["test2", "closed_circuit", "closed_circuit_no_turbo"])
def test_references(name, agree):
    table = reference.load_config(EXPERIMENTS / f"{name}.toml")
    config = flight_config(table)

    @jax.jit(static_argnums=1)
    def fly(config, n_ticks):
        params = references.reference_params(config.controller.references, jnp.array(config.simulator.time_step))
        return references.trajectory(params, config.envelope, *START, n_ticks)

    found = jax.device_get(fly(config, config.simulator.n_ticks + 1))
    ours = found.reference._asdict() | {"raw_position": found.raw_position, "raw_rpy": found.raw_rpy}
    theirs = reference.reference_trajectory(table, *START)
    assert ours.keys() == theirs.keys()
    for signal, expected in theirs.items():
        agree(signal, ours[signal], expected, TOLERANCE.get(signal, 1e-12))


def test_float32_references_stay_within_a_millimetre_and_a_hundredth_of_a_degree():
    table = reference.load_config(EXPERIMENTS / "test2.toml")
    with jax.enable_x64(False):
        config = flight_config(table)
        params = references.reference_params(config.controller.references, jnp.float32(config.simulator.time_step))
        found = jax.device_get(references.trajectory(params, config.envelope, *map(jnp.float32, START), 5001))
    theirs = reference.reference_trajectory(table, *START)
    assert found.reference.com_position.dtype == np.float32
    assert np.max(np.abs(found.reference.com_position - theirs["com_position"])) < 1e-3
    assert np.max(np.abs(found.reference.rotation - theirs["rotation"])) < 2e-4
