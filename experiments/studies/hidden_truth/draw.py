"""Robots whose truth is hidden: the list of ranges from which they are drawn, their flights and logs.

Written before the estimator that they judge. Robot r has wind r mod 3 and mission (r // 3) mod 3; of every 36 the last
nine, one for each pair, are outside the parametrisation. All numbers are uniform.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import plain_values, tables
from jax_aero.identify import excite
from jax_aero.results.study import find
from jax_aero.sweep.perturbation import Perturbation

Array = NDArray[np.float64]

EXPERIMENT = "robot"
"""Controller, sensors, engines, drives and air of every flight."""
WIDTHS = tables.load(find("perturbation", "unknown_robot"), Perturbation)
"""Masses, engines, sensors, delays, drives and air of every robot."""
TORQUE_GAIN = 0.1
"""Of the measured torques of each group of joints, relative: as harmonic drives without torque sensors have it."""
WEIGHING = 1e-3
"""Standard deviation of the weighing that `identify` is given, relative."""
WINDS: dict[str, dict[str, Any]] = {
    "still": {"profile": "constant", "velocity": [0.0, 0.0, 0.0]},
    "turbulent 5 m/s": {
        "profile": "turbulent", "velocity": [0.0, -5.0, 0.0], "std": [1.0, 1.0, 0.5], "time_scale": 2.0,
        "ramp_start": -2.0, "ramp_end": -1.0,
    },
    "ramp 10 m/s": {"profile": "ramp", "velocity": [0.0, -10.0, 0.0], "ramp_start": 5.0, "ramp_end": 10.0},
}  # fmt: skip
MISSIONS = ("excitation", "paper", "hover")
"""`--excite` of all axes; that of `EXPERIMENT`, as long as it lasts; no command for 60 s."""
LINK_MASS, LINK_CENTRE, LINK_INERTIA = 0.03, 0.003, 0.08
"""Outside: of every link's mass, relative, its centre along each axis [m], its inertia beside its mass, relative."""
LOAD, LOAD_LINK, LOAD_PLACE = 1.0, "chest", ((-0.1, 0.0, -0.15), (0.1, 0.2, 0.05))
"""Outside: a ball of 3 cm [kg], the link on which it is, and the corners of where, in its axes [m]."""


class Case(NamedTuple):
    """What robot number r meets."""

    wind: str
    mission: str
    is_outside: bool


def case_of(number: int) -> Case:
    """Return the case of a robot."""
    mission = MISSIONS[number // len(WINDS) % len(MISSIONS)]
    return Case(list(WINDS)[number % len(WINDS)], mission, number % 36 >= 27)


def flight_of(case: Case, folder: Path) -> rust.Config:
    """Return the flight of a case, of the file's robot."""
    config: rust.Config = {**rust.load_config(EXPERIMENT), "wind": WINDS[case.wind]}
    if case.mission == "excitation":
        return excite.flight(config, tuple(excite.AXES), folder)
    if case.mission == "hover":
        config = {**config, "mission": {}, "simulator": config["simulator"] | {"duration": 60.0}}
    return rust.resolve_config(config)


def draw(config: rust.Config, seed: int, number: int, folder: Path) -> tuple[rust.Config, Array]:
    """Return the flight of a drawn robot, and the gains of its measured torques (n,); files go to the folder.

    The controller's model is the robot's file with the errors of `WIDTHS`.
    """
    rng = np.random.default_rng([seed, number, 1])
    robot = rust.Robot(config["robot"])
    gains = np.ones(len(robot.joint_names))
    for joints in robot.joint_groups.values():
        gains[[robot.joint_names.index(name) for name in joints]] += rng.uniform(-TORQUE_GAIN, TORQUE_GAIN)
    drawn = copy.deepcopy(config)
    if case_of(number).is_outside:
        drawn["robot"] = str(write_outside(Path(config["robot"]), folder, rng))
    WIDTHS.apply(drawn, seed, number, robot)
    return drawn, gains


def write_outside(source: Path, folder: Path, rng: np.random.Generator) -> Path:
    """Write a robot whose links differ from the file's one by one, and that carries a load; return its path."""
    robot = rust.Robot(source)
    tree = ET.fromstring(robot.urdf_text)
    for inertial in tree.iterfind("link/inertial"):
        mass, inertia, origin = (inertial.find(tag) for tag in ("mass", "inertia", "origin"))
        if mass is None or inertia is None or float(mass.get("value", 0.0)) == 0.0:
            continue
        heavier = 1.0 + rng.uniform(-LINK_MASS, LINK_MASS)
        _scale(mass, heavier)
        _scale(inertia, heavier * (1.0 + rng.uniform(-LINK_INERTIA, LINK_INERTIA)))
        origin = ET.SubElement(inertial, "origin") if origin is None else origin
        place = np.array(origin.get("xyz", "0 0 0").split(), dtype=float)
        origin.set("xyz", _text(place + rng.uniform(-LINK_CENTRE, LINK_CENTRE, 3)))
    load = ET.SubElement(ET.SubElement(tree, "link", name="load"), "inertial")
    ET.SubElement(load, "mass", value=_text([LOAD]))
    ET.SubElement(load, "inertia", {"ixx": "4e-4", "iyy": "4e-4", "izz": "4e-4", "ixy": "0", "ixz": "0", "iyz": "0"})
    joint = ET.SubElement(tree, "joint", name="load", type="fixed")
    ET.SubElement(joint, "parent", link=LOAD_LINK)
    ET.SubElement(joint, "child", link="load")
    ET.SubElement(joint, "origin", xyz=_text(rng.uniform(*LOAD_PLACE)))
    ET.ElementTree(tree).write(folder / "outside.urdf", encoding="utf-8", xml_declaration=True)
    changed = {"base": str(source.resolve()), "urdf": "outside.urdf"}
    (folder / "outside.toml").write_text(plain_values.toml(changed) + "\n", encoding="utf-8")
    return folder / "outside.toml"


def _scale(element: ET.Element, factor: float) -> None:
    element.attrib |= {key: _text([factor * float(value)]) for key, value in element.attrib.items()}


def _text(numbers: Sequence[float] | Array) -> str:
    return " ".join(f"{number:.12g}" for number in numbers)
