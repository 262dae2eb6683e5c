"""The numbers of a robot, as the crate has read them; no expression is shared with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """Mass distribution of a rigid body as a cloud of points: total mass, centre and second moment about it."""

    mass: float
    """Mass [kg]."""
    centre: Array
    """(3,) centre of mass in body axes [m]."""
    scatter: Array
    """(3, 3) second moment ∫ ρ ρᵀ dm about the centre in body axes [kg m²]; the inertia is tr(scatter) 1 − scatter."""


@dataclass(frozen=True)
class Joint:
    """A joint; joint `i` moves body `i + 1`, which comes after its parent."""

    parent: int
    """Body that carries it."""
    position: Array
    """(3,) origin of the child in parent axes [m]."""
    rotation: Array
    """(3, 3) parent from child at joint position zero."""
    axis: Array
    """(3,) unit axis in child axes."""
    is_prismatic: bool
    """Whether the child translates along the axis [m] instead of rotating about it [rad]."""


class Frame(NamedTuple):
    """Place of a link of the URDF on a body."""

    body: int
    rotation: Array
    """(3, 3) body from frame."""
    position: Array
    """(3,) in body axes [m]."""


@dataclass(frozen=True)
class Jet:
    """An engine on a body, with thrust along `axis` at `position`; the exhaust leaves along −`axis`."""

    name: str
    frame: str
    """Link that carries it."""
    body: int
    position: Array
    """Point in body axes [m]."""
    axis: Array
    """Unit vector in body axes."""
    torque_to_thrust: float
    """Moment about the axis per thrust [m]."""
    thrust_min: float
    """Least thrust of an engine that runs [N]."""
    thrust_max: float
    """Greatest thrust [N]."""


@dataclass(frozen=True)
class AeroLink:
    """An aerodynamic link on a body: the point at which its force acts, its axis of symmetry and its size."""

    name: str
    frame: str
    """Link that it is."""
    body: int
    axis: Array
    """Unit vector in body axes."""
    centre: Array
    """Point in body axes [m]."""
    diameter: float
    length: float
    is_sphere: bool


@dataclass(frozen=True)
class Robot:
    """Numbers of one robot; SI units and radians."""

    name: str
    gravity: float
    joint_names: tuple[str, ...]
    joint_limits: Array
    """(n, 2) lower and upper limits that the controller respects [rad]."""
    joint_torque_max: Array
    """(n,) greatest torques [N m]."""
    joints: tuple[Joint, ...]
    bodies: tuple[Body, ...]
    """The base, then the child of every joint."""
    frames: Mapping[str, Frame]
    """Links of the URDF."""
    jets: tuple[Jet, ...]
    aero_links: tuple[AeroLink, ...]
    coefficients: Mapping[str, Array]
    """(links, 6) coefficients by set: five of `C_D A` and that of `C_N A` [m²]."""
    soles: Mapping[str, Array]
    """(k, 3) corners of the soles in sole axes [m], by sole frame."""

    @property
    def n_joints(self) -> int:
        """Number of moving joints."""
        return len(self.joint_names)

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return sum(body.mass for body in self.bodies)

    @property
    def thrust_min(self) -> Array:
        """(jets,) least thrusts of engines that run [N]."""
        return np.array([jet.thrust_min for jet in self.jets])

    @property
    def thrust_max(self) -> Array:
        """(jets,) greatest thrusts [N]."""
        return np.array([jet.thrust_max for jet in self.jets])

    @property
    def hover_thrust(self) -> Array:
        """(jets,) thrusts that share the weight in proportion to the greatest thrusts [N]."""
        return np.asarray(self.mass * self.gravity * self.thrust_max / self.thrust_max.sum())


def load_robot(path: str | Path) -> Robot:
    """Return the robot of a TOML file and the URDF that it names.

    Raises
    ------
    ConfigError
        If the crate refuses the robot.
    """
    read = rust.Robot(path)
    given = read.arrays()
    jets, links = given["jets"], given["aero_links"]
    axes = np.einsum("lij,lj->li", links["rotations"], links["axes"])
    centres = links["positions"] + np.einsum("lij,lj->li", links["rotations"], links["centres"])
    joints = zip(
        given["parent"][1:],
        given["joint_positions"],
        given["joint_rotations"],
        given["joint_axes"],
        given["joint_is_prismatic"],
        strict=True,
    )
    return Robot(
        name=read.name,
        gravity=read.gravity,
        joint_names=given["joint_names"],
        joint_limits=given["joint_limits"],
        joint_torque_max=given["joint_torque_max"],
        joints=tuple(Joint(*numbers) for numbers in joints),
        bodies=tuple(
            Body(float(mass), centre, 0.5 * np.trace(inertia) * np.eye(3) - inertia)
            for mass, centre, inertia in zip(given["masses"], given["coms"], given["inertias"], strict=True)
        ),
        frames={name: Frame(body, *pose) for name, (body, pose) in read.links().items()},
        jets=tuple(
            Jet(name, frame, body, position, rotation @ axis, *map(float, numbers))
            for name, frame, body, position, rotation, axis, *numbers in zip(
                jets["names"],
                read.jet_frames,
                jets["bodies"],
                jets["positions"],
                jets["rotations"],
                jets["axes"],
                jets["torque_to_thrust"],
                jets["thrust_min"],
                jets["thrust_max"],
                strict=True,
            )
        ),
        aero_links=tuple(
            AeroLink(name, frame, body, axis, centre, float(diameter), float(length), is_sphere)
            for name, frame, body, axis, centre, diameter, length, is_sphere in zip(
                links["names"],
                read.aero_link_frames,
                links["bodies"],
                axes,
                centres,
                links["diameters"],
                links["lengths"],
                links["is_sphere"],
                strict=True,
            )
        ),
        coefficients=links["coefficients"],
        soles=read.soles(),
    )
