"""The scene of the page (viser): robots, paths, sky."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
import viser.transforms as tf

from jax_aero.mesh import Mesh, box
from jax_aero.view import drawing
from jax_aero.view.drawing import Colour, PlacedShape, Scales
from jax_aero.view.recording import Instant, Recording
from jax_aero.view.shapes import Look

LIT = {drawing.FORCE: (0, 78, 170), drawing.WIND: (60, 160, 240), drawing.PLUME: (248, 140, 0)}
"""Colours that appear as those of the legend under the page's lights, which shift them towards green."""

MESHES = {"cylinder": drawing.cylinder, "sphere": drawing.sphere, "box": box}


class RobotNodes:
    """One robot in the scene: its shapes, and for a solid robot its forces and plumes.

    All nodes are children of a frame at the centre of mass, so that instances stay near their node's origin.
    """

    def __init__(self, server: viser.ViserServer, name: str, look: Look, *, ghost: bool) -> None:
        self.look, self.ghost = look, ghost
        self.root = server.scene.add_frame(name, show_axes=False)
        groups = [([shape for shape in look.shapes if shape.kind == kind], mesh()) for kind, mesh in MESHES.items()]
        groups += [([shape], shape.mesh) for shape in look.shapes if shape.mesh is not None]
        self.groups = []
        for number, (shapes, mesh) in enumerate(groups):
            if shapes:
                colours = [drawing.GHOST if ghost else drawing.ROLES[shape.role] for shape in shapes]
                sizes = [shape.size for shape in shapes]
                opacity = 0.5 if ghost else None
                handle = _batch(server, f"{name}/shapes_{number}", mesh, sizes, colours, opacity=opacity)
                self.groups.append((shapes, handle))
        jets, links = len(look.jets), len(look.links)
        self.flames = None
        if jets and not ghost:
            colours = [LIT[drawing.PLUME]] * jets
            self.flames = _batch(server, f"{name}/plumes", drawing.cone(), np.ones((jets, 3)), colours, opacity=0.85)
        self.arrows = None
        if links and not ghost:
            self.arrows = server.scene.add_arrows(
                f"{name}/forces",
                np.zeros((links, 2, 3)),
                LIT[drawing.FORCE],
                shaft_radius=0.009,
                head_radius=0.024,
                head_length=0.06,
            )

    def show(self, instant: Instant, scales: Scales) -> None:
        """Move everything to its pose at an instant."""
        self.root.position = tuple(instant.com)
        for shapes, handle in self.groups:
            _move(handle, drawing.place(shapes, instant), instant.com)
        if self.flames is not None:
            plumes = drawing.plumes(self.look, instant, scales)
            _move(self.flames, PlacedShape(plumes.positions, plumes.rotations), instant.com)
            radii = np.full(len(self.look.jets), drawing.PLUME_RADIUS)
            self.flames.batched_scales = np.column_stack([radii, radii, np.maximum(plumes.lengths, 1e-4)])
        if self.arrows is not None:
            arrows = drawing.force_arrows(self.look, instant, scales)
            self.arrows.points = (arrows - instant.com).astype(np.float32)

    def remove(self) -> None:
        """Remove the robot from the scene."""
        self.root.remove()


def _batch(
    server: viser.ViserServer, name: str, mesh: Mesh, scales: Any, colours: Sequence[Colour], opacity: float | None
) -> Any:
    n = len(colours)
    return server.scene.add_batched_meshes_simple(
        name,
        mesh.vertices.astype(np.float32),
        mesh.faces.astype(np.uint32),
        batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        batched_positions=np.zeros((n, 3)),
        batched_scales=np.asarray(scales, dtype=np.float32),
        batched_colors=np.array(colours, dtype=np.uint8),
        opacity=opacity,
        lod="off",
        cast_shadow=opacity is None,
        receive_shadow=False,
    )


def _move(handle: Any, placed: PlacedShape, origin: Any) -> None:
    handle.batched_positions = (placed.positions - origin).astype(np.float32)
    handle.batched_wxyzs = tf.SO3.from_matrix(placed.rotations).wxyz.astype(np.float32)


def sky() -> Any:
    """Return a background picture that fades from light blue to white at the horizon, (h, w, 3)."""
    share = np.clip(np.linspace(0.0, 3.0, 240), 0.0, 1.0)[:, None, None]
    image = (1.0 - share) * np.array([205.0, 224.0, 242.0]) + share * 255.0
    return np.broadcast_to(image.astype(np.uint8), (240, 8, 3))


def thin_path(recording: Recording, name: str, until: float) -> Any:
    """Return a path up to a time, with ten points per second and the last one, (n, 3) [m]."""
    t = recording.signals["time"]
    end = max(int(np.searchsorted(t, until + 1e-9)), 1)
    step = max(round(0.1 / (t[1] - t[0])), 1) if t.size > 1 else 1
    return recording.signals[name][np.unique(np.append(np.arange(0, end, step), end - 1))]


def segments(path: Any) -> Any:
    """Return the lines between neighbouring points, (n, 2, 3); for a single point a line of zero length."""
    path = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    return np.stack([path[:-1], path[1:]], axis=1).astype(np.float32)
