"""The crate's linearised dynamics against the derivatives of the symbolic ones, term by term."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.rust import Robot
from jax_aero.symbolic import MomentumModel, load_robot

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-9
COUNT = 12


def flight(path, aero):
    """The predictive law for another robot, of which it moves all joints that are in groups."""
    robot = Robot(path)
    config = copy.deepcopy(rust.load_config(ROOT / "configs/experiments/test2_mpc.toml"))
    config["robot"] = str(path)
    config["simulator"]["aero"] = config["controller"]["aero"] = json.loads(json.dumps(aero))
    config["simulator"]["initial"] |= {
        "joint_position": [0.0] * len(robot.joint_names),
        "thrust": [0.0] * len(robot.jet_names),
    }
    controller = config["controller"]
    controller["mpc"]["joint_groups"] = list(robot.joint_groups)
    for weights in ("weights", "descent"):
        controller["mpc"][weights]["posture"] = dict.fromkeys(robot.joint_groups, 1.0)
    controller["posture_gain"] = dict.fromkeys(robot.joint_groups, 20.0)
    controller["weights"] |= {"thrust_rate": dict.fromkeys(robot.jet_names, 0.01), "symmetric_jets": []}
    controller["bounds"]["thrust_rate_max"] = dict.fromkeys(robot.jet_names, 100.0)
    return config, [robot.joint_names.index(name) for names in robot.joint_groups.values() for name in names]


@pytest.mark.parametrize("robot_name", ["ironcub_mk1", "slider"])
def test_every_derivative(robot_name, random_states, agree):
    """One robot with a thousand derivatives, one with a joint that slides."""
    path = ROOT / f"configs/robot/{robot_name}.toml"
    derived_robot = load_robot(path)
    sets = sorted(derived_robot.coefficients)
    aero = {"model": "axisymmetric", "coefficients": sets[-1], "air_density": 1.225} if sets else {"model": "off"}
    config, joints = flight(path, aero)
    derived = MomentumModel(derived_robot, aero)
    controller = rust.Controller(config)
    rng = np.random.default_rng(11)
    targets = np.zeros((len(config["controller"]["mpc"]["knots"]), 6, 3))
    zero = np.zeros(derived_robot.n_joints)
    for index, (state, _) in zip(range(COUNT), random_states, strict=False):
        thrust = rng.uniform(0.0, 220.0, len(derived_robot.jets))
        wind = rng.normal(size=3) * (1.0, 10.0, 40.0)[index % 3]
        controller.start(state, thrust, wind)
        controller.tick(state, thrust, wind)
        theirs = controller.prediction(zero, targets, np.zeros((len(targets), 6)))
        ours = derived.linearised(*state, thrust, wind)
        for name, value in ours._asdict().items():
            expected = value[:, sorted(joints)] if name.endswith(("_s", "_sigma")) else value
            agree(f"symbolic: {name}", theirs[name], expected, TOLERANCE)
