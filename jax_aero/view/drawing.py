"""Drawing of one time of a flight, in the browser and in files: colours, scales, arrows, plumes, meshes.

The colours are from the palette of Okabe and Ito, which colour-blind readers can distinguish.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from jax_aero.body.mesh import Mesh, revolve
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
FELL: Colour = (213, 94, 0)
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


@dataclass(frozen=True)
class Scales:
    """Lengths of arrows and plumes per unit of the quantity drawn."""

    force: float = 0.15
    """Length per force [m/N]."""
    thrust: float = 0.0036
    """Length per thrust [m/N]."""
    wind: float = 0.08
    """Length per wind speed [m per m/s]."""

    @property
    def reference_force(self) -> float:
        """Round value of a force whose arrow is about 0.3 m long [N], for a legend."""
        wanted = 0.3 / self.force
        power = 10.0 ** np.floor(np.log10(wanted))
        return float(power * max(step for step in (1.0, 2.0, 5.0) if step <= 1.0001 * wanted / power))


class PlacedShape(NamedTuple):
    """Poses: (n, 3) positions [m] and (n, 3, 3) rotations, inertial axes."""

    positions: Vector
    rotations: Vector


def place(shapes: Sequence[Shape], instant: Instant) -> PlacedShape:
    """Return positions and rotations of shapes at an instant."""
    bodies = [shape.body for shape in shapes]
    offsets = np.array([shape.body_from_shape.position for shape in shapes])
    turns = np.array([shape.body_from_shape.rotation for shape in shapes])
    rotations = instant.body_rotations[bodies]
    return PlacedShape(instant.body_positions[bodies] + np.einsum("nij,nj->ni", rotations, offsets), rotations @ turns)


def force_arrows(look: Look, instant: Instant, scales: Scales) -> Vector:
    """Return tail and tip of the arrow of each link's aerodynamic force, at its point of action, (links, 2, 3) [m]."""
    if not look.links:
        return np.zeros((0, 2, 3))
    bodies = [link.body for link in look.links]
    offsets = np.array([link.position for link in look.links])
    tails = instant.body_positions[bodies] + np.einsum("nij,nj->ni", instant.body_rotations[bodies], offsets)
    return np.stack([tails, tails + scales.force * instant.aero_force], axis=1)


class Plumes(NamedTuple):
    """Cones of exhaust, one per jet: nozzle [m], direction as z axis, length [m] proportional to thrust."""

    positions: Vector
    rotations: Vector
    lengths: Vector


PLUME_RADIUS = 0.042  # m
OVERHEAD = 0.82  # m, height of the wind's arrow above the centre of mass


def plumes(look: Look, instant: Instant, scales: Scales) -> Plumes:
    """Return the exhaust of every jet."""
    positions, rotations = [], []
    for jet in look.jets:
        body_rotation = instant.body_rotations[jet.body]
        positions.append(instant.body_positions[jet.body] + body_rotation @ jet.position)
        rotations.append(rotation_onto(body_rotation @ jet.axis))
    lengths = scales.thrust * np.maximum(instant.thrust, 0.0)
    return Plumes(np.reshape(positions, (-1, 3)), np.reshape(rotations, (-1, 3, 3)), lengths)


def wind_arrow(instant: Instant, scales: Scales) -> Vector | None:
    """Return tail and tip of an arrow above the robot, (2, 3) [m]; `None` in still air."""
    speed = float(np.linalg.norm(instant.wind))
    if speed < 0.1:
        return None
    half = 0.5 * scales.wind * instant.wind
    above = instant.com + np.array([0.0, 0.0, OVERHEAD])
    return np.stack([above - half, above + half])


class Arrow(NamedTuple):
    """Unit vector, length [m], and length and radius of the head [m]."""

    axis: Vector
    length: float
    head: float
    head_radius: float


def arrow(ends: Vector, radius: float) -> Arrow | None:
    """Return the arrow of a radius [m] between two points, (2, 3) [m]; `None` if it is shorter than thick."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length < 2.0 * radius:
        return None
    return Arrow(along / length, length, min(5.0 * radius, 0.6 * length), 2.3 * radius)


def path(recording: Recording, name: str, until: float) -> Vector:
    """Return points at least 5 cm apart of a signal's path over the last 20 s before `until` [s], (n, 3) [m]."""
    first, last = np.searchsorted(recording.signals["time"], [until - 20.0, until])
    points = recording.signals[name][first : max(last, first + 1) : 10]
    chosen = [*points[:1]]
    for point in points[1:]:
        if np.linalg.norm(point - chosen[-1]) > 0.05:
            chosen.append(point)
    return np.reshape(chosen, (-1, 3))


def cone(segments: int = 24) -> Mesh:
    """Return a cone: base of radius 1 at the origin, tip at height 1."""
    return revolve([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 1.0)], segments)


Viewpoint = Literal["chase", "side"]


class Camera(NamedTuple):
    """Viewpoint of a picture: the point looked at [m], and the camera's angles [deg] and distance [m] from it.

    `azimuth_deg` is the direction of view about +z from +x, `elevation_deg` negative from above.
    """

    look_at: Vector
    azimuth_deg: float
    elevation_deg: float
    distance: float


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
