"""The crate's linearised dynamics against the derivatives of the symbolic ones, term by term."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.clearance import kept_apart
from jax_aero.symbolic.kinematics import Kinematics
from tests.parity.fitted import fitted

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-9
COUNT = 12
SMOOTHING = 1e-6
"""Of the symbolic distance of two segments, at most [m]."""


def flight(path, aero):
    """The predictive law for another robot, of which it moves all joints that are in groups."""
    robot, config = fitted("test2_mpc", path, aero)
    controller = config["controller"]
    controller["mpc"]["joint_groups"] = list(robot.joint_groups)
    del controller["mpc"]["clearance"]  # has links of one robot
    del controller["channels"]["jump"]  # would refuse postures beyond the stops
    for weights in ("weights", "descent"):
        controller["mpc"][weights]["posture"] = dict.fromkeys(robot.joint_groups, 1.0)
    return config, [robot.joint_names.index(name) for names in robot.joint_groups.values() for name in names]


def derivatives(model):
    """The derivatives of L̇ and ω_B at a state, by name: of dν_B from A dν_B = dL − ∂L/∂q dq − ∂L/∂ṡ dṡ."""
    tree, momentum = model.tree, model.dynamics.momentum
    base, turn, joints = range(6), range(3, 6), range(6, tree.velocity.numel())
    by_velocity = ca.jacobian(momentum, tree.velocity)
    inverse = ca.inv(by_velocity[:, base])
    by_momentum = ca.mtimes(inverse, ca.diag(ca.vertcat(*[model.robot.mass] * 3, 1, 1, 1)))
    by_position = -ca.mtimes(inverse, ca.jacobian(momentum, tree.q))
    by_rate = -ca.mtimes(inverse, by_velocity[:, joints])

    of_velocity = ca.jacobian(model.momentum_rate, tree.velocity)
    of_base = of_velocity[:, base]
    rate_momentum = ca.mtimes(of_base, by_momentum)
    rate_position = ca.jacobian(model.momentum_rate, tree.q) + ca.mtimes(of_base, by_position)
    parts = {
        "rate_v": rate_momentum[:, :3],
        "rate_theta": rate_position[:, turn],
        "rate_k": rate_momentum[:, 3:],
        "rate_t": ca.jacobian(model.momentum_rate, model.thrust),
        "rate_s": rate_position[:, joints],
        "rate_sigma": of_velocity[:, joints] + ca.mtimes(of_base, by_rate),
        # φ̇ is the angular velocity at φ = 0 only: ω = φ̇ + φ × φ̇ / 2 + …
        "omega_theta": by_position[turn, turn] - 0.5 * ca.skew(tree.velocity[3:6]),
        "omega_k": by_momentum[turn, 3:],
        "omega_s": by_position[turn, joints],
        "omega_sigma": by_rate[turn, :],
    }
    return parts, model.function("derivatives", list(parts.values()))


@pytest.mark.parametrize("robot_name", ["ironcub_mk1", "slider"])
def test_every_derivative(robot_name, random_states, agree):
    """One robot with a thousand derivatives, one with a joint that slides."""
    path = ROOT / f"configs/robot/{robot_name}.toml"
    derived_robot = load_robot(path)
    sets = sorted(derived_robot.coefficients)
    aero = {"model": "axisymmetric", "coefficients": sets[-1], "air_density": 1.225} if sets else {"model": "off"}
    config, joints = flight(path, aero)
    names, derived = derivatives(MomentumModel(derived_robot, aero))
    controller = rust.Controller(config)
    rng = np.random.default_rng(11)
    targets = np.zeros((len(config["controller"]["mpc"]["knots"]), 6, 3))
    for index, (state, _) in zip(range(COUNT), random_states, strict=False):
        thrust = rng.uniform(0.0, 220.0, len(derived_robot.jets))
        wind = rng.normal(size=3) * (1.0, 10.0, 40.0)[index % 3]
        controller.start(state, thrust, wind)
        controller.tick(state, thrust, wind)
        theirs = controller.prediction(targets, np.zeros((len(targets), 6)))
        for name, part in zip(names, derived(*state, thrust, wind), strict=True):
            value = part.full()
            expected = value[:, sorted(joints)] if name.endswith(("_s", "_sigma")) else value
            agree(f"symbolic: {name}", theirs[name], expected, TOLERANCE)


@pytest.mark.parametrize("robot_name", ["ironcub_mk1"])
def test_distances_and_their_derivatives(robot_name, random_states, agree):
    """Of all capsules that a plan keeps apart, beside the expressions of the trim."""
    path = ROOT / f"configs/robot/{robot_name}.toml"
    robot, described = load_robot(path), rust.Robot(path)
    config = rust.load_config("test2_mpc")
    del config["controller"]["channels"]["jump"]  # would refuse postures beyond the stops
    # All joints, or nothing that is kept apart would move.
    groups, mpc = list(described.joint_groups), config["controller"]["mpc"]
    settings, mpc["joint_groups"] = mpc["clearance"], groups
    for weights in ("weights", "descent"):
        mpc[weights]["posture"] = dict.fromkeys(groups, 1.0)
    tree = Kinematics(robot)
    (distance,) = tree.evaluate_at_base(kept_apart(tree, settings))
    at = [tree.base_position, tree.base_rotation, tree.joint_position]
    expected = ca.Function("expected", at, [distance, ca.jacobian(distance, tree.joint_position)])
    controller = rust.Controller(config)
    joints = sorted(described.joint_names.index(name) for group in groups for name in described.joint_groups[group])
    targets = np.zeros((len(config["controller"]["mpc"]["knots"]), 6, 3))
    for _, (state, _) in zip(range(COUNT), random_states, strict=False):
        controller.start(state, np.full(4, 100.0), np.zeros(3))
        controller.tick(state, np.full(4, 100.0), np.zeros(3))
        theirs = controller.prediction(targets, np.zeros((len(targets), 6)))
        values, derivatives = (value.full() for value in expected(np.zeros(3), np.eye(3), state.joint_position))
        agree("symbolic: distance", theirs["distance"], values[:, 0], SMOOTHING)
        agree("symbolic: distance_by_joint", theirs["distance_by_joint"], derivatives[:, joints], SMOOTHING)
