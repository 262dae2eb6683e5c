"""How large the links of a URDF are: boxes around their geometry, meshes included."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments import Refused
from jax_aero.mesh import mesh_file
from jax_aero.urdf import Pose, attribute, numbers, origin_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """A box around a link's geometry: its pose in link axes and its edges [m]."""

    pose: Pose
    size: Array
    is_sphere: bool = False

    @property
    def corners(self) -> Array:
        """(8, 3) corners in link axes [m]."""
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
        return np.asarray(signs * self.size @ self.pose.rotation.T + self.pose.position)


def boxes(urdf: ET.Element, folder: Path) -> dict[str, Box]:
    """Return the box of every link with geometry; meshes are found from the URDF's `folder`."""
    found = {}
    for link in urdf.iter("link"):
        elements = link.findall("visual") or link.findall("collision")
        parts = [_box(element, folder) for element in elements if element.find("geometry") is not None]
        if parts:
            found[attribute(link, "name")] = parts[0] if len(parts) == 1 else _around(parts)
    return found


def _around(parts: list[Box]) -> Box:
    corners = np.concatenate([part.corners for part in parts])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return Box(Pose(np.eye(3), (low + high) / 2), high - low)


def _box(element: ET.Element, folder: Path) -> Box:
    origin = origin_of(element)
    geometry = element.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        raise Refused("a <geometry> of the URDF is empty")
    if shape.tag == "sphere":
        return Box(origin, np.full(3, 2.0 * numbers(shape, "radius", 1)), is_sphere=True)
    if shape.tag in ("cylinder", "capsule"):
        diameter = 2.0 * numbers(shape, "radius", 1)
        return Box(origin, np.concatenate([diameter, diameter, numbers(shape, "length", 1)]))
    if shape.tag == "box":
        return Box(origin, numbers(shape, "size", 3))
    if shape.tag == "mesh":
        points = mesh_points(mesh_file(attribute(shape, "filename"), folder)) * numbers(shape, "scale", 3, "1 1 1")
        low, high = points.min(axis=0), points.max(axis=0)
        return Box(origin @ Pose(np.eye(3), (low + high) / 2), high - low)
    raise Refused(f"geometry <{shape.tag}> is unknown; expected sphere, cylinder, capsule, box or mesh")


def mesh_points(path: Path) -> Array:
    """Vertices (k, 3) of an STL or OBJ file, in its own unit."""
    data = path.read_bytes()
    if path.suffix.lower() == ".obj":
        lines = [line.split() for line in data.decode("utf-8").splitlines() if line.startswith("v ")]
        points = np.array([words[1:4] for words in lines], dtype=np.float64)
    elif path.suffix.lower() == ".stl":
        points = _stl_points(data)
    else:
        raise Refused(f"mesh {path.name}: expected an STL or OBJ file")
    if points.size == 0 or not np.isfinite(points).all():
        raise Refused(f"mesh {path.name} has no vertices, or some that are not finite")
    return points


def _stl_points(data: bytes) -> Array:
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count:  # binary: a normal, three corners and two bytes for each triangle
        triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        return np.asarray(np.frombuffer(data, triangle, count, 84)["corners"].reshape(-1, 3), np.float64)
    words = [line.split() for line in data.decode("ascii", "replace").splitlines()]
    return np.array([line[1:4] for line in words if line[:1] == ["vertex"]], dtype=np.float64).reshape(-1, 3)
