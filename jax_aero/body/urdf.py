"""Links, joints and shapes of a URDF, as the crate reads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jax_aero.base import crate

Vector: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """A rigid transform `a_from_b`."""

    rotation: Vector
    position: Vector

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: `a_from_b @ b_from_c`."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.position + self.position)


IDENTITY = Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Joint:
    """A joint; units are those of one that turns, m and N replace rad and N m for a prismatic one."""

    name: str
    parent: str
    child: str
    origin: Pose
    """Pose of the child in the parent at position zero."""
    moves: bool
    """Whether the joint has a degree of freedom."""
    is_prismatic: bool
    axis: Vector | None
    """Direction in which it moves or about which it turns, in axes of the child; `None` for one that is fixed."""
    limits: tuple[float, float] | None
    """Range of positions [rad]; `None` for a continuous joint, and where the URDF states none."""
    effort: float
    """Greatest torque [N m]; 0 if not given."""
    velocity: float
    """Greatest velocity [rad/s]; 0 if not given."""
    mimics: str | None
    """Joint that this one follows."""


@dataclass(frozen=True)
class Shape:
    """A primitive or mesh of a link: a visual one, or where the link has none, one for collisions."""

    link: str
    origin: Pose
    """Pose of the centre, or of a mesh's origin, in link axes."""
    kind: Literal["sphere", "cylinder", "capsule", "box", "mesh"]
    size: tuple[float, float, float]
    """Radius three times of a sphere; radius twice and length along z of a cylinder or capsule; edges of a box [m];
    factors on the coordinates of a mesh."""
    file: str | None
    """File of a mesh, as the URDF names it."""


class Inertial(NamedTuple):
    """Mass of a link [kg], its centre of mass [m], and the inertia about it [kg m²], in link axes."""

    mass: float
    com: Vector
    inertia: Vector


@dataclass(frozen=True)
class Urdf:
    """Links, joints and shapes, in the order of the file."""

    name: str | None
    links: Sequence[str]
    inertials: Mapping[str, Inertial]
    """Of the links that have a mass."""
    joints: Sequence[Joint]
    shapes: Sequence[Shape]
    unused: Mapping[str, int]
    """How often each tag is there that is not used."""


def read_urdf(path: str | PathLike[str]) -> Urdf:
    """Read a URDF alone, of which a robot's TOML file can be made.

    Raises
    ------
    ValueError
        If a link, joint or shape is invalid; the message names file, item and value.
    """
    read = crate.read_urdf(path)
    joints = [Joint(**{**joint, "origin": Pose(*joint["origin"])}) for joint in read["joints"]]
    inertials = {link: Inertial(*numbers) for link, numbers in read["inertials"].items()}
    return Urdf(read["name"], read["links"], inertials, joints, typed_shapes(read["shapes"]), read["unused"])


def typed_shapes(read: Sequence[dict[str, Any]]) -> list[Shape]:
    """Return shapes of a URDF as the crate reads them, of `rust.Robot.shapes` too, as their type."""
    return [Shape(**{**shape, "origin": Pose(*shape["origin"]), "size": tuple(shape["size"])}) for shape in read]
