"""The numbers of a robot as stated in its TOML and URDF files, without merging or derived values.

The crate decides which robots are accepted; their numbers are read again here, independently of it.
"""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jax_aero import rust

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Inertial:
    """Mass distribution of one URDF link as a cloud of points: total mass, centre and second moment about it."""

    link: str
    mass: float
    """Mass [kg]."""
    centre: Array
    """(3,) centre of mass in link axes [m]."""
    scatter: Array
    """(3, 3) second moment ∫ ρ ρᵀ dm about the centre in link axes [kg m²]; the inertia is tr(scatter) 1 − scatter."""


@dataclass(frozen=True)
class Joint:
    """A URDF joint. `index` is its index in the joint vector, or `None` for one that is locked at `locked_at`."""

    parent: str
    child: str
    position: Array
    """(3,) origin of the child in parent axes [m]."""
    rpy: Array
    """(3,) attitude of the child at joint position zero [rad]."""
    axis: Array
    """(3,) unit axis in child axes."""
    is_prismatic: bool
    """Whether the child translates along the axis [m] instead of rotating about it [rad]."""
    index: int | None
    locked_at: float


@dataclass(frozen=True)
class Jet:
    """An engine with thrust along `axis` of its frame, at a point of it; the exhaust leaves along −`axis`."""

    name: str
    frame: str
    position: Array
    """Point in frame axes [m]."""
    axis: Array
    torque_to_thrust: float
    """Moment about the axis per thrust [m]."""
    thrust_min: float
    """Least thrust of an engine that runs [N]."""
    thrust_max: float
    """Greatest thrust [N]."""


@dataclass(frozen=True)
class AeroLink:
    """An aerodynamic link: the point at which its force acts, its axis of symmetry and its size."""

    name: str
    frame: str
    family: str
    axis: Array
    centre: Array
    diameter: float
    length: float
    is_sphere: bool


@dataclass(frozen=True)
class Robot:
    """Numbers of one robot; SI units and radians."""

    name: str
    base: str
    gravity: float
    joint_names: tuple[str, ...]
    joint_limits: Array
    """(n, 2) lower and upper limits that the controller respects [rad]."""
    joint_torque_max: Array
    """(n,) greatest torques [N m]."""
    joints: tuple[Joint, ...]
    """All URDF joints, parents before their children."""
    inertials: tuple[Inertial, ...]
    jets: tuple[Jet, ...]
    aero_links: tuple[AeroLink, ...]
    coefficients: Mapping[str, Mapping[str, Mapping[str, Any]]]
    """Coefficients by set and link family: `cda` (5) and `cna` [m²]."""
    soles: Mapping[str, Array]
    """(k, 3) corners of the soles in sole axes [m], by sole frame."""

    @property
    def n_joints(self) -> int:
        """Number of moving joints."""
        return len(self.joint_names)

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return sum(inertial.mass for inertial in self.inertials)

    @property
    def thrust_min(self) -> Array:
        """(jets,) least thrusts of engines that run [N]."""
        return np.array([jet.thrust_min for jet in self.jets])

    @property
    def thrust_max(self) -> Array:
        """(jets,) greatest thrusts [N]."""
        return np.array([jet.thrust_max for jet in self.jets])

    @property
    def hover_thrust(self) -> Array:
        """(jets,) thrusts that share the weight in proportion to the greatest thrusts [N]."""
        return np.asarray(self.mass * self.gravity * self.thrust_max / self.thrust_max.sum())


def load_robot(path: str | Path) -> Robot:
    """Read a robot's TOML file and the URDF beside it.

    Raises
    ------
    ValueError
        If the crate refuses the robot.
    """
    accepted = rust.Robot(path)
    table = tomllib.loads(accepted.toml_text)
    urdf = _without_namespace(ET.fromstring(accepted.urdf_text))
    entries = [entry for group in table.get("joint_groups", []) for entry in group["joints"]]
    names = tuple(entry["name"] for entry in entries)
    joints = _joints(urdf, table["base_link"], names, table.get("locked", {}))
    limits = {element.get("name"): element.find("limit") for element in urdf.findall("joint")}
    return Robot(
        name=table["name"],
        base=table["base_link"],
        gravity=table.get("gravity", 9.81),
        joint_names=names,
        joint_limits=np.reshape([_limits(entry, limits[entry["name"]]) for entry in entries], (-1, 2)),
        joint_torque_max=np.array([_torque_max(entry, limits[entry["name"]]) for entry in entries]),
        joints=joints,
        inertials=tuple(_inertials(urdf)),
        jets=tuple(
            Jet(
                name=row["name"],
                frame=row["frame"],
                position=np.array(row.get("position", [0.0, 0.0, 0.0]), dtype=float),
                axis=_unit_vector(row["axis"]),
                torque_to_thrust=row.get("torque_to_thrust", 0.0),
                thrust_min=row.get("thrust_min", 0.0),
                thrust_max=row["thrust_max"],
            )
            for row in table.get("jets", [])
        ),
        aero_links=tuple(
            AeroLink(
                name=row["name"],
                frame=row["frame"],
                family=row["family"],
                axis=_unit_vector(row["axis"]),
                centre=np.array(row["centre"], dtype=float),
                diameter=row["diameter"],
                length=row["length"],
                is_sphere=row.get("is_sphere", False),
            )
            for row in table.get("aero_links", [])
        ),
        coefficients=table.get("coefficients", {}),
        soles={row["frame"]: np.array(row["vertices"], dtype=float) for row in table.get("feet", [])},
    )


def _joints(urdf: ET.Element, base: str, names: Sequence[str], locked: Mapping[str, float]) -> tuple[Joint, ...]:
    """Return the joints in an order in which every parent precedes its children."""
    elements = {element.get("name", ""): element for element in urdf.findall("joint")}
    waiting = dict(elements)
    known = {base}
    joints: list[Joint] = []
    while waiting:
        ready = [name for name, element in waiting.items() if _link(element, "parent") in known]
        for name in ready:
            element = waiting.pop(name)
            kind = element.get("type")
            axis = element.find("axis")
            joints.append(
                Joint(
                    parent=_link(element, "parent"),
                    child=_link(element, "child"),
                    position=_numbers(element.find("origin"), "xyz"),
                    rpy=_numbers(element.find("origin"), "rpy"),
                    axis=np.array([1.0, 0.0, 0.0])
                    if axis is None or kind == "fixed"
                    else _unit_vector(_numbers(axis, "xyz")),
                    is_prismatic=kind == "prismatic",
                    index=names.index(name) if name in names else None,
                    locked_at=0.0 if name in names else _held_at(name, elements, locked),
                )
            )
            known.add(joints[-1].child)
    return tuple(joints)


def _held_at(name: str, joints: Mapping[str, ET.Element], locked: Mapping[str, float]) -> float:
    """Return the position of a joint that does not move [rad, m]: one that mimics another follows it."""
    mimic = joints[name].find("mimic")
    if name in locked or mimic is None or joints[name].get("type") == "fixed":
        return float(locked.get(name, 0.0))
    led_by = _held_at(mimic.get("joint", ""), joints, locked)
    return float(mimic.get("multiplier", 1.0)) * led_by + float(mimic.get("offset", 0.0))


def _inertials(urdf: ET.Element) -> list[Inertial]:
    found = []
    for link in urdf.findall("link"):
        element = link.find("inertial")
        if element is None or float(_child(element, "mass").get("value", "nan")) == 0.0:
            continue
        entries = _child(element, "inertia")
        xx, xy, xz, yy, yz, zz = (float(entries.get(key, "nan")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        # URDF: Rz(yaw) Ry(pitch) Rx(roll).
        turn = Rotation.from_euler("xyz", _numbers(element.find("origin"), "rpy")).as_matrix()
        scatter = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        mass = float(_child(element, "mass").get("value", "nan"))
        centre = _numbers(element.find("origin"), "xyz")
        found.append(Inertial(link.get("name", ""), mass, centre, turn @ scatter @ turn.T))
    return found


def _limits(entry: Mapping[str, Any], limit: ET.Element | None) -> tuple[float, float]:
    if "limits_deg" in entry:
        lower, upper = np.radians(entry["limits_deg"])
        return float(lower), float(upper)
    if "limits" in entry:
        return float(entry["limits"][0]), float(entry["limits"][1])
    if limit is None:
        raise ValueError(f"joint `{entry['name']}` has no limits, neither in the TOML file nor in the URDF")
    return float(limit.get("lower", "nan")), float(limit.get("upper", "nan"))


def _torque_max(entry: Mapping[str, Any], limit: ET.Element | None) -> float:
    return float(entry.get("torque_max", "nan" if limit is None else limit.get("effort", "nan")))


def _without_namespace(root: ET.Element) -> ET.Element:
    """Return a URDF whose own tags have no namespace; those of other namespaces keep theirs."""
    own = root.tag.removesuffix("robot")
    for element in root.iter():
        element.tag = element.tag.removeprefix(own)
    return root


def _unit_vector(axis: Sequence[float] | Array) -> Array:
    vector = np.asarray(axis, dtype=float)
    return vector / float(np.linalg.norm(vector))


def _numbers(element: ET.Element | None, key: str) -> Array:
    text = "0 0 0" if element is None else element.get(key, "0 0 0")
    return np.array([float(word) for word in text.split()])


def _child(element: ET.Element, tag: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise ValueError(f"a URDF {element.tag} has no {tag}")
    return child


def _link(element: ET.Element, tag: str) -> str:
    return _child(element, tag).get("link", "")
