"""Forces and moments on bodies in JAX against the Rust crate."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.typed import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.sim.plant import Acting, advance, observe, start_plant
from jax_aero.sim.pushes import configured_pushes


@pytest.mark.usefixtures("x64")
def test_pushes_between_ticks(agree):
    """On two bodies, beginning and ending within ticks and sub-steps: both plants, tick by tick."""
    pushes = [
        {"body": "chest", "force": [30.0, -20.0, 10.0], "moment": [5.0, 2.0, -3.0], "start": 0.013, "duration": 0.021},
        {"body": "l_lower_leg", "moment": [0.0, 8.0, 0.0], "start": 0.02, "duration": 1.0},
    ]
    changes = {"simulator.substeps": 2, "simulator.aero": {"model": "off"}, "disturbances.pushes": pushes}
    table = rust.load_config("test2", changes | {"simulator.initial.free_fall_tick": False})
    crate, config = rust.Flight(table), scenario_config(table)
    robot, rest = load_robot(table["robot"]), jnp.zeros(3)
    plant, state = start_plant(config, robot)
    pushing = configured_pushes(config.disturbances.pushes, robot)
    commanded, left = Acting(jnp.zeros(4), (jnp.zeros(23),) * 2), jnp.asarray(pushing.starts)

    @jax.jit
    def step(state, left):
        left, acting = pushing.act(left, commanded, plant.time_step / 2)
        return advance(plant, state, observe(plant, state, rest), acting, rest), left

    for _ in range(5):
        crate.step(command=rust.Command(np.zeros(4), np.zeros(23)))
        (state, left), measured = step(state, left), crate.truth
        agree("velocities", state.robot.velocity, measured.state.velocity, 1e-10)
        agree("joints", state.robot.joint_position, measured.state.joint_position, 1e-10)
