"""Meshes of a URDF: where their files are, and what is in them."""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero.command import Refused


class Mesh(NamedTuple):
    """(v, 3) vertices [m] and (f, 3) faces, counter-clockwise from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def mesh_file(name: str, folder: Path) -> Path:
    """Find a mesh: `package://PACKAGE/PATH`, `file://PATH`, or a path from the URDF's folder.

    A package is looked for in ROS_PACKAGE_PATH, then above the URDF; a mesh that is nowhere there is the one file of
    its name below the URDF's folder.

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
        If trimesh cannot read it, or finds no triangle.
    """
    import trimesh

    try:
        read = trimesh.load_scene(path).to_mesh()
        vertices, faces = np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64)
    except Exception as reason:  # a reader of trimesh raises what it likes
        raise Refused(f"mesh {path.name} cannot be read: {reason}") from None
    if faces.size == 0 or not np.isfinite(vertices).all():
        raise Refused(f"mesh {path.name} has no triangle, or vertices that are not finite")
    return Mesh(vertices, faces)
