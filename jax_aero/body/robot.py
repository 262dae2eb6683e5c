"""The robot: a tree of rigid bodies with named frames, as the crate reads it from TOML and URDF.

Every number is a leaf of the pytree, so masses, coefficients or limits can be batched and differentiated. Everything
that determines the structure of the computation (names, parents, the bodies that carry frames) is static.
"""

from __future__ import annotations

import functools
from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jax_aero.base import crate
from jax_aero.types import Array, pytree, static

ENGINE_KEYS = ("k_t", "k_tt", "k_d", "k_dd", "k_td", "b_u", "b_t", "b_d", "b_uu", "c", "throttle_min", "throttle_max")
"""Coefficients of the second-order engine model, in the order of `RobotModel.engines`."""


@pytree
class Jets:
    """Thrusters, jets or rotors: a force along a fixed axis of a frame, at its origin, and a moment about it."""

    names: tuple[str, ...] = static()
    bodies: tuple[int, ...] = static()
    """Body that carries each jet."""
    engines: tuple[str, ...] = static()
    """Name of each jet's engine in `RobotModel.engines`."""
    rotations: Float[Array, "j 3 3"]
    """`body_from_frame`."""
    positions: Float[Array, "j 3"]
    """Origins in body axes [m]."""
    axes: Float[Array, "j 3"]
    """Direction of the force on the robot, in frame axes."""
    torque_to_thrust: Float[Array, " j"]
    """Moments on the robot about the axes per thrust [m]: reaction torques of rotors, 0 for jets."""
    thrust_min: Float[Array, " j"]
    """Least thrusts of engines that run [N]."""
    thrust_max: Float[Array, " j"]
    """Greatest thrusts [N]."""

    @property
    def count(self) -> int:
        """Number of jets."""
        return len(self.names)


@pytree
class AeroLinks:
    """Links with aerodynamic forces, in the order of every aerodynamic table."""

    names: tuple[str, ...] = static()
    bodies: tuple[int, ...] = static()
    """Body that carries each link."""
    is_sphere: tuple[bool, ...] = static()
    rotations: Float[Array, "L 3 3"]
    """`body_from_link`."""
    positions: Float[Array, "L 3"]
    """Origins in body axes [m]."""
    axes: Float[Array, "L 3"]
    """Unit axes of symmetry in link axes."""
    centres: Float[Array, "L 3"]
    """Points at which the forces act, link axes [m]."""
    diameters: Float[Array, " L"]
    """Diameters [m]."""
    lengths: Float[Array, " L"]
    """Lengths along the axis [m]."""
    coefficients: dict[str, Float[Array, "L 6"]]
    """Coefficients by name of the set: force areas `w0 .. w4` of the drag and `w5` of the normal force [m²]."""

    @property
    def count(self) -> int:
        """Number of links."""
        return len(self.names)


@pytree
class RobotModel:
    """A robot. Body 0 is the floating base; joint `i` moves body `i + 1`; ancestors come before descendants."""

    name: str = static()
    parent: tuple[int, ...] = static()
    """(nb,) parent of each body; −1 for the base."""
    body_names: tuple[str, ...] = static()
    joint_names: tuple[str, ...] = static()
    joint_is_prismatic: tuple[bool, ...] = static()
    """Whether each joint translates its child along the axis instead of rotating it; its units are m and N."""
    joint_groups: tuple[tuple[str, tuple[int, ...]], ...] = static()
    """Groups of joints as (name, indices); together they contain every joint once, in order."""
    source: str = static()
    """Path of the TOML file, also used to build the MuJoCo model."""
    masses: Float[Array, " nb"]
    """Masses [kg]."""
    coms: Float[Array, "nb 3"]
    """Centres of mass in body axes [m]."""
    inertias: Float[Array, "nb 3 3"]
    """Inertias about the centre of mass, body axes [kg m²]."""
    joint_rotations: Float[Array, "n 3 3"]
    """`parent_from_child` at joint position zero."""
    joint_positions: Float[Array, "n 3"]
    """Origins of the child bodies in parent axes [m]."""
    joint_axes: Float[Array, "n 3"]
    """Unit axes in child axes."""
    joint_limits: Float[Array, "n 2"]
    """Lower and upper limits that the controller respects [rad]."""
    joint_stops: Float[Array, "n 2"]
    """Positions of the mechanical stops [rad]: the URDF's range, extended to the controller's limits."""
    joint_torque_max: Float[Array, " n"]
    """Greatest torques [N m]."""
    joint_torque_rate_max: Float[Array, " n"]
    """Greatest torque rates [N m/s]; infinite if unlimited."""
    joint_velocity_max: Float[Array, " n"]
    """Greatest velocities [rad/s]."""
    forward_axis: Float[Array, "3"]
    """Forward direction in base axes, a unit vector orthogonal to z."""
    gravity: Float[Array, ""]
    """Gravitational acceleration [m/s²], positive, along −z."""
    jets: Jets
    aero_links: AeroLinks
    engines: dict[str, Float[Array, "12"]]
    """Coefficients by name of the engine, in the order of `ENGINE_KEYS`."""
    rotor_inertia: Float[Array, " n"] | None = None
    """Rotor inertias of the drives, reflected to the joints [kg m²]; `None` where torques act on joints themselves."""

    @property
    def n_joints(self) -> int:
        """Number of moving joints."""
        return len(self.joint_names)

    @property
    def joint_turns(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """(n,) 1 for a revolute joint and 0 for a prismatic one."""
        return 1.0 - np.array(self.joint_is_prismatic, dtype=np.float64)

    @property
    def n_velocities(self) -> int:
        """Length of `ν`."""
        return 6 + len(self.joint_names)

    @property
    def mass(self) -> Float[Array, ""]:
        """Total mass [kg]."""
        return self.masses.sum()

    @property
    def ancestors(self) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """Static mask of whether joint `j` moves body `i`."""
        return ancestors_of(self.parent)

    @property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """Bodies grouped by depth in the tree, starting with the base."""
        return levels_of(self.parent)


@functools.lru_cache
def ancestors_of(parent: tuple[int, ...]) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Return whether joint `j` moves body `i`, (bodies, joints)."""
    mask = np.zeros((len(parent), len(parent) - 1), dtype=np.bool_)
    for body, carrier in enumerate(parent):
        if carrier >= 0:
            mask[body] = mask[carrier]
            mask[body, body - 1] = True
    mask.setflags(write=False)
    return mask


@functools.lru_cache
def levels_of(parent: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """Return the bodies grouped by their depth in the tree."""
    depth = ancestors_of(parent).sum(axis=1)
    return tuple(tuple(int(body) for body in np.flatnonzero(depth == level)) for level in range(int(depth.max()) + 1))


def load_robot(path: str | PathLike[str]) -> RobotModel:
    """Return the crate's robot, read from a TOML file and the URDF named in it.

    The leaves are NumPy arrays in double precision, which JAX converts to the caller's precision.

    Raises
    ------
    ValueError
        If a value is invalid; the message names the file, the key, its value and what was expected.
    """
    source = Path(path).resolve()
    fields = crate.Robot(source).arrays()
    fields |= {"jets": Jets(**fields["jets"]), "aero_links": AeroLinks(**fields["aero_links"])}
    return RobotModel(source=str(source), **fields)
