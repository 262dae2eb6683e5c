"""JAX robot, kinematics and dynamics against the Rust crate, for both robots and both backends."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base import places
from jax_aero.body.dynamics import accelerate, add_joint_inertia, dynamics, forward_dynamics, invert_mass
from jax_aero.body.kinematics import generalised_force, kinematics, kinematics_at_rest
from jax_aero.body.robot import load_robot
from jax_aero.types import State
from tests.measurements import measured

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-10


@pytest.fixture
def jax_robot(robot_name):
    return load_robot(ROOT / "configs" / "robot" / f"{robot_name}.toml")


@pytest.fixture
def states(random_states):
    return [state for state, _ in random_states][:60]


def stack_states(states):
    return State(*(jnp.stack([np.asarray(value) for value in field]) for field in zip(*states, strict=True)))


def test_the_robot_is_the_same(jax_robot, robot):
    assert jax_robot.joint_names == tuple(robot.joint_names)
    assert jax_robot.body_names == tuple(robot.body_names)
    assert jax_robot.jets.names == tuple(robot.jet_names)
    assert jax_robot.aero_links.names == tuple(robot.aero_link_names)
    groups = {name: [jax_robot.joint_names[joint] for joint in joints] for name, joints in jax_robot.joint_groups}
    assert groups == robot.joint_groups
    assert np.allclose(jax_robot.joint_limits, robot.joint_limits, rtol=1e-15, atol=0)
    assert np.isclose(jax_robot.mass, robot.mass, rtol=1e-14)
    assert jax_robot.gravity == robot.gravity


@pytest.mark.parametrize("backend", ["tree", "mjx"])
def test_dynamics(jax_robot, robot, states, agree, backend):
    @jax.jit
    @jax.vmap
    def evaluate(state):
        kin = kinematics(jax_robot, state)
        dyn = dynamics(jax_robot, state, kin, backend)
        return kin, dyn, forward_dynamics(dyn, jnp.cos(state.velocity))

    kin, dyn, acceleration = jax.device_get(evaluate(stack_states(states)))
    for i, state in enumerate(states):
        theirs = rust.dynamics(robot, state)
        agree("body positions", kin.body_positions[i], theirs.body_positions, TOLERANCE)
        agree("body rotations", kin.body_rotations[i], theirs.body_rotations, TOLERANCE)
        agree("centre of mass", kin.com[i], theirs.com_position, TOLERANCE)
        for name in dyn._fields:
            agree(f"{backend}: {name}", getattr(dyn, name)[i], getattr(theirs, name), TOLERANCE)
        forces = np.cos(np.asarray(state.velocity))
        agree(f"{backend}: acceleration", acceleration[i], rust.forward_dynamics(robot, state, forces), TOLERANCE)


@pytest.mark.parametrize("rotors", [None, 0.4])
def test_the_inverse_of_the_mass_matrix(jax_robot, states, rotors):
    """By blocks, also with inertia added to joints, against one of the whole matrix."""
    n = jax_robot.n_joints
    robot = jax_robot if rotors is None else replace(jax_robot, rotor_inertia=np.full(n, rotors))
    added = np.where(np.arange(n) % 3 == 0, 0.7, 0.0)

    @jax.jit
    @jax.vmap
    def evaluate(state):
        dyn = dynamics(robot, state, kinematics(robot, state))
        inverse = invert_mass(dyn)
        columns = jnp.eye(6 + n, dtype=dyn.bias.dtype)
        products = [jax.vmap(partial(accelerate, x))(columns) for x in (inverse, add_joint_inertia(inverse, added))]
        return dyn.mass_matrix, *products

    for mass, inverse, braced in zip(*jax.device_get(evaluate(stack_states(states[:20]))), strict=True):
        for found, matrix in ((inverse, mass), (braced, mass + np.diag(np.pad(added, (6, 0))))):
            error = np.abs(found.T @ matrix - np.eye(6 + n)).max()
            # Of the inverse and of the product.
            measured("inverse mass matrix", error, 2.0 * (6 + n) * np.finfo(float).eps * np.linalg.cond(matrix))


@pytest.mark.parametrize("name", ["slider", "sparrow"])
def test_generalised_forces_are_the_work_of_forces_by_joint(name, x64):
    """The derivative of `Σ f · p` by the joints, revolute and prismatic, with points that move with their bodies."""
    robot, rng = load_robot(places.find("robot", name)), np.random.default_rng(4)
    bodies = tuple(range(len(robot.masses)))
    offsets, forces = rng.normal(size=(2, len(bodies), 3))
    joints = rng.uniform(-0.5, 0.5, robot.n_joints)

    def points(joints):
        kin = kinematics_at_rest(robot, joints)
        return kin, kin.body_positions + jnp.einsum("bij,bj->bi", kin.body_rotations, offsets)

    expected = jax.grad(lambda joints: jnp.sum(forces * points(joints)[1]))(joints)
    found = generalised_force(robot, *points(joints)[:1], bodies, points(joints)[1], jnp.asarray(forces))
    np.testing.assert_allclose(found[6:], expected, rtol=1e-10, atol=1e-12)
