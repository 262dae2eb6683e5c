"""Meshes of files named in a URDF, and of bodies of revolution."""

from __future__ import annotations

import functools
import io
import itertools
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero.base.files import read_bytes
from jax_aero.base.terminal import Refused


class Mesh(NamedTuple):
    """(v, 3) vertices [m] and (f, 3) faces, counter-clockwise seen from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def mesh_file(name: str, folder: Path) -> Path:
    """Find a mesh given as `package://PACKAGE/PATH`, `file://PATH`, or a path relative to the URDF's folder.

    A package is searched for in AMENT_PREFIX_PATH (`PREFIX/share/PACKAGE`), in ROS_PACKAGE_PATH and the folders below
    it, and in the folders above the URDF, one of which may be the package under another name. If the mesh is in none of
    them, the only file of its name below the URDF's folder is used.

    Raises
    ------
    Refused
        If there is no such file, or more than one.
    """
    scheme, _, rest = name.rpartition("://")
    above = [folder, *folder.resolve().parents]
    places = [place / rest for place in above]
    package, _, path = rest.partition("/")
    if scheme == "package":
        prefixes, roots = (os.environ.get(key, "") for key in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"))
        shares = [Path(prefix) / "share" / package for prefix in prefixes.split(":") if prefix]
        packages = [*shares, *_packages(roots, package)]
        places = [*(place / path for place in packages), *places, *(place / path for place in above)]
    for place in places:
        if place.is_file():
            return place
    same = sorted(place for place in folder.rglob("*") if place.name == Path(rest).name and place.is_file())
    if len(same) != 1:
        way = f"; ROS_PACKAGE_PATH may name the folder of package `{package}`" if scheme == "package" else ""
        raise Refused(f"mesh {name}: {len(same)} files of that name below the URDF's folder; expected one{way}")
    return same[0]


GREATEST = {".stl": 64 << 20, ".obj": 32 << 20, ".dae": 32 << 20}
"""Formats that are read, with the greatest size of a file [bytes]; reading text takes up to 50 times as much memory.

Other formats that trimesh can read may be archives of any size, or name other files.
"""

MAX_TRIANGLES, MAX_NODES = 2_000_000, 100_000
"""Greatest number of triangles of a mesh, some 200 MB, and of nodes of a DAE file, in which nodes may repeat others."""


@functools.lru_cache(maxsize=256)
def _packages(roots: str, package: str) -> list[Path]:
    """Return the folders of a package's name that are, or are below, one of the folders in a path of ROS."""
    folders = []
    for root in (Path(root) for root in roots.split(":") if root):
        folders += [root] if root.name == package else [root / package]
        folders += sorted(place for place in root.rglob("*") if place.name == package and place.is_dir())
    return folders


@functools.lru_cache(maxsize=256)
def read_mesh(path: Path) -> Mesh:
    """Read all triangles of an STL, OBJ or DAE file, in its own unit, and nothing of the files that it names.

    Raises
    ------
    Refused
        If the file is of another format, too large, or has no triangle.
    """
    suffix = path.suffix.lower()
    if suffix not in GREATEST:
        raise Refused(f"mesh {path.name} ends in `{path.suffix}`; expected one of {', '.join(GREATEST)}")
    data = read_bytes(path, GREATEST[suffix])
    import trimesh

    try:
        if suffix == ".dae":
            read = trimesh.Trimesh(**_read_dae(data)._asdict())  # which joins equal vertices
        else:
            options: Any = {"skip_materials": True} if suffix == ".obj" else {}
            read = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], **options).to_mesh()
        vertices, faces = np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64)
        _expect_triangles(len(faces))
    except Exception as reason:  # the readers raise many types
        raise Refused(f"mesh {path.name} cannot be read: {reason}") from None
    if faces.size == 0 or not np.isfinite(vertices).all():
        raise Refused(f"mesh {path.name} has no triangle, or vertices that are not finite")
    return Mesh(vertices, faces)


def _read_dae(data: bytes) -> Mesh:
    """Read the geometries of the scene, each where its nodes place it."""
    import collada

    if zipfile.is_zipfile(io.BytesIO(data)) or any("<!ENTITY".encode(code) in data for code in UNICODE):
        raise ValueError("it is an archive, or defines entities; expected plain XML")
    document = collada.Collada(io.BytesIO(data), ignore=[collada.DaeError])
    corners, count = [np.empty((0, 3))], 0
    waiting = [(node, np.eye(4)) for node in document.scene.nodes]
    for _ in range(MAX_NODES):
        if not waiting:
            break
        node, pose = waiting.pop()
        if isinstance(node, collada.scene.Node):
            waiting += [(child, pose @ node.matrix) for child in node.children or ()]
        primitives = node.geometry.primitives if isinstance(node, collada.scene.GeometryNode) else ()
        for primitive in primitives:
            if isinstance(primitive, collada.polylist.Polylist):
                primitive = primitive.triangleset()
            if isinstance(primitive, collada.triangleset.TriangleSet) and primitive.vertex is not None:
                count += len(primitive.vertex_index)
                _expect_triangles(count)
                corners.append(primitive.vertex[primitive.vertex_index].reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3])
    else:
        raise ValueError(f"it has {MAX_NODES} nodes or more; expected fewer")
    vertices = np.concatenate(corners)
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


UNICODE = ("utf-8", "utf-16-le", "utf-16-be")


def _expect_triangles(count: int) -> None:
    if count > MAX_TRIANGLES:
        raise ValueError(f"it has {count} triangles or more; expected at most {MAX_TRIANGLES}")


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
