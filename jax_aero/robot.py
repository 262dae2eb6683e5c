"""The robot: a tree of rigid bodies with named frames, read once from TOML and URDF.

Every number is a leaf of the pytree, so masses, coefficients or limits can be batched and differentiated. Everything
that determines the structure of the computation (names, parents, the bodies that carry frames) is static.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from jax_aero import tables
from jax_aero.config import JointEntry, RobotFile
from jax_aero.files import read_text
from jax_aero.types import Array, Static, leaf, pytree
from jax_aero.urdf import BodyTree, Joint, read_tree

ENGINE_KEYS = ("k_t", "k_tt", "k_d", "k_dd", "k_td", "b_u", "b_t", "b_d", "b_uu", "c", "throttle_min", "throttle_max")
"""Coefficients of the second-order engine model, in the order of `RobotModel.engines`."""


@pytree
class Jets:
    """Jet engines: a force along a fixed axis of a frame, at its origin."""

    names: Static[tuple[str, ...]]
    bodies: Static[tuple[int, ...]]
    """Body that carries each jet."""
    engines: Static[tuple[str, ...]]
    """Name of each jet's engine in `RobotModel.engines`."""
    rotations: Float[Array, "j 3 3"]
    """`body_from_frame`."""
    positions: Float[Array, "j 3"]
    """Origins in body axes [m]."""
    axes: Float[Array, "j 3"]
    """Direction of the force on the robot, in frame axes."""
    thrust_max: Float[Array, " j"]
    """Greatest thrusts [N]."""

    @property
    def count(self) -> int:
        """Number of jets."""
        return len(self.names)


@pytree
class AeroLinks:
    """Links with aerodynamic forces, in the order of every aerodynamic table."""

    names: Static[tuple[str, ...]]
    bodies: Static[tuple[int, ...]]
    """Body that carries each link."""
    is_sphere: Static[tuple[bool, ...]]
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

    name: Static[str]
    parent: Static[tuple[int, ...]]
    """(nb,) parent of each body; −1 for the base."""
    body_names: Static[tuple[str, ...]]
    joint_names: Static[tuple[str, ...]]
    joint_is_prismatic: Static[tuple[bool, ...]]
    """Whether each joint translates its child along the axis instead of rotating it; its units are m and N."""
    joint_groups: Static[tuple[tuple[str, tuple[int, ...]], ...]]
    """Groups of joints as (name, indices); together they contain every joint once, in order."""
    source: Static[str]
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
    """Read a robot's TOML file and the URDF named in it.

    The leaves are NumPy arrays in double precision, which JAX converts to the caller's precision.

    Raises
    ------
    ValueError
        If a value is invalid; the message names the key, its value and what was expected.
    """
    toml_path = Path(path).resolve()
    file = tables.load(toml_path, RobotFile)
    try:
        return _robot(toml_path, file)
    except ValueError as reason:
        raise ValueError(f"{toml_path.name}: {reason}") from None


def _robot(toml_path: Path, file: RobotFile) -> RobotModel:
    for item, entries in (
        ("joint group", file.joint_groups),
        ("aerodynamic link", file.aero_links),
        ("jet", file.jets),
        ("foot", file.feet),
    ):
        _unique(item, [entry.name for entry in entries])
    joints = [joint for group in file.joint_groups for joint in group.joints]
    order = [joint.name for joint in joints]
    tree = read_tree(read_text(file.urdf), file.base_link, order, file.locked)
    limits = [_limits(entry, joint) for entry, joint in zip(joints, tree.joints, strict=True)]
    lower, upper, torque_max, torque_rate_max, velocity_max = np.reshape(limits, (-1, 5)).T
    ranges = [(-np.inf, np.inf) if joint.limits is None else joint.limits for joint in tree.joints]
    stops = [(min(a, c), max(b, d)) for a, b, (c, d) in zip(lower, upper, ranges, strict=True)]
    starts = np.cumsum([0] + [len(group.joints) for group in file.joint_groups]).tolist()
    return RobotModel(
        name=file.name,
        parent=tuple(body.parent for body in tree.bodies),
        body_names=tuple(body.name for body in tree.bodies),
        joint_names=tuple(order),
        joint_is_prismatic=tuple(joint.is_prismatic for joint in tree.joints),
        joint_groups=tuple(
            (group.name, tuple(range(start, start + len(group.joints))))
            for group, start in zip(file.joint_groups, starts, strict=False)
        ),
        source=str(toml_path),
        masses=leaf([body.mass for body in tree.bodies]),
        coms=leaf([body.com for body in tree.bodies]),
        inertias=leaf([body.inertia for body in tree.bodies]),
        joint_rotations=leaf(np.reshape([joint.parent_from_child.rotation for joint in tree.joints], (-1, 3, 3))),
        joint_positions=leaf(np.reshape([joint.parent_from_child.position for joint in tree.joints], (-1, 3))),
        joint_axes=leaf(np.reshape([joint.axis for joint in tree.joints], (-1, 3))),
        joint_limits=leaf(np.stack([lower, upper], axis=1)),
        joint_stops=leaf(np.reshape(stops, (-1, 2))),
        joint_torque_max=leaf(torque_max),
        joint_torque_rate_max=leaf(torque_rate_max),
        joint_velocity_max=leaf(velocity_max),
        forward_axis=_forward_axis(file.forward_axis),
        gravity=leaf(file.gravity),
        jets=_jets(file, tree),
        aero_links=_aero_links(file, tree),
        engines={name: leaf([getattr(engine, key) for key in ENGINE_KEYS]) for name, engine in file.engines.items()},
    )


def _unique(item: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{item} `{name}` is listed more than once; expected a name that occurs once")


def _forward_axis(value: tuple[float, ...]) -> Array:
    axis = leaf(value)
    if abs(np.linalg.norm(axis) - 1.0) > 1e-6 or abs(axis[2]) > 1e-6:
        raise ValueError(f"`forward_axis` is {list(value)}; expected a unit vector orthogonal to base z")
    return axis


def _unit_vector(of: str, value: tuple[float, ...]) -> Any:
    length = np.linalg.norm(value)
    if abs(length - 1.0) > 1e-6:
        raise ValueError(f"axis of {of} is {list(value)}; expected a vector of length 1")
    return np.asarray(value) / length


def _limits(entry: JointEntry, joint: Joint) -> tuple[float, ...]:
    """Return lower and upper position, greatest torque, greatest torque rate and greatest velocity of one joint."""
    keys, others = ("limits_deg", "velocity_max_deg"), ("limits", "velocity_max")
    unit, kind = np.pi / 180.0, "revolute"
    if joint.is_prismatic:
        keys, others, unit, kind = others, keys, 1.0, "prismatic"
    for key in others:
        if getattr(entry, key) is not None:
            raise ValueError(f"{key} of joint `{entry.name}` is given, which is {kind}; expected {' and '.join(keys)}")
    given = getattr(entry, keys[0])
    limits = joint.limits if given is None else (unit * given[0], unit * given[1])
    if limits is None:
        raise ValueError(f"{keys[0]} of joint `{entry.name}` are missing, as the joint is continuous in the URDF")
    if not limits[0] < limits[1]:
        raise ValueError(f"limits of joint `{entry.name}` are {tuple(limits)}; expected lower below upper")

    def read_greatest(key: str, unit: float, urdf: float | None) -> float:
        value: float | None = getattr(entry, key)
        if value is None and urdf is None:
            raise ValueError(f"{key} of joint `{entry.name}` is missing; expected a positive number: the URDF has none")
        return unit * value if value is not None else cast(float, urdf)

    return (
        *limits,
        read_greatest("torque_max", 1.0, joint.torque_max),
        read_greatest("torque_rate_max", 1.0, np.inf),
        read_greatest(keys[1], unit, joint.velocity_max),
    )


def _frames(kind: str, entries: Sequence[Any], tree: BodyTree) -> tuple[tuple[int, ...], Array, Array]:
    """Return bodies, rotations and positions [m] of the frames of some entries."""
    for entry in entries:
        if entry.frame not in tree.places:
            raise ValueError(f"frame of {kind} `{entry.name}`: unknown link `{entry.frame}`")
    places = [tree.places[entry.frame] for entry in entries]
    rotations = np.reshape([pose.rotation for _, pose in places], (-1, 3, 3))
    positions = np.reshape([pose.position for _, pose in places], (-1, 3))
    return tuple(body for body, _ in places), leaf(rotations), leaf(positions)


def _jets(file: RobotFile, tree: BodyTree) -> Jets:
    for entry in file.jets:
        if entry.engine not in file.engines:
            raise ValueError(f"engine of jet `{entry.name}`: unknown name `{entry.engine}`")
    bodies, rotations, positions = _frames("jet", file.jets, tree)
    return Jets(
        names=tuple(entry.name for entry in file.jets),
        bodies=bodies,
        engines=tuple(entry.engine for entry in file.jets),
        rotations=rotations,
        positions=positions,
        axes=leaf(np.reshape([_unit_vector(f"jet `{entry.name}`", entry.axis) for entry in file.jets], (-1, 3))),
        thrust_max=leaf([entry.thrust_max for entry in file.jets]),
    )


def _aero_links(file: RobotFile, tree: BodyTree) -> AeroLinks:
    entries = file.aero_links
    bodies, rotations, positions = _frames("aerodynamic link", entries, tree)
    coefficients = {}
    for name, families in file.coefficients.items():
        used = {entry.family for entry in entries}
        if used != set(families):
            found, expected = ", ".join(sorted(families)), ", ".join(sorted(used))
            raise ValueError(
                f"families of coefficient set `{name}` are {found}; expected those of the links, {expected}"
            )
        rows = [(*families[entry.family].cda, families[entry.family].cna) for entry in entries]
        coefficients[name] = leaf(np.reshape(rows, (-1, 6)))
    return AeroLinks(
        names=tuple(entry.name for entry in entries),
        bodies=bodies,
        is_sphere=tuple(entry.is_sphere for entry in entries),
        rotations=rotations,
        positions=positions,
        axes=leaf(np.reshape([_unit_vector(f"link `{entry.name}`", entry.axis) for entry in entries], (-1, 3))),
        centres=leaf(np.reshape([entry.centre for entry in entries], (-1, 3))),
        diameters=leaf([entry.diameter for entry in entries]),
        lengths=leaf([entry.length for entry in entries]),
        coefficients=coefficients,
    )
