"""Reading configurations and robots in JAX: refusals, and no change of global settings."""

from __future__ import annotations

import copy
import os
import subprocess
import sys

import jax
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.keys import set_key
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import ancestors_of, levels_of, load_robot
from jax_aero.config import AxisymmetricAeroConfig
from jax_aero.control.tick import momentum_controller
from jax_aero.sim import prepare
from jax_aero.sim.plant import n_ticks


@pytest.fixture(scope="module")
def table():
    return rust.load_config("test2")


def test_numbers_are_leaves_and_names_are_structure(table):
    config, robot = scenario_config(table), load_robot(table["robot"])
    assert n_ticks(config) == 5000
    assert isinstance(config.controller.aero, AxisymmetricAeroConfig)

    def controller(**changes):
        changed = scenario_config(table | {"controller": table["controller"] | changes})
        return momentum_controller(changed, robot)

    with jax.enable_x64(True):
        made = controller()
        assert all(leaf.dtype == np.float64 and not getattr(leaf, "weak_type", False) for leaf in jax.tree.leaves(made))
        assert jax.tree.structure(made) != jax.tree.structure(controller(lever_arm="unrotated"))
        assert jax.tree.structure(made) == jax.tree.structure(
            controller(posture_gain=table["controller"]["posture_gain"])
        )


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("controller.time_step", 0.0101, "thrust_steepness`? is 2; expected at most 1.98"),
        ("controller.bounds.joint_steepness", 255.0, "joint_steepness`? is 255; expected at most 254.6"),
    ],
)
def test_bounds_that_oscillate_from_tick_to_tick_are_refused_as_by_the_crate(table, key, value, words):
    changed = copy.deepcopy(table)
    set_key(changed, key, value)
    for build in (lambda: prepare(changed, dtype=np.float32), lambda: rust.fly(changed)):
        with pytest.raises(ValueError, match=words):
            build()


def test_the_tree_of_bodies():
    parent = (-1, 0, 1, 1, 0)
    assert levels_of(parent) == ((0,), (1, 4), (2, 3))
    expected = [[0, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1]]
    assert np.array_equal(ancestors_of(parent), np.array(expected, bool))


@pytest.mark.slow
def test_importing_and_flying_change_no_global_setting():
    """Compiled without optimisation, which takes half the time."""
    code = (
        "import jax, os; before = dict(jax.config.values), dict(os.environ)\n"
        "from jax_aero import rust, sim, verify\n"
        "table = rust.load_config('test2', {'simulator.duration': 0.05})\n"
        "print(sim.fly(table).outcome)\n"
        "print((jax.config.values, dict(os.environ)) == before, jax.numpy.ones(1).dtype)"
    )
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"XLA_FLAGS": flags}, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["completed", "True", "float32"]
