"""Two states of a tick that `tests/golden/states.py` computed without the crate, through the bindings."""

import json
import tomllib

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.rust import Robot, State
from tests.golden import ticks
from tests.golden.inputs import AERO, FILE, ROBOT, ROOT, TORQUE_MAX

TOLERANCE = 1e-9
"""Of the largest entry of each array; both sides round terms of condition up to 1e5."""

STATES = json.loads(FILE.read_text(encoding="utf-8"))["states"]


@pytest.fixture(params=STATES, ids=["four bounds active", "torque bounds active"])
def golden(request):
    return {part: {key: np.array(value) for key, value in values.items()} for part, values in request.param.items()}


@pytest.fixture(scope="module")
def iron_cub():
    return Robot(ROBOT)


def state_of(given):
    return State(*(given[key] for key in ("base_position", "base_rotation", "joint_position", "velocity")))


@pytest.mark.parametrize("controller", ["aero_aware", "baseline"])
def test_every_value_of_a_tick(golden, controller, agree):
    experiment = {"aero_aware": "test2", "baseline": "test1"}[controller]
    config = rust.load_config(ROOT / "configs" / "experiments" / f"{experiment}.toml")
    if controller in AERO:
        config["controller"]["aero"] = rust.load_aero(AERO[controller])
    config["controller"]["torque"]["torque_max"] = TORQUE_MAX
    found = ticks.compute(config, golden["given"] | {"time": 0.0})
    expected = golden[controller]
    expected.pop("link_jacobians", None)
    for key, value in expected.items():
        agree(key, found[key], value, TOLERANCE)


def test_jacobians_of_the_link_centres(golden, iron_cub, agree):
    links = tomllib.loads(iron_cub.toml_text)["aero_links"]
    found = []
    for link, centre in zip(links, golden["aero_aware"]["link_arm_points"], strict=True):
        linear, angular = rust.frame_jacobian(iron_cub, link["frame"], state_of(golden["given"]))
        # Base rotation moves the frame's origin by −S(r) ω; another point of the link by −S(offset) J_ω more.
        r = np.array([linear[1, 5], linear[2, 3], linear[0, 4]])
        offset = centre - golden["given"]["base_position"] - r
        found.append(linear + np.cross(angular, offset, axisa=0, axisb=0, axisc=0))
    agree("link_jacobians", found, golden["aero_aware"]["link_jacobians"], TOLERANCE)


def test_forces_of_spheres_and_cylinders(golden, iron_cub, agree):
    state = golden["aero_aware"]
    model = rust.load_aero(AERO["sphere_cylinder"])
    found = rust.aero_forces(iron_cub, model, state["link_axes"], state["link_v_air"])
    agree("aero_force", found, golden["sphere_cylinder"]["aero_force"], TOLERANCE)
