"""A task of one's own in the momentum QP of the JAX engine."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.control.law.momentum_qp import Diagonal, Rows, _cost
from jax_aero.control.tick import init, momentum_controller, tick
from jax_aero.types import Array, State, pytree, static

pytestmark = pytest.mark.usefixtures("x64")


@pytree
class KeepVelocity:
    """Asks some joint to turn at a velocity, as a diagonal or as a row."""

    joint: int = static()
    is_row: bool = static()
    velocity: Array
    weight: Array

    def equations(self, inputs):
        unknown, offset, weight = inputs.joints + self.joint, -self.velocity[None], self.weight[None]
        if self.is_row:
            row = jnp.zeros(inputs.joints + inputs.posture.shape[0]).at[unknown].set(1.0)
            return Rows(row[None], offset, weight)
        return Diagonal(unknown, offset, weight)


@pytest.fixture(scope="module")
def first_tick():
    """The first tick of TEST2 in still air, with tasks."""
    with jax.enable_x64(True):
        config = scenario_config(rust.load_config("test2"))
        robot = load_robot(config.robot)
        start = config.simulator.initial
        rotation = jnp.diag(jnp.array([-1.0, -1.0, 1.0]))
        joints = jnp.asarray(start.joint_position)
        state = State(jnp.asarray(start.base_position), rotation, joints, jnp.zeros(6 + robot.n_joints))

        @jax.jit
        def run(controller):
            memory = init(controller, robot, state)
            _, command, terms = tick(
                controller, robot, memory, jnp.array(0.0), state, jnp.asarray(start.thrust), jnp.zeros(3)
            )
            return command, terms.momentum_qp.problem

    def fly(*tasks):
        with jax.enable_x64(True):
            return jax.device_get(run(momentum_controller(config, robot, tasks=tasks)))

    return fly


@pytest.mark.slow
@pytest.mark.parametrize("is_row", [False, True])
def test_it_adds_its_square_to_the_cost(first_tick, is_row, measured):
    """½ w (u_k − v)² adds w to one entry of H and −w v to one of g."""
    _, plain = first_tick()
    _, more = first_tick(KeepVelocity(3, is_row, jnp.array(0.07), jnp.array(40.0)))
    h, g = plain.h.copy(), plain.g.copy()
    h[4 + 3, 4 + 3] += 40.0
    g[4 + 3] -= 40.0 * 0.07
    measured("H with a task", np.abs(more.h - h).max() / np.abs(h).max(), 1e-14, because="sums in another order")
    measured("g with a task", np.abs(more.g - g).max() / np.abs(g).max(), 1e-14, because="sums in another order")


def test_the_number_of_an_unknown_may_be_traced():
    def cost(first):
        some = Rows(jnp.arange(4.0)[None], jnp.array([0.5]), jnp.array([2.0]))
        return _cost([some, Diagonal(first, jnp.array([0.1, 0.2]), jnp.array([3.0, 4.0]))], 4)

    for fixed, traced in zip(cost(1), jax.jit(cost)(1), strict=True):
        np.testing.assert_array_equal(traced, fixed)
    np.testing.assert_array_equal(np.diag(cost(1)[0]), 2.0 * np.arange(4.0) ** 2 + [0.0, 3.0, 4.0, 0.0])
