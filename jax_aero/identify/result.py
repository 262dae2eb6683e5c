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
from jax_aero.base import plain
from jax_aero.body.robot import RobotModel
from jax_aero.train.identify import Numbers, robot_with


def write_robot(folder: Path, source: Path, robot: RobotModel, numbers: Numbers, notes: Sequence[str]) -> Path:
    """Write `robot.toml`, which builds on the `source` file, and its URDF; return the path of the former.

    Inertias are scaled link by link, also those of links that move together.
    """
    before = rust.Robot(source)
    table, tree = tomllib.loads(before.toml_text), ET.fromstring(before.urdf_text)
    mass, inertia = 1.0 + float(numbers.mass), (1.0 + float(numbers.mass)) * (1.0 + float(numbers.inertia))
    # The heaviest link of the base body is moved for the whole body.
    parts = {name: pose for name, (body, pose) in before.links().items() if body == 0}
    weights = {
        link: float(own.get("value", 0.0))
        for link in tree.iter("link")
        if link.get("name") in parts and (own := link.find("inertial/mass")) is not None
    }
    heaviest = max(weights, key=lambda link: weights[link])
    rotation, _ = parts[str(heaviest.get("name"))]
    inertial = heaviest.find("inertial")
    assert inertial is not None  # since it has a mass
    origin = inertial.find("origin")
    origin = ET.SubElement(inertial, "origin") if origin is None else origin
    place = np.array(origin.get("xyz", "0 0 0").split(), dtype=float)
    moved = rotation.T @ np.asarray(numbers.com) * float(robot.masses[0]) / weights[heaviest]
    origin.set("xyz", _text(place + moved))
    for tag, factor in (("mass", mass), ("inertia", inertia)):
        for element in tree.iterfind(f"link/inertial/{tag}"):
            element.attrib |= {key: _text(factor * float(value)) for key, value in element.attrib.items()}
    ET.ElementTree(tree).write(folder / "robot.urdf", encoding="utf-8", xml_declaration=True)
    axes = np.asarray(robot_with(robot, numbers).jets.axes)
    jets = [dict(jet) | {"axis": axis.tolist()} for jet, axis in zip(table["jets"], axes, strict=True)]
    changed = {"base": str(source.resolve()), "urdf": "robot.urdf", "jets": jets}
    text = "".join(f"# {note}\n" for note in notes) + plain.toml(changed) + "\n"
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    return folder / "robot.toml"


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
    (folder / "perturbation.toml").write_text(plain.toml(widths) + "\n", encoding="utf-8")
    return folder / "perturbation.toml"


def _text(numbers: NDArray[np.float64] | float) -> str:
    return " ".join(f"{number:.10g}" for number in np.atleast_1d(numbers))


def write_experiment(folder: Path, config: rust.Config, robot: RobotModel, numbers: Numbers) -> Path:
    """Write `experiment.toml`: a world with drives, sensors and engines as found; the controller knows the drives."""
    simulator, disturbances = dict(config["simulator"]), dict(config.get("disturbances", {}))
    sensors = dict(simulator.get("sensors") or {})
    sensors["base_rotation"] = sensors.get("base_rotation", {}) | {"bias": np.asarray(numbers.imu).tolist()}
    sensors["joints"] = sensors.get("joints", {}) | {"bias": np.asarray(numbers.encoders).tolist()}
    simulator["sensors"] = sensors
    controller = config["controller"]
    if simulator.get("motors"):
        friction = np.maximum(np.asarray(numbers.friction), 0.0).tolist()
        of_joints = dict(zip(robot.joint_names, friction, strict=True))
        simulator["motors"] = simulator["motors"] | {"friction_of": of_joints}
        torque = controller["torque"] | {"friction": frictions(robot, numbers.friction)}
        controller = controller | {"torque": torque}
    gains = dict(zip(robot.jets.names, (1.0 + np.asarray(numbers.thrust_gain)).tolist(), strict=True))
    disturbances["jets"] = disturbances.get("jets", {}) | {"force_scale": gains}
    disturbances.pop("model_error", None)
    changed = {"simulator": simulator, "disturbances": disturbances, "controller": controller, "robot": "robot.toml"}
    flown = {**config, **changed}
    (folder / "experiment.toml").write_text(plain.toml(flown) + "\n", encoding="utf-8")
    return folder / "experiment.toml"
