"""Surface of the robot in a posture, in base axes: closed bodies of triangles, grouped by aerodynamic link."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from jax_aero import rust
from jax_aero.aero.dataset import Floats
from jax_aero.base.files import write_text
from jax_aero.base.terminal import Refused
from jax_aero.body.mesh import Mesh, box, revolve
from jax_aero.body.urdf import Pose
from jax_aero.data.ironcub import JOINTS, joint_position
from jax_aero.view.shapes import Kind, Look, Mount, look_of

SEGMENTS = 48
"""Segments per circle; the polygon's area would be 0.3 % too small, so its radius is increased to equal area."""

MARGIN = np.radians(2.01)
"""Margin beyond joint stops [rad]: in the wind tunnel the robot had 12° at a joint whose URDF limit is 10°."""


def triangles_of(kind: Kind, size: tuple[float, float, float]) -> Floats:
    """Return the triangles (T, 3, 3) [m] of a primitive about its centre, with outward normals."""
    if kind == "box":
        return _triangles_of_mesh(box(), size)
    radius, _, length = size
    # A regular n-gon of circumradius r has the area n/2 sin(2π/n) r².
    wide = radius * np.sqrt(np.pi / (0.5 * SEGMENTS * np.sin(2.0 * np.pi / SEGMENTS)))
    end = radius if kind == "sphere" else 0.5 * length
    side = [(wide, -end), (wide, end)]
    if kind == "sphere":
        latitudes = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SEGMENTS // 2 + 1)[1:-1]
        side = [(wide * np.cos(latitude), radius * np.sin(latitude)) for latitude in latitudes]
    return _triangles_of_mesh(revolve([(0.0, -end), *side, (0.0, end)], SEGMENTS), (1.0, 1.0, 1.0))


def is_closed(triangles: Floats) -> bool:
    """Return whether every edge is used equally often in both directions, so that the surface has no hole.

    Usually once in each direction; where two parts of a body touch along an edge, twice.
    """
    _, corner = np.unique(np.round(triangles.reshape(-1, 3), 9), axis=0, return_inverse=True)
    faces = corner.reshape(-1, 3)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    one_way, other_way = (np.unique(way, axis=0, return_counts=True) for way in (edges, edges[:, ::-1]))
    return all(np.array_equal(*pair) for pair in zip(one_way, other_way, strict=True))


def volume(triangles: Floats) -> float:
    """Return the volume enclosed by closed triangles [m³], by Gauss's theorem: `Σ a·(b × c)/6`."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def transform_triangles(triangles: Floats, pose: Pose) -> Floats:
    """Return triangles transformed by `pose`."""
    moved: Floats = triangles @ pose.rotation.T + pose.position
    return moved


class Tap(NamedTuple):
    """A pressure tap."""

    position: Floats
    """(3,) [m]"""
    normal: Floats
    """(3,) unit vector, outwards."""


class Surface(NamedTuple):
    """Surface of one link."""

    triangles: Floats
    """(T, 3, 3) corners [m], outward normals by the right-hand rule; bodies may overlap, each is closed."""
    centre: Floats
    """(3,) reference point of the couple [m]."""
    taps: Mapping[str, Tap] = MappingProxyType({})
    """Pressure taps by name."""


def robot_surfaces(
    robot: rust.Robot,
    joint_position_deg: Floats,
    meshes_of: Path | None = None,
    taps: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> dict[str, Surface]:
    """Return the surface of every aerodynamic link in base axes, at joint angles (19,) [deg], order of `JOINTS`.

    Parts of other links are assigned to one of these. The centre of a link is its aerodynamic centre.

    Parameters
    ----------
    meshes_of
        The robot's TOML file, relative to which the meshes of its URDF are found. Without it, links that only have
        meshes are the spheres and cylinders of their aerodynamic model.
    taps
        Link, position and normal in its axes of every tap, by name.

    Raises
    ------
    Refused
        If a joint is beyond its stops, a mesh is missing, a body is not closed, a link has no surface, or a tap no
        link.
    """
    poses = body_poses(robot, joint_position_deg)
    look = look_of(robot, meshes_of)
    if meshes_of and look.missing:
        raise Refused("; ".join(look.missing))
    links = {link.name: link for link in look.links}
    parts: dict[str, list[Floats]] = {name: [] for name in links}
    for shape in look.shapes:
        triangles = _triangles_of_mesh(shape.mesh, shape.size) if shape.mesh else triangles_of(shape.kind, shape.size)
        check_closed(shape.name, triangles)
        parts[_link_of(shape.name, shape.body, links, look, robot)].append(
            transform_triangles(triangles, poses[shape.body] @ shape.body_from_shape)
        )
    if missing := [name for name, surfaces in parts.items() if not surfaces]:
        raise Refused(f"no shape of the robot belongs to its aerodynamic link {', '.join(missing)}")
    tapped: dict[str, dict[str, Tap]] = {name: {} for name in links}
    known = robot.links()
    for tap, about in taps.items():
        if about["link"] not in known:
            raise Refused(f"tap {tap} is on `{about['link']}`, which is no link of {robot.name}")
        body, pose = known[about["link"]]
        at = poses[body] @ Pose(*pose)
        place = at.rotation @ about["position"] + at.position
        tapped[_link_of(about["link"], body, links, look, robot)][tap] = Tap(place, at.rotation @ about["normal"])
    return {
        name: Surface(
            np.concatenate(parts[name]),
            poses[link.body].rotation @ link.position + poses[link.body].position,
            tapped[name],
        )
        for name, link in links.items()
    }


def _triangles_of_mesh(mesh: Mesh, factors: tuple[float, float, float]) -> Floats:
    """Return the triangles (T, 3, 3) [m] of a mesh with scaled vertices; a negative factor mirrors it."""
    triangles: Floats = mesh.vertices[mesh.faces] * np.array(factors)
    return triangles if np.prod(factors) > 0.0 else triangles[:, ::-1]


def check_closed(name: str, triangles: Floats) -> None:
    """Refuse a body that is not closed."""
    if not is_closed(triangles) or volume(triangles) <= 0.0:
        raise Refused(f"the surface of `{name}` does not close; expected outward triangles that share every edge")


def body_poses(robot: rust.Robot, joint_position_deg: Floats) -> list[Pose]:
    """Return the poses of the bodies relative to the base at joint angles (19,) [deg]; other joints are at zero."""
    joints = joint_position(robot, joint_position_deg)
    for name in JOINTS:
        place = robot.joint_names.index(name)
        angle, (low, high) = joints[place], robot.joint_stops[place]
        if not low - MARGIN <= angle <= high + MARGIN:
            raise Refused(
                f"`{name}` is {np.degrees(angle):.1f} degrees; expected {np.degrees(low):.1f} to {np.degrees(high):.1f}"
            )
    at = rust.dynamics(robot, rust.State.at_rest(robot, joints))
    return [Pose(turn, place) for turn, place in zip(at.body_rotations, at.body_positions, strict=True)]


def _link_of(name: str, body: int, links: dict[str, Mount], look: Look, robot: rust.Robot) -> str:
    """Return the aerodynamic link that a shape or a tap of the URDF's link `name` on `body` is assigned to.

    It is the link of that name, or otherwise that of its body. A body without a link is assigned to the next
    one outwards along the tree (torso to chest, shoulder to upper arm), or at its ends inwards (foot to lower leg).
    """
    if name in links:
        return name
    carried = {link.body: name for name, link in reversed(links.items())}
    carried |= {robot.body_names.index(name): name for name in links if name in robot.body_names}
    inward = _path_to_base(body, look.parents)
    outward = [other for other in range(len(look.parents)) if body in _path_to_base(other, look.parents)]
    return next(carried[near] for near in (*outward, *inward) if near in carried)


def _path_to_base(body: int, parents: tuple[int, ...]) -> list[int]:
    """Return a body and its ancestors, the base last."""
    return [body, *_path_to_base(parents[body], parents)] if parents[body] >= 0 else [body]


def write_stl(surfaces: Mapping[str, Surface], path: Path) -> None:
    """Write every surface as a solid with its name."""
    lines = []
    for name, surface in surfaces.items():
        a, b, c = np.moveaxis(surface.triangles, 1, 0)
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.where(lengths > 0.0, lengths, 1.0)  # a mesh may have degenerate triangles
        lines.append(f"solid {name}")
        for normal, corners in zip(normals, surface.triangles, strict=True):
            lines += [f"facet normal {_numbers(normal)}", "outer loop"]
            lines += [f"vertex {_numbers(corner)}" for corner in corners]
            lines += ["endloop", "endfacet"]
        lines.append(f"endsolid {name}")
    write_text(path, "\n".join(lines) + "\n")


def _numbers(vector: Floats) -> str:
    return " ".join(f"{value:.9g}" for value in vector)
