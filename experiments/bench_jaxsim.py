"""Jaxsim with our robot, for `experiments.bench_jax`: the tree of merged bodies as SDF, and the measured functions.

Jaxsim needs the tools of Gazebo to read a URDF, but reads SDF by itself. It is not a dependency of this package:
`pip install jaxsim` (importing it switches JAX to double precision).
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np

from jax_aero.robot import RobotModel
from jax_aero.spatial import rpy_from_rotation, wxyz_from_rotation
from jax_aero.types import State


def lumped_sdf(robot: RobotModel) -> str:
    """Return the tree of moving bodies as SDF, with bodies named after their joints and our origins and axes."""
    sdf = ElementTree.Element("sdf", version="1.7")
    model = ElementTree.SubElement(sdf, "model", name="robot", canonical_link="base")
    links = ["base", *(f"{joint}_body" for joint in robot.joint_names)]
    for body, name in enumerate(links):
        link = ElementTree.SubElement(model, "link", name=name)
        if body:
            _pose(link, np.zeros(3), np.zeros(3), relative_to=robot.joint_names[body - 1])
        inertial = ElementTree.SubElement(link, "inertial")
        _pose(inertial, robot.coms[body], np.zeros(3))
        ElementTree.SubElement(inertial, "mass").text = repr(float(robot.masses[body]))
        inertia = ElementTree.SubElement(inertial, "inertia")
        for entry, (i, j) in {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2)}.items():
            ElementTree.SubElement(inertia, entry).text = repr(float(robot.inertias[body][i, j]))
        ElementTree.SubElement(inertia, "izz").text = repr(float(robot.inertias[body][2, 2]))
    for index, name in enumerate(robot.joint_names):
        joint = ElementTree.SubElement(model, "joint", name=name, type="revolute")
        parent = links[robot.parent[index + 1]]
        rpy = np.asarray(rpy_from_rotation(jnp.asarray(robot.joint_rotations[index])))
        _pose(joint, robot.joint_positions[index], rpy, relative_to=parent)
        ElementTree.SubElement(joint, "parent").text = parent
        ElementTree.SubElement(joint, "child").text = links[index + 1]
        axis = ElementTree.SubElement(joint, "axis")
        ElementTree.SubElement(axis, "xyz").text = _numbers(robot.joint_axes[index])
        limit = ElementTree.SubElement(axis, "limit")
        for end, value in zip(("lower", "upper"), robot.joint_limits[index], strict=True):
            ElementTree.SubElement(limit, end).text = repr(float(value))
    return ElementTree.tostring(sdf, encoding="unicode")


def _pose(of: ElementTree.Element, position: Any, rpy: Any, relative_to: str | None = None) -> None:
    pose = ElementTree.SubElement(of, "pose", {} if relative_to is None else {"relative_to": relative_to})
    pose.text = f"{_numbers(position)} {_numbers(rpy)}"


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values))


def functions(robot: RobotModel) -> tuple[Any, dict[str, Callable[[Any, State], Any]]]:
    """Return jaxsim's model of the robot, and the measured functions of (model, our state) by name.

    Raises
    ------
    ImportError
        If jaxsim is not installed.
    """
    api: Any = importlib.import_module("jaxsim.api")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.sdf"
        path.write_text(lumped_sdf(robot), encoding="utf-8")
        model = api.model.JaxSimModel.build_from_model_description(
            path, considered_joints=list(robot.joint_names), gravity=float(robot.gravity)
        )
    order = np.array([robot.joint_names.index(name) for name in model.joint_names()])

    def data(model: Any, state: State) -> Any:
        return api.data.JaxSimModelData.build(
            model=model,
            base_position=state.base_position,
            base_quaternion=wxyz_from_rotation(state.base_rotation),
            joint_positions=state.joint_position[order],
            base_linear_velocity=state.velocity[:3],
            base_angular_velocity=state.velocity[3:6],
            joint_velocities=state.velocity[6:][order],
            velocity_representation=api.common.VelRepr.Mixed,
        )

    def aba(model: Any, state: State) -> Any:
        base, joints = api.model.forward_dynamics_aba(model=model, data=data(model, state))
        return base, joints

    def mass_and_bias(model: Any, state: State) -> Any:
        held = data(model, state)
        mass = api.model.free_floating_mass_matrix(model=model, data=held)
        return mass, api.model.free_floating_bias_forces(model=model, data=held)

    return model, {"jaxsim: articulated-body algorithm": aba, "jaxsim: M and h": mass_and_bias}
