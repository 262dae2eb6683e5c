"""Two complete states of a tick from an independent prototype, through the Python face of the crate.

The file lies beside the project, not in it; its `conventions` key explains the entries.
"""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.rust import Controller, Reference, Robot, State

ROOT = Path(__file__).resolve().parents[2]
PATH = ROOT / ".." / "shared" / "golden" / "states.json"
TOLERANCE = 1e-9


@pytest.fixture(params=[0, 1], ids=["state 0", "state 1"])
def golden(request):
    if not PATH.is_file():
        pytest.skip("the golden states are no part of the project: shared/golden/states.json is not beside it")
    states = json.loads(PATH.read_text(encoding="utf-8"))["states"]
    assert len(states) == 2
    return states[request.param]


@pytest.fixture(scope="module")
def iron_cub():
    return Robot(ROOT / "configs" / "robot" / "ironcub_mk1.toml")


def tick_of(experiment, golden):
    """One tick at a golden state, with physically correct points and the printed coefficients."""
    config = rust.load_config(ROOT / "configs" / "experiments" / f"{experiment}.toml")
    if config["controller"]["aero"]["model"] == "axisymmetric":
        config["controller"]["aero"]["coefficients"] = "published"
    controller = Controller(config)
    controller.set_memory(golden["s_des"], golden["Ic0"], np.zeros(23))
    followed = [golden["ref"][key] for key in ("x", "v", "a", "j", "R", "w", "wd", "wdd")]
    return controller.tick(state_of(golden), golden["T"], golden["wind"], reference=Reference(*followed))


def state_of(golden):
    return State(golden["p"], golden["R"], golden["s"], golden["nu"])


def test_dynamics(golden, iron_cub, agree):
    ours = rust.dynamics(iron_cub, state_of(golden))
    agree("mass", iron_cub.mass, golden["mass"], TOLERANCE)
    agree("M", ours.mass_matrix, golden["M"], TOLERANCE)
    agree("h", ours.bias, golden["h"], TOLERANCE)
    agree("CMM", ours.momentum_matrix, golden["CMM"], TOLERANCE)
    agree("L", ours.momentum, golden["L"], TOLERANCE)
    agree("com", ours.com_position, golden["com"], TOLERANCE)
    agree("J_com", ours.momentum_matrix[:3] / iron_cub.mass, golden["J_com"], TOLERANCE)


def test_aerodynamics(golden, iron_cub, agree):
    tick = tick_of("test2", golden)
    agree("aero_axes", tick.link_axes, golden["aero_axes"], TOLERANCE)
    agree("aero_pos", tick.link_arm_points, golden["aero_pos"], TOLERANCE)
    agree("f_aero_flight", tick.aero_force, golden["f_aero_flight"], TOLERANCE)
    moment = np.cross(tick.link_arm_points - tick.com_position, tick.aero_force).sum(axis=0)
    agree("aero_moment_com", moment, golden["aero_moment_com"], TOLERANCE)

    jacobians = []
    for link, centre in zip(tomllib.loads(iron_cub.toml_text)["aero_links"], tick.link_arm_points, strict=True):
        linear, angular = rust.frame_jacobian(iron_cub, link["frame"], state_of(golden))
        # Base rotation moves the frame's origin by −S(r) ω; another point of the link by −S(offset) J_ω more.
        r = np.array([linear[1, 5], linear[2, 3], linear[0, 4]])
        offset = centre - np.asarray(golden["p"]) - r
        jacobians.append(linear + np.cross(angular, offset, axisa=0, axisb=0, axisc=0))
    agree("J_aero", jacobians, golden["J_aero"], TOLERANCE)

    cylinder = tomllib.loads((ROOT / "configs" / "aero" / "sphere_cylinder.toml").read_text(encoding="utf-8"))
    ours = rust.aero_forces(iron_cub, cylinder, tick.link_axes, tick.link_v_air)
    agree("f_aero_cyl", ours, golden["f_aero_cyl"], TOLERANCE)


def test_momentum_terms(golden, agree):
    tick = tick_of("test2", golden)
    agree("jet_axes", tick.jet_axes, golden["jet_axes"], TOLERANCE)
    agree("jet_arms", tick.jet_points - tick.com_position, golden["jet_arms"], TOLERANCE)
    agree("A_T", tick.a_t, golden["A_T"], TOLERANCE)
    agree("Lambda_T", tick.lambda_t, golden["Lambda_T"], TOLERANCE)
    agree("Lambda_a", tick.lambda_a, golden["Lambda_a"], TOLERANCE)
    agree("LDot", tick.momentum_rate_estimate, golden["LDot"], TOLERANCE)


def test_aware_controller(golden, agree):
    tick = tick_of("test2", golden)
    assert tick.status == "Nominal"
    agree("task_AB", tick.task[:6], golden["task_AB"], TOLERANCE)
    agree("task_delta", tick.task_offset[:6], golden["task_delta"], TOLERANCE)
    for key, ours in zip(("H", "g", "lb", "ub"), tick.momentum_qp, strict=True):
        agree(key, ours, golden[key], TOLERANCE)
    agree("u_aware", np.concatenate([tick.thrust_rate, tick.joint_velocity_command]), golden["u_aware"], TOLERANCE)
    assert tick.momentum_answer.active == golden["n_active"]
    agree("tau_H", tick.torque_qp.h, golden["tau_H"], TOLERANCE)
    agree("tau_g", tick.torque_qp.g, golden["tau_g"], TOLERANCE)
    agree("tau_aware", tick.unlimited_torque, golden["tau_aware"], TOLERANCE)


def test_baseline_controller(golden, agree):
    tick = tick_of("test1", golden)
    agree("H_baseline", tick.momentum_qp.h, golden["H_baseline"], TOLERANCE)
    agree("g_baseline", tick.momentum_qp.g, golden["g_baseline"], TOLERANCE)
    u = np.concatenate([tick.thrust_rate, tick.joint_velocity_command])
    agree("u_baseline", u, golden["u_baseline"], TOLERANCE)
