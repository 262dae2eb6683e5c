"""Construction of a tree of bodies from a URDF: fixed and locked joints merged, names resolved, numbers checked.

Files are read once, with NumPy in double precision; nothing here is traced.

Equation M6 of `docs/model.md`.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

MAX_DEPTH = 64
"""Greatest nesting depth of tags, as in the crate."""

Vector: TypeAlias = NDArray[np.float64]

GREATEST = 1e100
"""Largest number that is accepted, so that products of three are finite."""


@dataclass(frozen=True)
class Pose:
    """A rigid transform `a_from_b`."""

    rotation: Vector
    position: Vector

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: `a_from_b @ b_from_c`."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.position + self.position)


IDENTITY = Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Body:
    """A rigid body with fixed links merged; the inertia is about its centre of mass, in body axes."""

    name: str
    parent: int
    mass: float
    com: Vector
    inertia: Vector


@dataclass(frozen=True)
class Joint:
    """A joint with one degree of freedom and its limits in the URDF; `None` if not limited there."""

    name: str
    is_prismatic: bool
    parent_from_child: Pose
    """Pose of the child body in the parent at joint position zero."""
    axis: Vector
    """Unit axis in child axes."""
    limits: tuple[float, float] | None
    """Lower and upper limit [rad, m]."""
    torque_max: float | None
    """Greatest torque or force [N m, N]."""
    velocity_max: float | None
    """Greatest velocity [rad/s, m/s]."""


@dataclass(frozen=True)
class BodyTree:
    """Bodies, base first (its parent is −1), the joints that move the others, and the pose of every link."""

    bodies: list[Body]
    joints: list[Joint]
    places: dict[str, tuple[int, Pose]]


@dataclass(frozen=True)
class _Part:
    mass: float
    com: Vector
    inertia: Vector


def read_tree(urdf_text: str, base_link: str, order: Sequence[str], locked: Mapping[str, float]) -> BodyTree:
    """Build the tree whose moving joints are those of `order`; `locked` ones are fixed at their position [rad, m].

    Raises
    ------
    ValueError
        If a link or joint is invalid; the message names it.
    """
    root = root_of(urdf_text)
    links = {attribute(element, "name"): element for element in root.iter("link")}
    joints = list(root.findall("joint"))
    joint_names = [attribute(joint, "name") for joint in joints]
    for item, listed in (("link", [attribute(link, "name") for link in root.iter("link")]), ("joint", joint_names)):
        if repeated := {name for name in listed if listed.count(name) > 1}:
            raise ValueError(f"{item} `{min(repeated)}` stands in the URDF more than once")
    _refuse_unknown("joint order", order, joint_names)
    _refuse_unknown("list of locked joints", locked, joint_names)
    children: dict[str, list[ElementTree.Element]] = {name: [] for name in links}
    for joint in joints:
        parent = attribute(_child(joint, "parent"), "link")
        _refuse_unknown(f"parent of joint `{joint.attrib['name']}`", [parent], list(links))
        children[parent].append(joint)
    _refuse_unknown("base_link", [base_link], list(links))
    motions = {joint.attrib["name"]: _motion(joint, order, locked) for joint in joints}

    parts: list[list[_Part]] = [[] for _ in range(len(order) + 1)]
    names, parents = [base_link] + [""] * len(order), [-1] * (len(order) + 1)
    moving: dict[int, Joint] = {}
    places: dict[str, tuple[int, Pose]] = {}
    to_visit = [(base_link, 0, IDENTITY)]
    while to_visit:
        link, body, body_from_link = to_visit.pop()
        if link in places:
            raise ValueError(f"link `{link}` is the child of more than one joint, or of itself")
        parts[body] += _parts(links[link], body_from_link)
        places[link] = (body, body_from_link)
        for joint in children[link]:
            name, child = joint.attrib["name"], attribute(_child(joint, "child"), "link")
            body_from_joint = body_from_link @ origin_of(joint)
            _refuse_unknown(f"child of joint `{name}`", [child], list(links))
            motion = motions[name]
            if motion == "moving":
                place = list(order).index(name)
                if place < body:
                    raise ValueError(f"joint `{name}` stands before its ancestor `{order[body - 1]}` in the order")
                names[place + 1], parents[place + 1] = child, body
                moving[place] = Joint(
                    name,
                    _is_prismatic(joint),
                    body_from_joint,
                    _axis(joint),
                    _limits(joint),
                    _greatest(joint, "effort"),
                    _greatest(joint, "velocity"),
                )
                to_visit.append((child, place + 1, IDENTITY))
            elif motion == "locked":
                axis, position = _axis(joint), locked[name]
                _check_position(joint, position)
                shifted, turned = Pose(np.eye(3), axis * position), Pose(_rotation_about(axis, position), np.zeros(3))
                to_visit.append((child, body, body_from_joint @ (shifted if _is_prismatic(joint) else turned)))
            else:
                to_visit.append((child, body, body_from_joint))
    if unreached := set(links) - set(places):
        raise ValueError(f"links {sorted(unreached)} do not hang from the base link `{base_link}`")
    bodies = [_merge(*body) for body in zip(names, parents, parts, strict=True)]
    return BodyTree(bodies, [moving[place] for place in range(len(order))], places)


def root_of(urdf_text: str) -> ElementTree.Element:
    """Return the root element of a URDF; raise `ValueError` for other texts and for nesting beyond `MAX_DEPTH`."""
    depth, root = 0, ElementTree.Element("")
    try:
        for event, element in ElementTree.iterparse(io.StringIO(urdf_text), ("start", "end")):
            root = element  # the last element to end
            depth += 1 if event == "start" else -1
            if depth > MAX_DEPTH:
                raise ValueError(f"tags nest more than {MAX_DEPTH} deep")
    except ElementTree.ParseError as reason:
        raise ValueError(f"the URDF is no XML: {reason}") from None
    if root.tag != "robot":
        raise ValueError(f"the outermost tag is <{root.tag}>; expected <robot>")
    return root


def mirror_name(name: str) -> str:
    """Return the name of the joint or link on the opposite side: left and right swapped between underscores.

    >>> mirror_name("chest_l_jet_turbine"), mirror_name("right_knee"), mirror_name("head")
    ('chest_r_jet_turbine', 'left_knee', 'head')
    """
    opposite = {"l": "r", "r": "l", "left": "right", "right": "left"}
    return "_".join(opposite.get(part, part) for part in name.split("_"))


ODD_JOINTS = ("torso_roll", "torso_yaw")
"""Joints whose angle changes sign in the mirror image; the angles of the limbs are exchanged between sides."""


def opposite_indices(names: Sequence[str]) -> list[int]:
    """Return for every joint or link the index of the one on the opposite side.

    Raises
    ------
    ValueError
        If a name has none opposite to it.
    """
    found = []
    for name in names:
        twin = mirror_name(name)
        if twin not in names:
            raise ValueError(f"`{name}` has no `{twin}` opposite to it")
        found.append(list(names).index(twin))
    return found


def _motion(joint: ElementTree.Element, order: Sequence[str], locked: Mapping[str, float]) -> str:
    """Say whether a joint is `fixed`, `locked` or `moving`; refuse what cannot be either."""
    name, kind = joint.attrib["name"], joint.attrib.get("type")
    mimic = _find(joint, "mimic")
    if mimic is not None:
        raise ValueError(
            f"joint `{name}` is a mimic of `{mimic.attrib.get('joint')}`; expected a joint that moves on its own"
        )
    if kind == "fixed":
        if name in order or name in locked:
            raise ValueError(f"type of joint `{name}` is fixed; expected one that moves, as it is listed")
        return "fixed"
    if kind not in ("revolute", "continuous", "prismatic"):
        raise ValueError(f"type of joint `{name}` is {kind}; expected revolute, continuous, prismatic or fixed")
    if (name in order) == (name in locked):
        found = "both in the joint order and locked" if name in order else "neither in the joint order nor locked"
        raise ValueError(f"joint `{name}` is {found}; expected one of both")
    return "moving" if name in order else "locked"


def _refuse_unknown(item: str, names: Iterable[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise ValueError(f"{item}: unknown name `{name}`; the URDF has {', '.join(known)}")


def _find(element: ElementTree.Element, tag: str) -> ElementTree.Element | None:
    """Return the tag of this name within another, where there is one."""
    found = element.findall(tag)
    if len(found) > 1:
        raise ValueError(f"{_named(element)} has more than one <{tag}>")
    return found[0] if found else None


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    found = _find(element, tag)
    if found is None:
        raise ValueError(f"{_named(element)} has no <{tag}>")
    return found


def _named(element: ElementTree.Element) -> str:
    name = element.attrib.get("name")
    return f"an <{element.tag}>" if name is None else f"{element.tag} `{name}`"


def attribute(element: ElementTree.Element, key: str) -> str:
    """Return an attribute of a tag; if it is missing, raise a `ValueError` that names both."""
    found = element.attrib.get(key)
    if found is None:
        raise ValueError(f"a <{element.tag}> has no `{key}`")
    return found


def numbers(element: ElementTree.Element, key: str, count: int, default: str | None = None) -> Vector:
    """Return `count` numbers of an attribute, at most `GREATEST`; a `ValueError` names tag, key and text."""
    text = attribute(element, key) if default is None else element.attrib.get(key, default)
    try:
        found = np.array([float(word) for word in text.split()])
    except ValueError:
        found = np.array([])
    if found.size != count or not (np.abs(found) <= GREATEST).all():
        raise ValueError(
            f"`{key}` of a <{element.tag}> is `{text}`; expected {'a number' if count == 1 else f'{count} numbers'} "
            f"up to {GREATEST:g}"
        )
    return found


def _number(element: ElementTree.Element, key: str, default: str | None = None) -> float:
    return float(numbers(element, key, 1, default)[0])


def origin_of(element: ElementTree.Element) -> Pose:
    """Pose a URDF element gives by its <origin>; the identity where it has none."""
    origin = _find(element, "origin")
    if origin is None:
        return IDENTITY
    roll, pitch, yaw = numbers(origin, "rpy", 3, "0 0 0")
    about = [_rotation_about(axis, angle) for axis, angle in zip(np.eye(3), (roll, pitch, yaw), strict=True)]
    return Pose(about[2] @ about[1] @ about[0], numbers(origin, "xyz", 3, "0 0 0"))


def _axis(joint: ElementTree.Element) -> Vector:
    element = _find(joint, "axis")
    axis = numbers(element, "xyz", 3) if element is not None else np.array([1.0, 0.0, 0.0])
    length = np.linalg.norm(axis)
    if abs(length - 1.0) > 1e-6:
        raise ValueError(f"axis of joint `{joint.attrib['name']}` is {axis}; expected a vector of length 1")
    return np.asarray(axis / length)


def _limits(joint: ElementTree.Element) -> tuple[float, float] | None:
    if joint.attrib["type"] == "continuous":
        return None
    limit = _child(joint, "limit")
    if missing := {"lower", "upper"} - set(limit.attrib):
        raise ValueError(f"URDF limit of joint `{joint.attrib['name']}` lacks {' and '.join(sorted(missing))}")
    return _number(limit, "lower"), _number(limit, "upper")


def _check_position(joint: ElementTree.Element, position: float) -> None:
    """Refuse a position [rad, m] beyond the limits of a joint that has some."""
    limit = _find(joint, "limit")
    if limit is None or joint.attrib["type"] == "continuous":
        return
    lower, upper = _number(limit, "lower", "0"), _number(limit, "upper", "0")
    if lower < upper and not lower <= position <= upper:
        raise ValueError(
            f"position of locked joint `{joint.attrib['name']}` is {position:g}; "
            f"expected a number from {lower:g} to {upper:g}, the limits of the URDF"
        )


def _is_prismatic(joint: ElementTree.Element) -> bool:
    return joint.attrib["type"] == "prismatic"


def _greatest(joint: ElementTree.Element, key: str) -> float | None:
    """Read a limit of effort or velocity; `None` where the URDF says 0 or nothing."""
    limit = _find(joint, "limit")
    value = 0.0 if limit is None else _number(limit, key, "0")
    if value < 0.0:
        raise ValueError(
            f"URDF {key} limit of joint `{joint.attrib['name']}` is {value}; expected a number of 0 or more"
        )
    return value or None


def _rotation_about(axis: Vector, angle: float) -> Vector:
    x, y, z = axis
    s = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.cos(angle) * np.eye(3) + np.sin(angle) * s + (1.0 - np.cos(angle)) * np.outer(axis, axis))


def _parts(link: ElementTree.Element, body_from_link: Pose) -> list[_Part]:
    inertial = _find(link, "inertial")
    if inertial is None:
        return []
    mass = _number(_child(inertial, "mass"), "value")
    i = {key: _number(_child(inertial, "inertia"), key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    tensor = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])
    pose = body_from_link @ origin_of(inertial)
    return [_Part(mass, pose.position, pose.rotation @ tensor @ pose.rotation.T)] if mass > 0.0 else []


def _merge(name: str, parent: int, parts: Sequence[_Part]) -> Body:
    """Return one body of several parts: `I = Σ I_k + m_k (d_k² 1 − d_k d_kᵀ)`, `d_k = c_k − c`."""
    mass = sum(part.mass for part in parts)
    if mass <= 0.0:
        raise ValueError(f"mass of body `{name}` is {mass}; expected a positive mass in kg")
    com = np.asarray(sum(part.mass * part.com for part in parts) / mass)
    inertia = np.zeros((3, 3))
    for part in parts:
        d = part.com - com
        inertia += part.inertia + part.mass * (d @ d * np.eye(3) - np.outer(d, d))
    inertia = 0.5 * (inertia + inertia.T)
    if np.linalg.eigvalsh(inertia)[0] <= 0.0:
        raise ValueError(f"inertia of body `{name}` has principal moments {np.linalg.eigvalsh(inertia)}; expected > 0")
    return Body(name, parent, mass, com, inertia)
