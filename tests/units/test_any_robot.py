"""Robots without joints, without jets and with prismatic joints fly, in both engines alike; limits are each joint's."""

import warnings

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.places import CONFIGS
from jax_aero.base.terminal import exit_status
from jax_aero.body.robot import load_robot


def hover_of(robot, jets, duration):
    """The platform's experiment with another robot and its jets."""
    config = rust.load_config(CONFIGS / "experiments/platform_hover.toml")
    config["robot"] = str(robot)
    config["simulator"]["duration"] = duration
    config["controller"]["weights"]["thrust_rate"] = dict.fromkeys(jets, 0.01)
    config["controller"]["bounds"]["thrust_rate_max"] = dict.fromkeys(jets, 100.0)
    return config


@pytest.fixture
def without_jets(tmp_path):
    """The platform's plate alone."""
    text = (CONFIGS / "robot/platform.toml").read_text()
    head, rest = text.split("[[jets]]", 1)
    (tmp_path / "plate.toml").write_text(head + rest[rest.index("[engines.E80]") :])
    (tmp_path / "platform.urdf").write_text((CONFIGS / "robot/platform.urdf").read_text())
    return tmp_path / "plate.toml"


def test_sensors_of_a_platform_without_joints_fly_in_both_engines(fly_both):
    """What they measure of the joint velocities is the empty end of a vector."""
    sensors = {"base_linear_velocity": {"noise_std": 0.01}}
    changes = {"simulator.duration": 0.3, "simulator.sensors": sensors}
    ours, _ = fly_both(rust.load_config(CONFIGS / "experiments/platform_hover.toml", changes))
    assert ours.outcome == "completed"


def test_a_robot_without_jets_falls_as_gravity_has_it(without_jets, fly_both):
    config = hover_of(without_jets, (), duration=0.4)
    config["simulator"]["initial"]["thrust"] = []
    config["simulator"]["aero"] = config["controller"]["aero"] = {"model": "off"}
    ours, twin = fly_both(config)
    ticks = np.arange(41)
    expected = 0.8 - 9.81 * 0.01**2 * ticks * (ticks + 1) / 2  # semi-implicit Euler
    for flight in (ours, twin):
        assert flight.outcome == "completed"
        assert np.abs(flight.log["com_position"][:, 2] - expected).max() < 1e-12
        assert (flight.log["qp_status"] == 0).all()
        assert [flight.summary[f"thrust_{end}"] for end in ("min", "max")] == [0.0, 0.0]


def slider():
    """The robot with prismatic joints, held for half a second by a controller of its own."""
    config = hover_of(CONFIGS / "robot/slider.toml", ("front_jet", "back_jet", "piston_jet"), duration=0.5)
    config["controller"]["posture_gain"] = {"boom": 20.0}
    config["simulator"]["initial"] |= {"joint_position": [0.02, 0.1, 0.01], "thrust": [40.0, 45.0, 40.0]}
    return config


def sparrow():
    """Sparrow climbs, flies five seconds forwards in a side wind and descends."""
    jets = ("back_jet", "l_jet", "r_jet")
    config = hover_of(CONFIGS / "robot/sparrow.toml", jets, duration=14.0)
    config["mission"] = {"up": [[1.0, 3.0]], "forward": [[4.0, 9.0]], "down": [[10.0, 12.0]]}
    config["wind"] = {"profile": "ramp", "velocity": [0.0, -2.0, 0.0], "ramp_start": 1.0, "ramp_end": 3.0}
    controller = config["controller"]
    controller["posture_gain"] = {"legs": 30.0, "upper_body": 20.0}
    # Its jets hardly turn it about the vertical: swinging limbs would.
    controller["weights"] |= {"symmetric_jets": [["l_jet", "r_jet"]], "symmetry": 0.1, "posture": 1000.0}
    controller["momentum"] |= {"c0": 10.0, "c1": 100.0}
    config["simulator"]["initial"] |= {"joint_position": [0.0] * 5, "thrust": [15.0, 58.0, 58.0]}
    return config


def test_the_sparrow_flies_a_whole_mission_forward_in_both_engines(fly_both):
    ours, twin = fly_both(sparrow())
    for flight in (ours, twin):
        assert flight.outcome == "completed"
        assert (flight.log["qp_status"] == 0).all()
        com = flight.log["com_position"]
        # 0.75 m/s for five seconds forwards (x) and for two seconds up and down.
        assert np.abs(com[-1] - com[0] - [3.75, 0.0, 0.0]).max() < 0.05
        assert abs(com[:, 2].max() - com[0, 2] - 1.49) < 0.05
        assert flight.summary["max_com_error"] < 0.05


def test_torques_and_their_rates_and_velocities_keep_to_each_joints_own_limits():
    robot = load_robot(CONFIGS / "robot/slider.toml")
    # TOML over URDF: force [N] and torque [N m], rates, velocities.
    assert robot.joint_torque_max.tolist() == [100.0, 30.0, 80.0]
    assert robot.joint_torque_rate_max.tolist() == [900.0, np.inf, np.inf]
    assert np.allclose(robot.joint_velocity_max, [0.4, np.pi / 2, 0.5], rtol=1e-15)
    config = slider()
    config["simulator"]["initial"]["joint_position"] = [0.1, 0.5, 0.0]
    flight = rust.fly(config)
    torque = flight.log["joint_torque"]
    assert (np.abs(torque) <= robot.joint_torque_max + 1e-9).all()
    assert np.abs(np.diff(torque[:, 0])).max() <= 9.0 + 1e-9
    assert (np.abs(flight.log["joint_velocity_command"]) <= robot.joint_velocity_max + 1e-9).all()
    # What a controller says instead holds for joints that turn, and not for N and m/s.
    config["controller"]["torque"]["torque_max"] = 7.0
    config["controller"]["bounds"]["joint_velocity_max_deg"] = 10.0
    tick = rust.Controller(config).tick(
        rust.State(np.zeros(3), np.eye(3), np.array([0.1, 0.5, 0.0]), np.zeros(9)), np.full(3, 40.0), np.zeros(3)
    )
    assert tick.torque_qp.upper.tolist() == [100.0, 7.0, 80.0]
    assert tick.momentum_qp.upper[4] <= np.radians(10.0)


def test_the_legs_of_mk1_have_the_torques_of_their_motors():
    """Ten joints can give 37 N m; the published 50 N m for all are a configuration."""
    robot = load_robot(CONFIGS / "robot/ironcub_mk1.toml")
    assert np.count_nonzero(robot.joint_torque_max == 37.0) == 10
    state = rust.State(np.zeros(3), np.eye(3), np.zeros(23), np.zeros(29))
    for name, expected in (("test2", robot.joint_torque_max), ("test2_published", np.full(23, 50.0))):
        tick = rust.Controller(rust.load_config(CONFIGS / f"experiments/{name}.toml")).tick(
            state, np.full(4, 100.0), np.zeros(3)
        )
        assert tick.torque_qp.upper.tolist() == expected.tolist()


def test_an_axis_that_is_nearly_of_length_one_is_made_so(tmp_path):
    for suffix, old, new in (
        (".toml", "axis = [0.0, 0.0, 1.0]", "axis = [0.0, 0.0, 1.0000005]"),
        (".urdf", '"1 0 0"', '"1.0000005 0 0"'),
    ):
        text = (CONFIGS / f"robot/slider{suffix}").read_text()
        assert old in text
        (tmp_path / f"slider{suffix}").write_text(text.replace(old, new))
    robot = load_robot(tmp_path / "slider.toml")
    for axes in (robot.joint_axes, robot.jets.axes, robot.aero_links.axes):
        np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, rtol=1e-15)


def test_commands_print_a_warning_about_a_file_in_one_line_and_once(monkeypatch):
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)
    assert exit_status(lambda: 0) == 0
    said = [warnings.formatwarning(UserWarning(text), UserWarning, "file.py", 1) for text in ("axis", "axis", "mass")]
    assert said == ["warning: axis\n", "", "warning: mass\n"]
