"""The benchmark beside other libraries: its SDF is the whole robot, and other accelerations are refused."""

from xml.etree import ElementTree

import numpy as np
import pytest

from experiments.tools import bench_peers as bench
from jax_aero.base.places import CONFIGS
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import load_robot


def test_the_sdf_has_every_body_and_joint():
    robot = load_robot(CONFIGS / "robot" / "ironcub_mk1.toml")
    model = ElementTree.fromstring(bench.to_sdf(robot))[0]
    links, joints = model.findall("link"), model.findall("joint")
    assert [link.get("name") for link in links] == list(robot.body_names)
    assert [joint.get("name") for joint in joints] == list(robot.joint_names)
    assert [joint.findtext("child") for joint in joints] == list(robot.body_names[1:])
    assert [robot.body_names.index(joint.findtext("parent")) for joint in joints] == list(robot.parent[1:])
    assert [float(link.findtext("inertial/mass")) for link in links] == list(robot.masses)
    traces = [sum(float(link.findtext(f"inertial/inertia/{key}")) for key in ("ixx", "iyy", "izz")) for link in links]
    assert traces == pytest.approx(np.trace(robot.inertias, axis1=1, axis2=2), rel=1e-12)


def test_a_library_with_other_accelerations_is_refused():
    ours = bench.Peer(np.eye(3), np.eye(3), lambda: None)
    found = bench.measure({"JAX": ours, "same": ours._replace(gradient=None)}, 1)
    assert found["same"][bench.DIFFERENCE] == 0.0
    assert bench.FORWARD in found["same"]
    for changed in ({"accelerations": 1.001 * np.eye(3)}, {"gradient": np.full((3, 3), np.nan)}):
        with pytest.raises(Refused, match=f"^other and JAX differ in {next(iter(changed))} by"):
            bench.measure({"JAX": ours, "other": ours._replace(**changed)}, 1)
