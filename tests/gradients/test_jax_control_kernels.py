"""Derivatives of the controller, corners included: of set-points and of the rate limiter on their own, then of a tick.

Reverse mode through a whole tick: calm, at rest in still air, with wind along a link's axis, with thrusts and joints at
their limits, and with most bounds of the momentum QP active.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from msgspec import structs

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import exp_so3, rotation_from_rpy
from jax_aero.control import tick
from jax_aero.control.law import setpoint
from jax_aero.control.law.torque import limit_rate
from jax_aero.types import Setpoint, State, leaf
from tests.measurements import measured

pytestmark = pytest.mark.usefixtures("x64")

N_JOINTS = 23


def flat(tree):
    """All floating-point leaves in one vector."""
    leaves = [jnp.ravel(leaf) for leaf in jax.tree.leaves(tree) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating)]
    return jnp.concatenate(leaves)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture(scope="module")
def twin(x64):
    config = scenario_config(rust.load_config("test2"))
    robot = load_robot(config.robot)
    return config, robot, tick.momentum_controller(config, robot)


def test_limit_rate(check_gradient):
    """Within the step and beyond it."""
    inputs = (np.zeros(3), np.array([1.0, 5.0, -7.0]), np.full(3, 3.0))
    check_gradient(lambda x: limit_rate(*x), inputs)


def test_setpoints(twin, rng, check_gradient):
    """Ten ticks of the generator in the turbo segment, by every number of its configuration."""
    config, _, controller = twin
    numbers = {name: leaf(value) for name, value in structs.asdict(config.controller.setpoint).items()}

    def fly(x):
        settings, com, rpy = x
        configured = structs.replace(config.controller.setpoint, **settings)
        params = setpoint.setpoint_params(configured, jnp.array([-1.0, 0.0, 0.0]), jnp.array(0.01))
        state = setpoint.start(params, com, rotation_from_rpy(rpy))

        def one(state, time):
            return setpoint.update(params, controller.mission, state, time)

        return jax.lax.scan(one, state, 21.0 + 0.01 * jnp.arange(10))[1]

    # A filter of 5 ms at a tick of 10 ms: its outputs are large and steep in T.
    at = numbers, rng.normal(size=3), np.array([0.0, -0.1, 3.0])
    sizes = jax.tree.map(lambda x: jnp.abs(x).max(), jax.jit(fly)(at))
    check_gradient(lambda x: jax.tree.map(jnp.divide, fly(x), sizes), at, tolerance=1e-5)


def cases(config, robot, rng):
    """Name to (state, thrust, wind): the corners of a tick."""
    limits = np.asarray(robot.joint_limits)
    joints, thrust = np.asarray(config.simulator.initial.joint_position), np.array([98.0, 98.0, 113.0, 113.0])
    base = np.diag([-1.0, -1.0, 1.0])
    rest = State(np.array([0.0, 0.0, 0.8]), base, joints, np.zeros(6 + N_JOINTS))
    moving = rest._replace(velocity=0.1 * rng.normal(size=6 + N_JOINTS))
    middle = rest._replace(joint_position=limits.mean(axis=1))
    side = np.array([0.0, -8.0, 0.0])
    tilted = np.asarray(exp_so3(np.array([0.4, -0.6, 0.2]))) @ base
    return {
        "calm": (moving, thrust, side),
        "still air": (rest, thrust, np.zeros(3)),
        "wind along the axis of the base": (rest, thrust, base @ np.array([0.0, 5.0, 0.0])),
        "limits": (middle._replace(joint_position=limits[:, 0]), np.array([0.0, 160.0, 0.0, 220.0]), side),
        "saturated": (moving._replace(base_rotation=tilted, velocity=10 * moving.velocity), thrust, side),
    }


def test_a_whole_tick(twin, rng):
    """Commands by state, thrust, wind, and every gain, weight and coefficient of the controller."""
    config, robot, params = twin
    names, samples = zip(*cases(config, robot, rng).items(), strict=True)
    state, thrust, wind = jax.tree.map(lambda *leaves: jnp.stack(leaves), *samples)
    followed = Setpoint(
        np.array([0.0, 0.0, 0.75]), *(0.1 * rng.normal(size=(3, 3))), np.diag([-1.0, -1.0, 1.0]), *np.zeros((3, 3))
    )
    first = jax.tree.map(lambda leaf: leaf[1], state)
    memory = jax.jit(tick.init)(params, robot, first)

    def command(params, state, thrust, wind):
        _, command, terms = tick.tick(params, robot, memory, jnp.zeros(()), state, thrust, wind, followed)
        units = jnp.concatenate([jnp.full(4, 100.0), jnp.full(N_JOINTS, 0.8)])
        return jnp.concatenate([command.thrust_rate, command.joint_velocity]) / units, terms.unlimited_torque / 50.0

    def draw_direction(seed, tree):
        numbers = np.random.default_rng(seed)
        return jax.tree.map(lambda x: numbers.uniform(-1, 1, np.shape(x)) * np.maximum(np.abs(x), 0.1), tree)

    # Numbers that only the reference generator reads, and the mission, do not move.
    moved = {
        name: draw_direction(i, getattr(params, name)) for i, name in enumerate(("aero", "momentum", "tasks", "torque"))
    }
    still = jax.tree.map(np.zeros_like, params)
    d_params = replace(still, **moved)
    d_state = draw_direction(6, first)._replace(base_rotation=np.zeros((3, 3)))
    d_rest = (d_state, draw_direction(7, thrust[0]), 3.0 * rng.normal(size=3))

    weights = rng.normal(size=4 + 2 * N_JOINTS)

    @jax.jit
    @jax.vmap
    def differentiate(state, thrust, wind, t):
        """Weighted commands at a distance t along the direction, and their derivative by t in reverse mode."""
        direction = (d_params, *d_rest)
        at = jax.tree.map(lambda x, d: x + t * d, (params, state, thrust, wind), direction)
        value, gradient = jax.value_and_grad(lambda x: weights @ jnp.concatenate(command(*x)))(at)
        pairs = list(zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True))
        size = sum(jnp.vdot(jnp.abs(a), jnp.abs(b)) for a, b in pairs)
        return value, sum(jnp.vdot(a, b) for a, b in pairs), size, jnp.isfinite(flat(gradient)).all()

    step = 1e-7
    ahead, here, behind = (
        differentiate(state, thrust, wind, jnp.full(len(names), sign * step)) for sign in (1.0, 0.0, -1.0)
    )
    _, slope, size, finite = here
    assert finite.all()
    difference = (ahead[0] - behind[0]) / (2 * step)
    worst = dict(zip(names, np.abs(slope - difference) / size, strict=True))
    because = "the error of the quotient: values of 1e-13 accuracy over a step of 1e-7"
    measured("gradient - finite difference", max(worst.values()), 1e-6, because)
    assert np.min(np.abs(slope) / size) > 1e-4
