"""Pictures of a flight painted by Pillow, from the farthest face to the nearest, without MuJoCo and OpenGL."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from jax_aero.body.mesh import Mesh, box, revolve
from jax_aero.body.urdf import Vector
from jax_aero.view import drawing
from jax_aero.view.drawing import SHADOW, SUN, Camera, Colour, Scales
from jax_aero.view.recording import Instant, Recording
from jax_aero.view.shapes import Shape, rotation_onto

OVERSAMPLING = 2  # pixels painted per pixel and direction, for smooth edges
SEGMENTS = 14  # of round bodies
NEAREST = 0.1  # m in front of the camera, of what is painted
LINES = ((1.0, 12.0), (5.0, 60.0))  # m, distance of the ground's lines, and how far they reach
SKY: tuple[Colour, Colour] = ((189, 217, 242), (247, 250, 252))  # at the top, at the horizon
GROUND: tuple[Colour, Colour] = ((222, 225, 228), (196, 200, 206))  # its lines
GHOST_OPACITY, PLUME_OPACITY = 0.35, 0.85


class Solid(NamedTuple):
    """A mesh in inertial axes, and how it is painted."""

    mesh: Mesh
    colour: Colour
    opacity: float = 1.0


class Painter:
    """Renderer of a recording, and of a ghost in the same scene, as `offscreen.Studio` is one.

    Faces hide one another by the distances of their centres, so that long ones which intersect may hide each other
    wrongly. Meshes of many thousand faces take seconds a picture.
    """

    def __init__(self, recording: Recording, width: int, height: int, ghost: Recording | None = None) -> None:
        self.recording, self.ghost, self.width, self.height = recording, ghost, width, height
        self.scales = Scales()
        self._tube = revolve([(0.0, -0.5), (1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (1.0, 0.5), (0.0, 0.5)], SEGMENTS)
        self._cone = drawing.cone(SEGMENTS)
        bows = np.linspace(-0.5, 0.5, SEGMENTS // 2 + 1) * np.pi
        self._ball = revolve([(max(float(np.cos(bow)), 0.0), float(np.sin(bow))) for bow in bows], SEGMENTS)
        self._flights = [
            (flight, [self._own_mesh(shape) for shape in flight.look.shapes])
            for flight in (recording, ghost)
            if flight is not None
        ]

    def __enter__(self) -> Painter:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""

    def pixels_per_metre(self, camera: Camera) -> float:
        """Return the scale of the picture at the distance of the point looked at [pixels/m]."""
        return drawing.focal_length(self.height) / camera.distance

    def picture(self, time: float, camera: Camera, *, trail: bool = True) -> NDArray[np.uint8]:
        """Return the picture at a time [s], (height, width, 3), without text."""
        canvas = _Canvas(self.width, self.height, camera)
        instant = self.recording.at(time)
        bodies: list[Solid] = []
        for flight, meshes in self._flights:
            now = instant if flight is self.recording else flight.at(time)
            is_ghost = flight is self.ghost
            placed = drawing.place(flight.look.shapes, now)
            for shape, mesh, position, rotation in zip(
                flight.look.shapes, meshes, placed.positions, placed.rotations, strict=True
            ):
                colour = drawing.GHOST if is_ghost else drawing.ROLES[shape.role]
                solid = Solid(_moved(mesh, position, rotation), colour, GHOST_OPACITY if is_ghost else 1.0)
                if not is_ghost and shape.role != "strut" and position[2] > 0.0:
                    canvas.shadow(solid)
                bodies.append(solid)
        if trail:
            canvas.line(drawing.path(self.recording, "com_setpoint", time + drawing.AHEAD), drawing.REFERENCE, 0.014)
            canvas.line(drawing.path(self.recording, "com_position", time), drawing.TRAIL, 0.014)
        for axis in 0.28 * np.eye(3):
            canvas.line(instant.com_setpoint + np.array([-axis, axis]), drawing.REFERENCE, 0.012)
        canvas.paint([*bodies, *self._plumes(instant)])
        canvas.paint(list(self._arrows(instant)))  # in front, as their tails are within the bodies
        return canvas.pixels()

    def _own_mesh(self, shape: Shape) -> Mesh:
        """Return the mesh of a shape about its own origin [m]."""
        if shape.mesh is not None:
            vertices, faces = shape.mesh
        else:
            vertices, faces = {"cylinder": self._tube, "sphere": self._ball, "box": box()}[shape.kind]
        return Mesh(vertices * shape.size, faces)

    def _plumes(self, instant: Instant) -> Iterator[Solid]:
        radius = drawing.PLUME_RADIUS
        for position, rotation, length in zip(*drawing.plumes(self.recording.look, instant, self.scales), strict=True):
            if length > 1e-3:
                mesh = Mesh(self._cone.vertices * [radius, radius, length], self._cone.faces)
                yield Solid(_moved(mesh, position, rotation), drawing.PLUME, PLUME_OPACITY)

    def _arrows(self, instant: Instant) -> Iterator[Solid]:
        for ends in drawing.force_arrows(self.recording.look, instant, self.scales):
            yield from self._arrow(ends, 0.0105, drawing.FORCE)
        wind = drawing.wind_arrow(instant, self.scales)
        if wind is not None:
            yield from self._arrow(wind, 0.03, drawing.WIND)

    def _arrow(self, ends: Vector, radius: float, colour: Colour) -> Iterator[Solid]:
        arrow = drawing.arrow(ends, radius)
        if arrow is None:
            return
        rotation = rotation_onto(arrow.axis)
        shaft, head = arrow.length - arrow.head, arrow.head
        tube = Mesh(self._tube.vertices * [radius, radius, shaft], self._tube.faces)
        yield Solid(_moved(tube, ends[0] + 0.5 * shaft * arrow.axis, rotation), colour)
        cone = Mesh(self._cone.vertices * [arrow.head_radius, arrow.head_radius, head], self._cone.faces)
        yield Solid(_moved(cone, ends[1] - head * arrow.axis, rotation), colour)


def _moved(mesh: Mesh, position: Vector, rotation: Vector) -> Mesh:
    return Mesh(mesh.vertices @ rotation.T + position, mesh.faces)


class _Canvas:
    """A picture with sky and ground, seen from a camera."""

    def __init__(self, width: int, height: int, camera: Camera) -> None:
        self.size = OVERSAMPLING * width, OVERSAMPLING * height
        azimuth, elevation = np.deg2rad([camera.azimuth_deg, camera.elevation_deg])
        ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        self._axes = np.stack([right, np.cross(ahead, right), ahead])  # right, down, ahead
        self._eye = camera.look_at - camera.distance * ahead
        self._focus = drawing.focal_length(self.size[1])
        horizon = 0.5 * self.size[1] + self._focus * np.tan(elevation)
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
        onto = solid.mesh.vertices - solid.mesh.vertices[:, 2:] * (np.array(SUN) / SUN[2])
        places, depths = self._project(onto)
        if depths.min() > NEAREST:
            for face in places[solid.mesh.faces]:
                self._draw.polygon([tuple(place) for place in face], fill=SHADOW)

    def line(self, points: Vector, colour: Colour, width: float) -> None:
        """Paint a line through points, (n, 3) [m], of a width [m] at the distance of each segment."""
        places, depths = self._project(points)
        for start in range(len(points) - 1):
            depth = depths[start : start + 2].min()
            if depth > NEAREST:
                pixels = max(round(width * self._focus / depth), 1)
                self._draw.line([tuple(place) for place in places[start : start + 2]], fill=colour, width=pixels)

    def paint(self, solids: list[Solid]) -> None:
        """Paint the faces that are turned to the camera, the farthest first."""
        if not solids:
            return
        vertices = np.concatenate([solid.mesh.vertices for solid in solids])
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
        for face in np.argsort(-distance):
            if is_seen[face]:
                solid = solids[owner[face]]
                fill = (*(int(part * shade[face]) for part in solid.colour), int(255 * solid.opacity))
                self._draw.polygon([tuple(place) for place in places[faces[face]]], fill=fill)

    def _project(self, points: Vector) -> tuple[Vector, Vector]:
        """Return pixels (n, 2), and depths in front of the camera [m]."""
        seen = (points - self._eye) @ self._axes.T
        depths = seen[:, 2]
        scale = self._focus / np.where(depths > NEAREST, depths, NEAREST)
        return 0.5 * np.array(self.size) + seen[:, :2] * scale[:, None], depths

    def _ground(self, look_at: Vector) -> None:
        """Paint the lines of the ground below the point looked at."""
        for spacing, reach in LINES:
            middle = spacing * np.round(look_at[:2] / spacing)
            stations = np.arange(-reach, reach + 0.5 * spacing, spacing)
            for along in (0, 1):
                for station in stations:
                    line = np.zeros((len(stations), 3))
                    line[:, along] = middle[along] + stations
                    line[:, 1 - along] = middle[1 - along] + station
                    self.line(line, GROUND[1], 0.01)
