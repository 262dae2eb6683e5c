"""What single precision costs: the error budget of every kernel below the controller, against double precision."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.aero import Axisymmetric, LinkConventions, link_forces
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import load_robot
from jax_aero.types import State, with_dtype

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]
BUDGET = {"mass_matrix": 2e-6, "bias": 4e-6, "momentum": 4e-6, "acceleration": 3e-4, "forces": 4e-6}
"""Relative to the largest entry; 10 m from the origin, where positions are good to 1e-6 m."""


@pytest.mark.close_to_tolerance("a budget of single precision: a few units in the last place of the largest term")
def test_the_budget_of_single_precision(agree):
    robot = load_robot(ROOT / "configs" / "robot" / "ironcub_mk1.toml")
    model = Axisymmetric(0.5 * np.float64(1.225), robot.aero_links.coefficients["corrected"])
    rng = np.random.default_rng(9)
    turn = np.linalg.qr(rng.normal(size=(40, 3, 3)))[0]
    turn *= np.linalg.det(turn)[:, None, None]
    limits = np.asarray(robot.joint_limits)
    joints = rng.uniform(limits[:, 0], limits[:, 1], size=(40, 23))
    states = State(10.0 * rng.uniform(-1, 1, (40, 3)), turn, joints, rng.normal(size=(40, 29)))

    @jax.jit
    def evaluate(robot, model, states):
        def one(state):
            kin = kinematics(robot, state)
            dyn = dynamics(robot, state, kin)
            forces = link_forces(
                model, robot, kin, LinkConventions(), jnp.array([1.0, -9.0, 0.5], state.velocity.dtype)
            )
            found = {name: getattr(dyn, name) for name in ("mass_matrix", "bias", "momentum")}
            return found | {"acceleration": forward_dynamics(dyn, jnp.cos(state.velocity)), "forces": forces.forces}

        return jax.vmap(one)(states)

    inputs = jax.tree.map(jnp.asarray, (robot, model, states))
    double, single = evaluate(*inputs), evaluate(*with_dtype(inputs, jnp.float32))
    for name, tolerance in BUDGET.items():
        assert single[name].dtype == jnp.float32
        agree(name, single[name], double[name], tolerance)


@pytest.mark.parametrize("name", ["test2", "test2_observer", "test2_sensors"])
def test_a_flight_in_single_precision_has_no_number_in_double_precision(name):
    config = scenario_config(rust.load_config(name))
    scenario, start = sim.convert_precision(*sim.prepare(config), np.float32)
    flown = jax.eval_shape(lambda scenario, start: sim.rollout(scenario, start, 2, sim.keep_row), scenario, start)
    doubled = [
        jax.tree_util.keystr(path)
        for path, leaf in jax.tree_util.tree_leaves_with_path(flown)
        if leaf.dtype == jnp.float64
    ]
    assert doubled == []
