"""What a robot looks like: the primitives of its URDF, struts between its joints, its jets and aerodynamic links."""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from jax_aero import rust
from jax_aero.urdf import IDENTITY, BodyTree, Pose, Vector, origin_of, read_tree

STRUT_RADIUS = 0.022  # m

Kind = Literal["cylinder", "sphere", "box"]
Role = Literal["shell", "engine", "sole", "strut"]


@dataclass(frozen=True)
class Shape:
    """One primitive on one body.

    Attributes
    ----------
    name
        The link it belongs to.
    kind, size
        `cylinder`: radius, radius, length along z; `sphere`: radius three times; `box`: edges [m].
    role
        What it is, which is how it is coloured.
    body
        Place of its body in `Robot.body_names`.
    body_from_shape
        Where its centre is, and its axes.
    """

    name: str
    kind: Kind
    size: tuple[float, float, float]
    role: Role
    body: int
    body_from_shape: Pose


@dataclass(frozen=True)
class Mount:
    """A point on a body, with a direction: a jet (direction of its exhaust) or an aerodynamic link (its axis)."""

    name: str
    body: int
    position: Vector
    """[m], body axes."""
    axis: Vector
    """Unit vector, body axes."""


@dataclass(frozen=True)
class Look:
    """Everything of a robot that can be drawn."""

    shapes: tuple[Shape, ...]
    jets: tuple[Mount, ...]
    links: tuple[Mount, ...]
    parents: tuple[int, ...]
    """Parent of each body; −1 for the base."""
    without_shape: tuple[str, ...] = ()
    """Links of which the URDF has meshes alone; those with aerodynamics are drawn as the air sees them."""


def look_of(robot: rust.Robot) -> Look:
    """Read what a robot looks like from its own TOML and URDF text, whose meshes are not read."""
    table = tomllib.loads(robot.toml_text)
    tree = read_tree(robot.urdf_text, table["base_link"], robot.joint_names, table.get("locked", {}))
    if [body.name for body in tree.bodies] != list(robot.body_names):
        raise ValueError(f"bodies of the URDF are {[body.name for body in tree.bodies]}; expected {robot.body_names}")
    engines = {entry["frame"] for entry in table.get("jets", [])}
    soles = {entry["frame"] for entry in table.get("feet", [])}
    in_air = {entry["frame"]: entry for entry in table.get("aero_links", [])}
    shapes, without_shape = [], []
    for link in ElementTree.fromstring(robot.urdf_text).iter("link"):
        name = link.attrib["name"]
        role: Role = "engine" if name in engines else "sole" if name in soles else "shell"
        body, body_from_link = tree.places[name]
        visuals = link.findall("visual")
        drawn = [(primitive, origin_of(visual)) for visual in visuals if (primitive := _primitive(visual))]
        if visuals and not drawn:
            without_shape.append(name)
            drawn = [_seen_by_air(in_air[name])] if name in in_air else []
        shapes += [Shape(name, *primitive, role, body, body_from_link @ pose) for primitive, pose in drawn]
    return Look(
        shapes=(*shapes, *_struts(tree, shapes)),
        jets=tuple(_jet(entry, tree) for entry in table.get("jets", [])),
        links=tuple(_link(entry, tree) for entry in table.get("aero_links", [])),
        parents=tuple(body.parent for body in tree.bodies),
        without_shape=tuple(without_shape),
    )


def _seen_by_air(entry: dict[str, Any]) -> tuple[tuple[Kind, tuple[float, float, float]], Pose]:
    """Sphere or cylinder of an aerodynamic link, and where it is in the link's axes."""
    radius = 0.5 * entry["diameter"]
    axis = np.asarray(entry["axis"], dtype=np.float64)
    pose = Pose(rotation_onto(axis / np.linalg.norm(axis)), np.asarray(entry["centre"], dtype=np.float64))
    if entry.get("is_sphere", False):
        return ("sphere", (radius, radius, radius)), pose
    return ("cylinder", (radius, radius, entry["length"])), pose


def _primitive(visual: ElementTree.Element) -> tuple[Kind, tuple[float, float, float]] | None:
    for element in visual.iterfind("geometry/*"):
        if element.tag == "cylinder":
            radius = float(element.attrib["radius"])
            return "cylinder", (radius, radius, float(element.attrib["length"]))
        if element.tag == "sphere":
            return "sphere", (float(element.attrib["radius"]),) * 3
        if element.tag == "box":
            x, y, z = (float(edge) for edge in element.attrib["size"].split())
            return "box", (x, y, z)
    return None


def _struts(tree: BodyTree, shapes: list[Shape]) -> list[Shape]:
    """Thin cylinders from every body's origin to its joints and primitives: what holds the primitives together."""
    ends = [
        (tree.bodies[i + 1].parent, joint.parent_from_child.position, tree.bodies[i + 1].name)
        for i, joint in enumerate(tree.joints)
    ]
    # Not quite to the middle: a thin primitive such as a sole would be pierced.
    ends += [(shape.body, 0.85 * shape.body_from_shape.position, shape.name) for shape in shapes]
    struts = []
    for body, end, name in ends:
        length = float(np.linalg.norm(end))
        if length > STRUT_RADIUS:
            pose = Pose(rotation_onto(end / length), 0.5 * end)
            struts.append(Shape(f"strut_{name}", "cylinder", (STRUT_RADIUS, STRUT_RADIUS, length), "strut", body, pose))
    return struts


def _jet(entry: dict[str, Any], tree: BodyTree) -> Mount:
    body, body_from_frame = tree.places[entry["frame"]]
    exhaust = -body_from_frame.rotation @ np.asarray(entry["axis"], dtype=np.float64)
    return Mount(entry["name"], body, body_from_frame.position, exhaust)


def _link(entry: dict[str, Any], tree: BodyTree) -> Mount:
    body, body_from_link = tree.places[entry["frame"]]
    centre = body_from_link @ Pose(IDENTITY.rotation, np.asarray(entry["centre"], dtype=np.float64))
    axis = body_from_link.rotation @ np.asarray(entry["axis"], dtype=np.float64)
    return Mount(entry["name"], body, centre.position, axis)


def rotation_onto(axis: Vector) -> Vector:
    """Return a rotation matrix whose z axis is the unit vector `axis`, (3, 3)."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])
