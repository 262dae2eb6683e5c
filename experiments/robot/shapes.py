"""Sizes of the links of a URDF: boxes around their geometry, including meshes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments import Refused
from jax_aero.mesh import mesh_file, read_mesh
from jax_aero.urdf import Pose, attribute, numbers, origin_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """A box around a link's geometry: pose in link axes and edges [m]."""

    pose: Pose
    size: Array
    is_sphere: bool = False

    @property
    def corners(self) -> Array:
        """(8, 3) corners in link axes [m]."""
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
        return np.asarray(signs * self.size @ self.pose.rotation.T + self.pose.position)


def boxes(urdf: ET.Element, folder: Path) -> dict[str, Box]:
    """Return the box of every link with geometry; mesh paths are relative to the URDF's `folder`."""
    found = {}
    for link in urdf.iter("link"):
        elements = link.findall("visual") or link.findall("collision")
        parts = [_box(element, folder) for element in elements if element.find("geometry") is not None]
        if parts:
            found[attribute(link, "name")] = parts[0] if len(parts) == 1 else _bounding_box(parts)
    return found


def _bounding_box(parts: list[Box]) -> Box:
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
        mesh = read_mesh(mesh_file(attribute(shape, "filename"), folder))
        points = mesh.vertices * numbers(shape, "scale", 3, "1 1 1")
        low, high = points.min(axis=0), points.max(axis=0)
        return Box(origin @ Pose(np.eye(3), (low + high) / 2), high - low)
    raise Refused(f"geometry <{shape.tag}> is unknown; expected sphere, cylinder, capsule, box or mesh")
