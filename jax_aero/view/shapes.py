"""Shapes of a robot: primitives and meshes of its URDF, struts between its joints, jets and aerodynamic links."""

from __future__ import annotations

import itertools
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.body.mesh import Mesh, mesh_file, read_mesh
from jax_aero.body.urdf import IDENTITY, Pose, Vector, typed_shapes
from jax_aero.body.urdf import Shape as UrdfShape

STRUT_RADIUS = 0.022  # m

Kind = Literal["cylinder", "sphere", "box", "mesh"]
Role = Literal["shell", "engine", "sole", "strut"]


@dataclass(frozen=True)
class Shape:
    """One primitive or mesh on a body.

    Attributes
    ----------
    name
        Link that it belongs to.
    kind, size
        `cylinder`: radius, radius, length along z; `sphere`: radius three times; `box`: edges [m]; `mesh`: factors on
        its vertices.
    role
        Role that determines its colour.
    body
        Index of its body in `Robot.body_names`.
    body_from_shape
        Pose of its centre, or of a mesh's origin.
    mesh
        Mesh of the kind `mesh`, otherwise `None`.
    """

    name: str
    kind: Kind
    size: tuple[float, float, float]
    role: Role
    body: int
    body_from_shape: Pose
    mesh: Mesh | None = None


@dataclass(frozen=True)
class Mount:
    """A point with a direction on a body: a jet (direction of its exhaust) or an aerodynamic link (its axis)."""

    name: str
    link: str
    """Its link in the URDF."""
    body: int
    position: Vector
    """Position [m], body axes."""
    axis: Vector
    """Unit vector, body axes."""


@dataclass(frozen=True)
class Look:
    """Everything of a robot that is drawn."""

    shapes: tuple[Shape, ...]
    jets: tuple[Mount, ...]
    links: tuple[Mount, ...]
    parents: tuple[int, ...]
    """Parent of each body; −1 for the base."""
    missing: tuple[str, ...] = ()
    """Reason why a link's mesh is missing, link by link; aerodynamic links are drawn as in their models instead."""


Solid = tuple[Kind, tuple[float, float, float], Mesh | None]
"""Kind, size and mesh of a shape."""


def look_of(robot: rust.Robot, path: Path | None = None) -> Look:
    """Return the look of a robot from its own TOML and URDF text.

    `path` is its TOML file, relative to which the URDF's meshes are found; without it they are missing.
    """
    table = tomllib.loads(robot.toml_text)
    places = {link: (body, Pose(*pose)) for link, (body, pose) in robot.links().items()}
    engines = {entry["frame"] for entry in table.get("jets", [])}
    soles = {entry["frame"] for entry in table.get("feet", [])}
    in_air = {entry["frame"]: entry for entry in table.get("aero_links", [])}
    folder = None if path is None else (path.parent / table["urdf"]).parent
    shapes: list[Shape] = []
    missing: list[str] = []
    for name, solids in itertools.groupby(typed_shapes(robot.shapes()), key=lambda shape: shape.link):
        role: Role = "engine" if name in engines else "sole" if name in soles else "shell"
        body, body_from_link = places[name]
        drawn: list[tuple[Solid, Pose]] = []
        reasons = []
        for solid in solids:
            try:
                drawn.append((_solid(solid, folder), solid.origin))
            except Refused as reason:
                reasons.append(f"{name}: {reason}")
        if reasons and not drawn and name in in_air:
            drawn = [_aero_shape(in_air[name])]
        missing += reasons
        shapes += [
            Shape(name, kind, size, role, body, body_from_link @ pose, mesh) for (kind, size, mesh), pose in drawn
        ]
    return Look(
        shapes=(*shapes, *_struts(robot, shapes)),
        jets=tuple(_jet(entry, *places[entry["frame"]]) for entry in table.get("jets", [])),
        links=tuple(_link(entry, *places[entry["frame"]]) for entry in table.get("aero_links", [])),
        parents=robot.arrays()["parent"],
        missing=tuple(missing),
    )


def _aero_shape(entry: dict[str, Any]) -> tuple[Solid, Pose]:
    """Return the sphere or cylinder of an aerodynamic link, and its pose in link axes."""
    radius = 0.5 * entry["diameter"]
    axis = np.asarray(entry["axis"], dtype=np.float64)
    pose = Pose(rotation_onto(axis / np.linalg.norm(axis)), np.asarray(entry["centre"], dtype=np.float64))
    if entry.get("is_sphere", False):
        return ("sphere", (radius, radius, radius), None), pose
    return ("cylinder", (radius, radius, entry["length"]), None), pose


def _solid(shape: UrdfShape, folder: Path | None) -> Solid:
    if shape.file is None:
        return "cylinder" if shape.kind == "capsule" else shape.kind, shape.size, None
    if folder is None:
        raise Refused(f"mesh {shape.file}: not looked for")
    return "mesh", shape.size, read_mesh(mesh_file(shape.file, folder))


def _struts(robot: rust.Robot, shapes: list[Shape]) -> list[Shape]:
    """Return thin cylinders from every body's origin to its joints and primitives, for robots without meshes."""
    meshed = {shape.body for shape in shapes if shape.kind == "mesh"}
    numbers = robot.arrays()
    ends = list(zip(numbers["parent"][1:], numbers["joint_positions"], robot.body_names[1:], strict=True))
    # Not quite to the centre, since a thin primitive such as a sole would be pierced.
    ends += [(shape.body, 0.85 * shape.body_from_shape.position, shape.name) for shape in shapes]
    struts = []
    for body, end, name in ends:
        length = float(np.linalg.norm(end))
        if length > STRUT_RADIUS and body not in meshed:
            pose = Pose(rotation_onto(end / length), 0.5 * end)
            struts.append(Shape(f"strut_{name}", "cylinder", (STRUT_RADIUS, STRUT_RADIUS, length), "strut", body, pose))
    return struts


def _jet(entry: dict[str, Any], body: int, body_from_frame: Pose) -> Mount:
    exhaust = -body_from_frame.rotation @ np.asarray(entry["axis"], dtype=np.float64)
    return Mount(entry["name"], entry["frame"], body, body_from_frame.position, exhaust)


def _link(entry: dict[str, Any], body: int, body_from_link: Pose) -> Mount:
    centre = body_from_link @ Pose(IDENTITY.rotation, np.asarray(entry["centre"], dtype=np.float64))
    axis = body_from_link.rotation @ np.asarray(entry["axis"], dtype=np.float64)
    return Mount(entry["name"], entry["frame"], body, centre.position, axis)


def rotation_onto(axis: Vector) -> Vector:
    """Return a rotation matrix whose z axis is the unit vector `axis`, (3, 3)."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])
