"""Drawing of one time of a flight, in the browser and in files: colours, scales, arrows, plumes, meshes.

The colours are from the palette of Okabe and Ito, which colour-blind readers can distinguish.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero.body.mesh import Mesh, box, revolve
from jax_aero.body.urdf import Vector
from jax_aero.view.recording import Instant, Recording
from jax_aero.view.shapes import Look, Role, Shape, rotation_onto

Colour = tuple[int, int, int]

FORCE: Colour = (0, 114, 178)
WIND: Colour = (86, 180, 233)
REFERENCE: Colour = (0, 158, 115)
TRAIL: Colour = (204, 121, 167)
PLUME: Colour = (230, 159, 0)
GHOST: Colour = (104, 78, 170)
LOST: Colour = (213, 94, 0)
COMPLETED: Colour = (0, 120, 90)

SHADOW: Colour = (92, 96, 106)
SUN = (0.25, 0.35, -1.0)  # direction of the sunlight
FIELD_OF_VIEW_DEG = 38.0
AHEAD = 12.0  # s of the reference's path that are drawn before the robot

ROLES: dict[Role, Colour] = {
    "shell": (226, 223, 214),
    "engine": (72, 76, 84),
    "sole": (72, 76, 84),
    "strut": (150, 152, 156),
}


SCALES = {"force": 0.15, "thrust": 0.0036, "wind": 0.08}
"""Lengths of arrows and plumes per unit of the quantity drawn [m/N, m/N, m per m/s]."""
REFERENCE_FORCE = 2.0
"""Force whose arrow is in the legend [N]."""


def force_arrows(look: Look, instant: Instant) -> Vector:
    """Return tail and tip of the arrow of each link's aerodynamic force, at its point of action, (links, 2, 3) [m]."""
    if not look.links:
        return np.zeros((0, 2, 3))
    bodies = [link.body for link in look.links]
    offsets = np.array([link.position for link in look.links])
    tails = instant.body_positions[bodies] + np.einsum("nij,nj->ni", instant.body_rotations[bodies], offsets)
    return np.stack([tails, tails + SCALES["force"] * instant.aero_force], axis=1)


PLUME_RADIUS = 0.042  # m
GHOST_OPACITY, PLUME_OPACITY = 0.35, 0.85
OVERHEAD = 0.82  # m, height of the wind's arrow above the centre of mass


def wind_arrow(instant: Instant) -> Vector | None:
    """Return tail and tip of an arrow above the robot, (2, 3) [m]; `None` in still air."""
    speed = float(np.linalg.norm(instant.wind))
    if speed < 0.1:
        return None
    half = 0.5 * SCALES["wind"] * instant.wind
    above = instant.com + np.array([0.0, 0.0, OVERHEAD])
    return np.stack([above - half, above + half])


def path(recording: Recording, name: str, until: float) -> Vector:
    """Return points at least 5 cm apart of a signal's path over the last 20 s before `until` [s], (n, 3) [m]."""
    first, last = np.searchsorted(recording.signals["time"], [until - 20.0, until])
    points = recording.signals[name][first : max(last, first + 1) : 10]
    chosen = [*points[:1]]
    for point in points[1:]:
        if np.linalg.norm(point - chosen[-1]) > 0.05:
            chosen.append(point)
    return np.reshape(chosen, (-1, 3))


Viewpoint = Literal["chase", "side"]


class Camera(NamedTuple):
    """Viewpoint of a picture: the point looked at [m], and the camera's angles [deg] and distance [m] from it.

    `azimuth_deg` is the direction of view about +z from +x, `elevation_deg` negative from above.
    """

    look_at: Vector
    azimuth_deg: float
    elevation_deg: float
    distance: float

    @property
    def axes(self) -> Vector:
        """Unit vectors of a picture to its right, down and ahead, the rows of (3, 3)."""
        azimuth, elevation = np.deg2rad([self.azimuth_deg, self.elevation_deg])
        ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(ahead, right), ahead])

    @property
    def eye(self) -> Vector:
        """Its own place [m]."""
        return np.asarray(self.look_at - self.distance * self.axes[2])


def camera_at(recording: Recording, time: float, viewpoint: Viewpoint, distance: float) -> Camera:
    """Return a camera at a distance [m] from the centre of mass: behind and above it, or to the robot's right.

    It rotates with the reference heading, so that the picture stays upright when the robot tumbles.
    """
    s = recording.signals
    yaw = np.rad2deg(np.unwrap(s["base_rpy_setpoint"][:, 2]))
    turned = float(np.interp(time, s["time"], yaw) - yaw[0])
    look_at = recording.at(time).com + np.array([0.0, 0.0, 0.1])
    azimuth, elevation = {"chase": (32.0, -16.0), "side": (72.0, -7.0)}[viewpoint]
    return Camera(look_at, azimuth + turned, elevation, distance)


def focal_length(height: int) -> float:
    """Return the focal length of a picture of this height [pixels]."""
    return float(0.5 * height / np.tan(0.5 * np.deg2rad(FIELD_OF_VIEW_DEG)))


class Solid(NamedTuple):
    """A body of a picture: the points `position + stretch @ x` of a mesh [m, inertial axes]."""

    mesh: Mesh
    position: Vector
    stretch: Vector
    colour: Colour
    opacity: float = 1.0
    has_shadow: bool = False


class Line(NamedTuple):
    """A line through points, (n, 3) [m], of a radius [m]."""

    points: Vector
    colour: Colour
    radius: float


def shadow_of(solid: Solid) -> Solid:
    """Return a solid along the sunlight on the ground, with negligible thickness and just above it."""
    flatten = np.array([[1.0, 0.0, -SUN[0] / SUN[2]], [0.0, 1.0, -SUN[1] / SUN[2]], [0.0, 0.0, 1e-3]])
    lifted = flatten @ solid.position + np.array([0.0, 0.0, 0.004])
    return solid._replace(position=lifted, stretch=flatten @ solid.stretch, colour=SHADOW)


class Scene(AbstractContextManager["Scene"]):
    """What the pictures of a flight show, of a size [pixels]; a ghost is another flight, drawn translucent.

    `offscreen.Studio` and `painter.Painter` draw it.
    """

    def __init__(
        self, recording: Recording, width: int, height: int, ghost: Recording | None = None, segments: int = 48
    ) -> None:
        self.recording, self.ghost, self.width, self.height = recording, ghost, width, height
        bows = np.linspace(-0.5, 0.5, segments // 2 + 1) * np.pi
        self.cylinder = revolve([(0.0, -0.5), (1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (1.0, 0.5), (0.0, 0.5)], segments)
        self.cone = revolve([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 1.0)], segments)
        ball = revolve([(max(float(np.cos(bow)), 0.0), float(np.sin(bow))) for bow in bows], segments)
        units = {"cylinder": self.cylinder, "sphere": ball, "box": box()}
        flights = [flight for flight in (recording, ghost) if flight is not None]
        self.meshes = [
            [_sized(shape) if shape.mesh is not None else units[shape.kind] for shape in flight.look.shapes]
            for flight in flights
        ]

    @abstractmethod
    def picture(self, time: float, camera: Camera, *, trail: bool = True, forces: bool = True) -> NDArray[np.uint8]:
        """Return the picture at a time [s], (height, width, 3), without text; `forces` are those of the air."""

    def pixels_per_metre(self, camera: Camera) -> float:
        """Return the scale of the picture at the distance of the point looked at [pixels/m]."""
        return focal_length(self.height) / camera.distance

    def stopped(self, time: float, camera: Camera) -> Iterator[Vector]:
        """Yield the place in the picture of each engine that has stopped [pixels], (2,)."""
        now, look = self.recording.at(time), self.recording.look
        for jet, is_stopped in zip(look.jets, now.stopped, strict=True):
            if is_stopped:
                nozzle = now.body_positions[jet.body] + now.body_rotations[jet.body] @ jet.position
                across, down, ahead = camera.axes @ (nozzle - camera.eye)
                if ahead > 0.0:
                    middle = 0.5 * np.array([self.width, self.height])
                    yield middle + focal_length(self.height) / ahead * np.array([across, down])

    def bodies(self, time: float) -> Iterator[Solid]:
        """Yield the shapes of the robot and of the ghost, and the exhaust of every jet, as long as its thrust.

        An engine that has stopped has the colour of a loss.
        """
        flights = (self.recording, self.ghost)
        for flight, meshes, is_ghost in zip(flights, self.meshes, (False, True), strict=False):
            assert flight is not None
            now = flight.at(time)
            stopped = {jet.link for jet, is_stopped in zip(flight.look.jets, now.stopped, strict=True) if is_stopped}
            for shape, mesh in zip(flight.look.shapes, meshes, strict=True):
                rotation = now.body_rotations[shape.body]
                position = now.body_positions[shape.body] + rotation @ shape.body_from_shape.position
                stretch = rotation @ shape.body_from_shape.rotation * (shape.size if shape.mesh is None else 1.0)
                if is_ghost:
                    yield Solid(mesh, position, stretch, GHOST, GHOST_OPACITY)
                else:
                    has_shadow = shape.role != "strut" and bool(position[2] > 0.0)
                    colour = LOST if shape.name in stopped else ROLES[shape.role]
                    yield Solid(mesh, position, stretch, colour, has_shadow=has_shadow)
        now = self.recording.at(time)
        for jet, thrust in zip(self.recording.look.jets, now.thrust, strict=True):
            length = SCALES["thrust"] * max(float(thrust), 0.0)
            if length > 1e-3:
                rotation = now.body_rotations[jet.body]
                nozzle = now.body_positions[jet.body] + rotation @ jet.position
                stretch = rotation_onto(rotation @ jet.axis) * [PLUME_RADIUS, PLUME_RADIUS, length]
                yield Solid(self.cone, nozzle, stretch, PLUME, PLUME_OPACITY)

    def arrows(self, time: float, *, forces: bool) -> Iterator[Solid]:
        """Yield the arrows of the wind and, with `forces`, of the links' aerodynamic forces."""
        now = self.recording.at(time)
        for ends in force_arrows(self.recording.look, now) if forces else ():
            yield from self._arrow(ends, 0.0105, FORCE)
        if (wind := wind_arrow(now)) is not None:
            yield from self._arrow(wind, 0.03, WIND)

    def _arrow(self, ends: Vector, radius: float, colour: Colour) -> Iterator[Solid]:
        """Yield shaft and head of an arrow of a radius [m], if it is longer than thick."""
        along = ends[1] - ends[0]
        length = float(np.linalg.norm(along))
        if length < 2.0 * radius:
            return
        axis, head = along / length, min(5.0 * radius, 0.6 * length)
        rotation, shaft = rotation_onto(axis), length - head
        yield Solid(self.cylinder, ends[0] + 0.5 * shaft * axis, rotation * [radius, radius, shaft], colour)
        yield Solid(self.cone, ends[1] - head * axis, rotation * [2.3 * radius, 2.3 * radius, head], colour)

    def lines(self, time: float, *, trail: bool) -> Iterator[Line]:
        """Yield the cross at the set-point of the centre of mass and, with `trail`, its reference and its path."""
        now = self.recording.at(time)
        for axis in 0.28 * np.eye(3):
            yield Line(now.com_setpoint + np.array([-axis, axis]), REFERENCE, 0.006)
        if trail:
            yield Line(path(self.recording, "com_setpoint", time + AHEAD), REFERENCE, 0.006)
            yield Line(path(self.recording, "com_position", time), TRAIL, 0.009)


def _sized(shape: Shape) -> Mesh:
    """Return the mesh of a shape in its size; of a mirrored one the faces turn, to be seen from outside."""
    assert shape.mesh is not None
    order = 1 if np.prod(shape.size) > 0.0 else -1
    return Mesh(shape.mesh.vertices * shape.size, shape.mesh.faces[:, ::order])
