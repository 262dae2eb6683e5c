"""Faulty joints in JAX against the Rust crate: what they do, what is found of them, and how the robot flies on."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.config import JointFault
from jax_aero.control.guard import joints
from jax_aero.control.modes import MODES
from jax_aero.joint_faults import begin_tick, reduce_torque, start_faults
from jax_aero.robot import load_robot

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
EXPERIMENTS = CONFIGS / "experiments"


def test_faults_act_from_their_onset_on():
    robot = load_robot(CONFIGS / "robot" / "ironcub_mk1.toml")
    kinds = {"l_elbow": "weak", "r_elbow": "free", "torso_yaw": "stuck"}
    configs = [JointFault(joint=joint, kind=kind, start=0.03, share=0.5) for joint, kind in kinds.items()]
    faults, state = start_faults(configs, robot)
    faulty = [robot.joint_names.index(joint) for joint in kinds]
    for tick in range(6):
        state = begin_tick(faults, state, jnp.array(0.01), jnp.full(robot.n_joints, float(tick)))
        acting = np.asarray(reduce_torque(faults, state, jnp.full(robot.n_joints, 2.0)))
        expected = np.full(robot.n_joints, 2.0)
        if tick >= 3:
            expected[faulty] = [1.0, 0.0, 2.0]
        np.testing.assert_array_equal(acting, expected)
    assert float(state.held[faulty[2]]) == 3.0
    assert np.asarray(faults.is_stuck & state.acts).nonzero()[0].tolist() == [faulty[2]]


@pytest.mark.parametrize(
    ("experiment", "faults"),
    [
        ("test2_observer", [("l_elbow", "weak", 2.1), ("r_shoulder_pitch", "weak", 2.4)]),
        ("test2_observer", [("l_elbow", "free", 2.1), ("torso_roll", "stuck", 0.5)]),
        ("test2_sensors", [("l_shoulder_yaw", "weak", 2.1), ("r_elbow", "stuck", 1.0)]),
    ],
)
def test_a_flight_with_faulty_joints(experiment, faults, measured):
    """Both engines find the same in the same ticks; the mission moves the joints of a robot that stands in the wind."""
    changes = {
        "controller.joints": {"acceleration_max": 20.0, "share_max": 0.7, "displacement_min": 0.005},
        "simulator.duration": 2.8,
        "mission.forward": [[0.2, 2.8]],
        "disturbances.joints": [{"joint": joint, "kind": kind, "start": start} for joint, kind, start in faults],
    }
    if experiment == "test2_sensors":
        changes["simulator.sensors.joints.resolution"] = 0.0  # steps of encoders multiply rounding
    table = rust.load_config(EXPERIMENTS / f"{experiment}.toml", changes)
    theirs, ours = rust.fly(table), sim.fly(table)
    assert ours.outcome == theirs.outcome
    np.testing.assert_array_equal(ours.log["joint_condition"], theirs.log["joint_condition"])
    np.testing.assert_array_equal(ours.log["degraded_modes"], theirs.log["degraded_modes"])
    assert (theirs.log["degraded_modes"].astype(int) & MODES["joint_limited"]).any()
    assert set(np.unique(theirs.log["joint_condition"])) > {0.0}
    for name in ("base_position", "joint_position", "joint_torque", "unmodelled_wrench"):
        scale = max(1.0, np.abs(theirs.log[name]).max())
        difference = np.abs(ours.log[name] - theirs.log[name]).max() / scale
        measured(name, difference, 1e-7, because="rounding, which a joint without torque multiplies")


def test_a_weak_joint_is_found_with_its_share():
    with jax.enable_x64(True):
        limits = joints.JointLimits(jnp.array(20.0), jnp.array(0.7), jnp.array(0.005))
        gain = jnp.array([[40.0, -8.0], [-8.0, 60.0]])
        state = joints.start(jnp.array([0.1, 0.2]))._replace(pause=jnp.array(0.0), torque=jnp.array([4.0, -3.0]))
        step, dt = jax.jit(joints.judge), jnp.array(0.01)
        for tick in range(8):
            state = joints.measure(state, jnp.array([0.1 + 0.01 * tick, 0.2]), jnp.array(True), dt)
            lost = (0.4 - state.share[0]) * 4.0
            state = step(limits, state, dt, gain @ jnp.array([lost, 0.0]), gain, jnp.array([[-1.0, 1.0]] * 2))
        np.testing.assert_allclose(state.share, [0.4, 1.0], rtol=0, atol=1e-12)
        assert state.is_limited.tolist() == [True, False]
