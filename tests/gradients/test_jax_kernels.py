"""Derivatives of every kernel below the controller: reverse = forward = difference quotient, corners included."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import LinkConventions, LinksInAir, aero_model, link_forces, wrench_about
from jax_aero.base.typed_config import aero_config, scenario_config
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.jets import jet_dynamics
from jax_aero.body.kinematics import generalised_force, kinematics, velocities_at
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import exp_so3, rotation_angle, rotation_from_rpy, rpy_from_rotation, wxyz_from_rotation
from jax_aero.config import ThrottledJetsConfig
from jax_aero.sim.wind import wind_model, wind_velocity
from jax_aero.types import State

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def robot():
    return load_robot(ROOT / "configs" / "robot" / "ironcub_mk1.toml")


@pytest.fixture
def state(x64):
    rng = np.random.default_rng(2)
    rotation = rotation_from_rpy(jnp.array([0.2, -0.5, 2.8]))
    return State(jnp.asarray(rng.normal(size=3)), rotation, 0.4 * rng.normal(size=23), rng.normal(size=29))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.0999, 0.1001, 1.0, 3.0])
def test_exponential_of_a_rotation_vector(check_gradient, angle):
    """Smooth through zero and through the switch to the series."""
    check_gradient(exp_so3, angle * jnp.array([0.6, -0.48, 0.64]))


def test_rotations(check_gradient):
    rotation = rotation_from_rpy(jnp.array([0.3, -0.4, 2.0]))
    check_gradient(lambda r: (rpy_from_rotation(r), wxyz_from_rotation(r), rotation_angle(r)), rotation)
    assert np.all(np.isfinite(jax.grad(rotation_angle)(jnp.eye(3))))


def test_kinematics_and_forces(check_gradient, robot, state):
    def evaluate(state):
        kin = kinematics(robot, state)
        points = kin.body_positions[np.array(robot.jets.bodies)] + 0.1
        force = generalised_force(robot, kin, robot.jets.bodies, points, points)
        return kin, velocities_at(kin, robot.jets.bodies, points), force

    check_gradient(evaluate, state)


def test_dynamics(check_gradient, robot, state):
    """With respect to the state and to every mass, centre of mass and inertia."""

    def evaluate(inputs):
        state, masses, coms, inertias = inputs
        symmetric = 0.5 * (inertias + jnp.swapaxes(inertias, 1, 2))  # no other direction means anything
        changed = dataclasses.replace(robot, masses=masses, coms=coms, inertias=symmetric)
        dyn = dynamics(changed, state, kinematics(changed, state))
        return dyn, 1e-2 * forward_dynamics(dyn, jnp.cos(state.velocity))

    check_gradient(evaluate, (state, robot.masses, robot.coms, robot.inertias), tolerance=3e-6)


def test_mjx_has_the_same_reverse_mode(state):
    """With the small robot, for the sake of time; along the sphere of quaternions, since MJX normalises them."""
    robot = load_robot(ROOT / "configs" / "robot" / "sparrow.toml")
    n = robot.n_joints

    def gradient(backend):
        def bend(turn, joints, velocity, masses, coms):
            changed = dataclasses.replace(robot, masses=masses, coms=coms)
            turned = State(state.base_position, exp_so3(turn) @ state.base_rotation, joints, velocity)
            dyn = dynamics(changed, turned, kinematics(changed, turned), backend)
            return jnp.sum(jnp.sin(dyn.mass_matrix)) + jnp.sum(jnp.sin(dyn.bias))

        at = (0.1 * jnp.ones(3), state.joint_position[:n], state.velocity[: 6 + n], robot.masses, robot.coms)
        return jax.jit(jax.grad(bend, argnums=range(5)))(*at)

    for tree, mjx in zip(gradient("tree"), gradient("mjx"), strict=True):
        assert np.allclose(tree, mjx, rtol=1e-9, atol=1e-9 * np.abs(tree).max())


@pytest.fixture(scope="module")
def models(robot, x64):
    table = rust.load_config("robustness_axisymmetric_vs_sphere_cylinder")
    return {part: aero_model(aero_config(table[part]["aero"]), robot) for part in ("simulator", "controller")}


def forces_in_wind(v_air, model, axes):
    return model.forces(LinksInAir(axes, v_air, None, None, None))


def forces_on_link(inputs, v_air):
    model, axes = inputs
    return forces_in_wind(v_air, model, axes / jnp.linalg.norm(axes, axis=1, keepdims=True))


@pytest.mark.parametrize("which", ["simulator", "controller"])
@pytest.mark.parametrize("case", ["rest", "slow", "along", "against", "oblique"])
def test_aerodynamics(check_gradient, robot, models, which, case):
    """At no wind and for wind along an axis from both sides, where angles and norms have no derivative of their own."""
    rng = np.random.default_rng(4)
    axes = rng.normal(size=(robot.aero_links.count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    v_air = {
        "rest": np.zeros_like(axes),
        "slow": 1e-5 * rng.normal(size=axes.shape),
        "along": 12.0 * axes,
        "against": -12.0 * axes,
        "oblique": 8.0 * rng.normal(size=axes.shape),
    }[case]
    # |v| v is linear in the step at rest, where its derivative is zero.
    check_gradient(forces_in_wind, v_air, models[which], axes, tolerance=1e-5, step=1e-9 if case == "rest" else 1e-6)
    check_gradient(forces_on_link, (models["simulator"], axes), v_air, tolerance=1e-5)


@pytest.mark.parametrize(
    "quirks", [("rotated", "link_rotation", "at_centre"), ("unrotated", "base_rotation", "shifted_twice")]
)
def test_link_forces(check_gradient, robot, models, state, quirks):
    def evaluate(inputs):
        state, wind, model = inputs
        kin = kinematics(robot, state)
        link = link_forces(model, robot, kin, LinkConventions(*quirks), wind)
        return link, wrench_about(link, kin.com)

    check_gradient(evaluate, (state, jnp.array([1.0, -9.0, 0.5]), models["simulator"]), tolerance=1e-5)


def fly_jets(inputs, model):
    start, command = inputs
    jets = model.start(start)
    for _ in range(2):
        jets = model.advance(jets, command, 0.01)
    return jets


@pytest.mark.parametrize("thrust", [0.0, 60.0, 150.0])
def test_second_order_jets(check_gradient, robot, thrust):
    """Also with the throttle at its lower limit."""
    settings = scenario_config(rust.load_config("second_order_jets")).simulator.jets
    assert isinstance(settings, ThrottledJetsConfig)
    inputs = (jnp.full(4, thrust + 0.5), jnp.array([-40.0, 3.0, 10.0, -3.0]))
    check_gradient(fly_jets, inputs, jet_dynamics(settings, robot), tolerance=1e-5)


def test_wind(check_gradient):
    wind = wind_model(scenario_config(rust.load_config("test2")).wind)
    check_gradient(lambda inputs: wind_velocity(*inputs), (wind, jnp.array(6.0)))
