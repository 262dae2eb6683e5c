"""Meshes of files named in a URDF, and of bodies of revolution."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero.command import Refused


class Mesh(NamedTuple):
    """(v, 3) vertices [m] and (f, 3) faces, counter-clockwise seen from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def mesh_file(name: str, folder: Path) -> Path:
    """Find a mesh given as `package://PACKAGE/PATH`, `file://PATH`, or a path relative to the URDF's folder.

    A package is searched for in ROS_PACKAGE_PATH, then in the folders above the URDF. If the mesh is in none of them,
    the only file of its name below the URDF's folder is used.

    Raises
    ------
    Refused
        If there is no such file, or more than one.
    """
    path = Path(name.removeprefix("package://").removeprefix("file://"))
    places = [folder, *folder.resolve().parents]
    if name.startswith("package://"):
        places = [Path(place) for place in os.environ.get("ROS_PACKAGE_PATH", "").split(":") if place] + places
    for place in places:
        if (place / path).is_file():
            return place / path
    same = sorted(folder.rglob(path.name))
    if len(same) != 1:
        raise Refused(f"mesh {name}: {len(same)} files of that name below the URDF's folder; expected one")
    return same[0]


@functools.lru_cache(maxsize=256)
def read_mesh(path: Path) -> Mesh:
    """Read all triangles of an STL, OBJ or DAE file, in its own unit.

    Raises
    ------
    Refused
        If trimesh cannot read the file or finds no triangle.
    """
    import trimesh

    try:
        read = trimesh.load_scene(path).to_mesh()
        vertices, faces = np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64)
    except Exception as reason:  # trimesh's readers raise many types
        raise Refused(f"mesh {path.name} cannot be read: {reason}") from None
    if faces.size == 0 or not np.isfinite(vertices).all():
        raise Refused(f"mesh {path.name} has no triangle, or vertices that are not finite")
    return Mesh(vertices, faces)


def revolve(profile: Sequence[tuple[float, float]], segments: int = 24) -> Mesh:
    """Rotate a profile of (radius, height), from bottom to top, about z; a repeated point makes a sharp edge."""
    angles = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.concatenate([np.column_stack([r * ring, np.full(segments, z)]) for r, z in profile])
    faces = []
    for low in range(len(profile) - 1):
        if profile[low] == profile[low + 1]:
            continue
        for i in range(segments):
            a, b = low * segments + i, low * segments + (i + 1) % segments
            c, d = a + segments, b + segments
            faces += [(a, b, d)] if profile[low][0] > 0.0 else []
            faces += [(a, d, c)] if profile[low + 1][0] > 0.0 else []
    return Mesh(vertices, np.array(faces))


def box() -> Mesh:
    """Return a cube of edge length 1 about the origin, with sharp edges: faces share no vertices."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = 4 * np.arange(6)[:, None, None] + np.array([(0, 1, 2), (0, 2, 3)])
    return Mesh(corners[np.ravel(sides)], faces.reshape(-1, 3))
