"""The files of an identified robot: one that builds on the old one, and an experiment that flies it."""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import plain_values
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotation_from_rpy
from jax_aero.identify.motion import Model, Numbers, robot_with

Array = NDArray[np.float64]


def write_robot(folder: Path, source: Path, model: Model, numbers: Numbers, notes: Sequence[str]) -> Path:
    """Write `robot.toml`, which builds on the `source` file, and its URDF; return the path of the former.

    Of links that move together all masses and inertias are scaled; the heaviest takes what else makes the body's.
    """
    before, robot = rust.Robot(source), robot_with(model, numbers)
    table, tree = tomllib.loads(before.toml_text), ET.fromstring(before.urdf_text)
    elements = {str(link.get("name")): link.find("inertial") for link in tree.iter("link")}
    for body in range(len(robot.masses)):
        links = [
            _Inertial(element, *pose)
            for name, (of, pose) in before.links().items()
            if of == body and (element := elements.get(name)) is not None and _mass_of(element) > 0.0
        ]
        if links:
            _distribute(links, *(np.asarray(part)[body] for part in (robot.masses, robot.coms, robot.inertias)))
    ET.ElementTree(tree).write(folder / "robot.urdf", encoding="utf-8", xml_declaration=True)
    jets = [
        dict(jet) | {"axis": axis.tolist()}
        for jet, axis in zip(table["jets"], np.asarray(robot.jets.axes), strict=True)
    ]
    changed = {"base": str(source.resolve()), "urdf": "robot.urdf", "jets": jets}
    text = "".join(f"# {note}\n" for note in notes) + plain_values.toml(changed) + "\n"
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    return folder / "robot.toml"


def _mass_of(element: ET.Element) -> float:
    mass = element.find("mass")
    return 0.0 if mass is None else float(mass.get("value", 0.0))


class _Inertial:
    """Mass, centre and inertia about it of a link, in axes of its body."""

    def __init__(self, element: ET.Element, rotation: Array, position: Array) -> None:
        self.element, self.position = element, position
        origin = element.find("origin")
        self.origin = ET.SubElement(element, "origin") if origin is None else origin
        place, rpy = (np.array(self.origin.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
        self.link = rotation
        self.rotation = rotation @ np.asarray(rotation_from_rpy(rpy))
        self.mass, self.com = _mass_of(element), position + rotation @ place
        tensor = element.find("inertia")
        self.tensor = ET.SubElement(element, "inertia") if tensor is None else tensor
        rows = np.array([[self.tensor.get("i" + "".join(sorted(a + b)), 0.0) for a in "xyz"] for b in "xyz"], float)
        self.inertia = self.rotation @ rows @ self.rotation.T

    def about(self, point: Array) -> Array:
        """Return the inertia about a point of the body."""
        arm = self.com - point
        moved: Array = self.inertia + self.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return moved

    def write(self) -> None:
        """Write it into the element."""
        mass = self.element.find("mass")
        assert mass is not None  # since it is not zero
        mass.set("value", _text(self.mass))
        self.origin.set("xyz", _text(self.link.T @ (self.com - self.position)))
        rows = self.rotation.T @ self.inertia @ self.rotation
        for row, column in zip(*np.triu_indices(3), strict=True):
            self.tensor.set("i" + "xyz"[row] + "xyz"[column], _text(rows[row, column]))


def _distribute(links: Sequence[_Inertial], mass: float, com: Array, inertia: Array) -> None:
    """Give the links of a body its mass, centre and inertia about it; the heaviest takes what scaling leaves."""
    *others, heaviest = sorted(links, key=lambda link: link.mass)
    before = sum(link.mass for link in links)
    centre = sum((link.mass * link.com for link in links), np.zeros(3)) / before
    factor = np.trace(inertia) / np.trace(sum(link.about(centre) for link in links))
    for link in links:
        link.mass, link.inertia = link.mass * mass / before, link.inertia * factor
    heaviest.com = (mass * com - sum((link.mass * link.com for link in others), np.zeros(3))) / heaviest.mass
    heaviest.inertia = heaviest.inertia + inertia - sum(link.about(com) for link in links)
    for link in links:
        link.write()


def frictions(robot: RobotModel, friction: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Return `controller.torque.friction`: the mean of each group's joints [N m]."""
    known = np.maximum(np.asarray(friction), 0.0)
    return {name: float(np.mean(known[list(joints)])) for name, joints in robot.joint_groups}


def write_perturbation(folder: Path, deviation: Numbers) -> Path:
    """Write `perturbation.toml`: uniform distributions as wide as what is left unknown, for a sweep or the next log."""
    radians = {"thrust_axis_deg": deviation.thrust_axes, "imu_deg": deviation.imu, "encoders_deg": deviation.encoders}
    of = {name: getattr(deviation, name) for name in ("mass", "com", "inertia", "thrust_gain")}
    of |= {name: np.degrees(part) for name, part in radians.items()}
    widths = {
        name: float(f"{np.sqrt(3.0 * np.mean(np.square(part))):.3g}") for name, part in of.items() if np.size(part)
    }
    (folder / "perturbation.toml").write_text(plain_values.toml(widths) + "\n", encoding="utf-8")
    return folder / "perturbation.toml"


def _text(numbers: NDArray[np.float64] | float) -> str:
    return " ".join(f"{number:.10g}" for number in np.atleast_1d(numbers))


def write_experiment(folder: Path, config: rust.Config, robot: RobotModel, numbers: Numbers, is_found: Numbers) -> Path:
    """Write `experiment.toml`: a world with drives, sensors and engines as found; the controller models the drives.

    What of drives and delays is not found stays as in the configuration.
    """
    simulator, disturbances = dict(config["simulator"]), dict(config.get("disturbances", {}))
    sensors = dict(simulator.get("sensors") or {})
    sensors["base_rotation"] = sensors.get("base_rotation", {}) | {"bias": np.asarray(numbers.imu).tolist()}
    sensors["joints"] = sensors.get("joints", {}) | {"bias": np.asarray(numbers.encoders).tolist()}
    if "thrust" in sensors and robot.jets.count:
        sensors["thrust"] = sensors["thrust"] | {"bias": float(np.mean(numbers.thrust_offset))}
    simulator["sensors"] = sensors
    controller = config["controller"]
    if motors := simulator.get("motors"):
        before = motors.get("friction_of") or {}
        stated = np.array([before.get(name, motors["friction"]) for name in robot.joint_names])
        friction = np.where(is_found.friction > 0.0, np.maximum(np.asarray(numbers.friction), 0.0), stated)
        motors = motors | {"friction_of": dict(zip(robot.joint_names, friction.tolist(), strict=True))}
        if is_found.damping:
            motors["damping"] = max(float(numbers.damping), 0.0)
        simulator["motors"] = motors
        known = controller["torque"].get("friction") or {}
        groups = dict(robot.joint_groups)
        means = frictions(robot, friction)
        known_friction = {name: mean for name, mean in means.items() if np.any(is_found.friction[list(groups[name])])}
        controller = controller | {"torque": controller["torque"] | {"friction": known | known_friction}}
    if (actuation := simulator.get("actuation")) and is_found.delay[1]:
        step = controller["time_step"] / simulator["substeps"]
        late = max(actuation.get("torque_delay", 0.0) + float(numbers.delay[1]), 0.0)
        simulator["actuation"] = actuation | {"torque_delay": step * round(late / step)}
    gains = dict(zip(robot.jets.names, (1.0 + np.asarray(numbers.thrust_gain)).tolist(), strict=True))
    disturbances["jets"] = disturbances.get("jets", {}) | {"force_scale": gains}
    disturbances.pop("model_error", None)
    changed = {"simulator": simulator, "disturbances": disturbances, "controller": controller, "robot": "robot.toml"}
    flown = {**config, **changed}
    (folder / "experiment.toml").write_text(plain_values.toml(flown) + "\n", encoding="utf-8")
    return folder / "experiment.toml"
