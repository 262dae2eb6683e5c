"""Pictures of a flight painted by Pillow, from the farthest face to the nearest, without MuJoCo and OpenGL."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from jax_aero.body.urdf import Vector
from jax_aero.view import drawing
from jax_aero.view.drawing import SHADOW, SUN, Camera, Colour, Scene, Solid, shadow_of
from jax_aero.view.recording import Recording

OVERSAMPLING = 2  # pixels painted per pixel and direction, for smooth edges
SEGMENTS = 14  # of round bodies
NEAREST = 0.1  # m in front of the camera, of what is painted
LINES = ((1.0, 12.0), (5.0, 60.0))  # m, distance of the ground's lines, and how far they reach
SKY: tuple[Colour, Colour] = ((189, 217, 242), (247, 250, 252))  # at the top, at the horizon
GROUND: tuple[Colour, Colour] = ((222, 225, 228), (196, 200, 206))  # its lines


class Painter(Scene):
    """Renderer of a scene, as `offscreen.Studio` is one.

    Faces hide one another by the distances of their centres, so that long ones which intersect may hide each other
    wrongly. Meshes of many thousand faces take seconds a picture.
    """

    def __init__(self, recording: Recording, width: int, height: int, ghost: Recording | None = None) -> None:
        super().__init__(recording, width, height, ghost, SEGMENTS)

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""

    def picture(self, time: float, camera: Camera, *, trail: bool = True, forces: bool = True) -> NDArray[np.uint8]:
        """Return the picture at a time [s], (height, width, 3), without text; `forces` are those of the air."""
        canvas, bodies = _Canvas(self.width, self.height, camera), list(self.bodies(time))
        for solid in bodies:
            if solid.has_shadow:
                canvas.shadow(solid)
        for line in self.lines(time, trail=trail):
            canvas.line(line.points, line.colour, 2.0 * line.radius)
        canvas.paint(bodies)
        canvas.paint(list(self.arrows(time, forces=forces)))  # in front, as their tails are within the bodies
        return canvas.pixels()


def _corners(solid: Solid) -> Vector:
    return solid.mesh.vertices @ solid.stretch.T + solid.position


def _polygons(places: Vector, faces: NDArray[np.int_]) -> list[list[float]]:
    """Return the corners of faces in turn, as Pillow takes them."""
    corners: list[list[float]] = places[faces].reshape(len(faces), 2 * faces.shape[1]).tolist()
    return corners


class _Canvas:
    """A picture with sky and ground, seen from a camera."""

    def __init__(self, width: int, height: int, camera: Camera) -> None:
        self.size = OVERSAMPLING * width, OVERSAMPLING * height
        self._axes, self._eye = camera.axes, camera.eye
        self._focus = drawing.focal_length(self.size[1])
        horizon = 0.5 * self.size[1] + self._focus * np.tan(np.deg2rad(camera.elevation_deg))
        share = np.clip(np.arange(self.size[1]) / max(horizon, 1.0), 0.0, 1.0)[:, None]
        rows = (1.0 - share) * SKY[0] + share * SKY[1]
        rows[np.arange(self.size[1]) > horizon] = GROUND[0]
        self._image = Image.fromarray(np.repeat(rows[:, None], self.size[0], axis=1).astype(np.uint8))
        self._draw = ImageDraw.Draw(self._image, "RGBA")
        self._ground(camera.look_at)

    def pixels(self) -> NDArray[np.uint8]:
        """Return the picture in its own size, (height, width, 3)."""
        return np.asarray(self._image.reduce(OVERSAMPLING))

    def shadow(self, solid: Solid) -> None:
        """Paint a solid's shadow on the ground."""
        places, depths = self._project(_corners(shadow_of(solid)))
        if depths.min() > NEAREST:
            for face in _polygons(places, solid.mesh.faces):
                self._draw.polygon(face, fill=SHADOW)

    def line(self, points: Vector, colour: Colour, width: float) -> None:
        """Paint lines through points, (..., n, 3) [m], of a width [m] at the distance of each segment."""
        places, depths = self._project(points)
        depth = np.minimum(depths[..., :-1], depths[..., 1:])
        is_ahead = depth > NEAREST
        pixels = np.maximum(np.round(width * self._focus / depth[is_ahead]), 1).astype(int)
        segments = np.concatenate([places[..., :-1, :], places[..., 1:, :]], axis=-1)[is_ahead]
        for segment, thickness in zip(segments.tolist(), pixels.tolist(), strict=True):
            self._draw.line(segment, fill=colour, width=thickness)

    def paint(self, solids: list[Solid]) -> None:
        """Paint the faces that are turned to the camera, the farthest first."""
        if not solids:
            return
        vertices = np.concatenate([_corners(solid) for solid in solids])
        counts = [len(solid.mesh.vertices) for solid in solids]
        firsts = np.cumsum([0, *counts[:-1]])
        faces = np.concatenate([solid.mesh.faces + first for solid, first in zip(solids, firsts, strict=True)])
        owner = np.repeat(np.arange(len(solids)), [len(solid.mesh.faces) for solid in solids])
        places, depths = self._project(vertices)
        corners = vertices[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        is_seen = np.einsum("fi,fi->f", normals, corners[:, 0] - self._eye) < 0.0
        is_seen &= depths[faces].min(axis=1) > NEAREST
        light = -np.array(SUN) / np.linalg.norm(SUN)
        head_on = np.abs(normals @ self._axes[2])
        shade = np.minimum(0.5 + 0.35 * np.maximum(normals @ light, 0.0) + 0.25 * head_on, 1.0)
        distance = np.linalg.norm(corners.mean(axis=1) - self._eye, axis=1)
        order = np.argsort(-distance)
        order = order[is_seen[order]]
        colours = np.array([solid.colour for solid in solids])[owner[order]] * shade[order, None]
        opacities = 255 * np.array([solid.opacity for solid in solids])[owner[order]]
        fills = np.column_stack([colours, opacities]).astype(int).tolist()
        for face, fill in zip(_polygons(places, faces[order]), fills, strict=True):
            self._draw.polygon(face, fill=tuple(fill))

    def _project(self, points: Vector) -> tuple[Vector, Vector]:
        """Return pixels (..., 2), and depths (...) in front of the camera [m], of points (..., 3) [m]."""
        seen = (points - self._eye) @ self._axes.T
        depths = seen[..., 2]
        scale = self._focus / np.where(depths > NEAREST, depths, NEAREST)
        return 0.5 * np.array(self.size) + seen[..., :2] * scale[..., None], depths

    def _ground(self, look_at: Vector) -> None:
        """Paint the lines of the ground below the point looked at."""
        for spacing, reach in LINES:
            middle = spacing * np.round(look_at[:2] / spacing)
            stations = np.arange(-reach, reach + 0.5 * spacing, spacing)
            grid = np.zeros((len(stations), len(stations), 3))
            grid[..., 0], grid[..., 1] = np.meshgrid(middle[0] + stations, middle[1] + stations)
            for lines in (grid, grid.swapaxes(0, 1)):
                self.line(lines, GROUND[1], 0.01)
