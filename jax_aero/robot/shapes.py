"""Sizes of the links of a URDF: boxes around their geometry, including meshes."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jax_aero.base.terminal import Refused
from jax_aero.body.mesh import mesh_file, read_mesh
from jax_aero.body.urdf import Pose, Shape, Urdf

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


def boxes(urdf: Urdf, folder: Path, *, skip_meshes: bool = False) -> dict[str, Box]:
    """Return the box of every link with geometry; mesh paths are relative to the URDF's `folder`.

    With `skip_meshes` a warning replaces the refusal of meshes that are missing or cannot be read.
    """
    by_link, skipped, reasons = {}, [], []
    for link, shapes in itertools.groupby(urdf.shapes, key=lambda shape: shape.link):
        parts = []
        for shape in shapes:
            try:
                parts.append(_box(shape, folder))
            except Refused as reason:
                reasons.append(f"link `{link}`: {reason}")
                skipped.append(f"{shape.file} of link `{link}`")
        if parts:
            by_link[link] = parts[0] if len(parts) == 1 else _bounding_box(parts)
    if skipped and not skip_meshes:
        more = f"; the same for {len(skipped) - 1} more: {', '.join(skipped[1:])}" if len(skipped) > 1 else ""
        raise Refused(f"{reasons[0]}; --skip-meshes leaves such meshes out{more}")
    if skipped:
        warnings.warn(f"left out, as if they were not there: {', '.join(skipped)}", stacklevel=2)
    return by_link


def _bounding_box(parts: list[Box]) -> Box:
    corners = np.concatenate([part.corners for part in parts])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return Box(Pose(np.eye(3), (low + high) / 2), high - low)


def _box(shape: Shape, folder: Path) -> Box:
    size = np.array(shape.size)
    if shape.file is not None:
        points = read_mesh(mesh_file(shape.file, folder)).vertices * size
        low, high = points.min(axis=0), points.max(axis=0)
        return Box(shape.origin @ Pose(np.eye(3), (low + high) / 2), high - low)
    edges = {"sphere": [2.0, 2.0, 2.0], "cylinder": [2.0, 2.0, 1.0], "capsule": [2.0, 2.0, 1.0], "box": [1.0, 1.0, 1.0]}
    return Box(shape.origin, size * edges[shape.kind], is_sphere=shape.kind == "sphere")
