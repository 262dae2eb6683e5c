"""The robot: a tree of rigid bodies with named frames, read once from TOML and URDF.

Everything that is a number is a leaf of the pytree, so masses, coefficients or limits can be batched and
differentiated; everything that gives the computation its shape (names, parents, which body carries a frame) is static.
"""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np

from jax_aero.types import Array, Static, pytree
from jax_aero.urdf import BodyTree, read_tree

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
    rotations: Array
    """(j, 3, 3) `body_from_frame`."""
    positions: Array
    """(j, 3) origins in body axes [m]."""
    axes: Array
    """(j, 3) direction of the force on the robot, in frame axes."""
    thrust_max: Array
    """(j,) [N]."""

    @property
    def count(self) -> int:
        """Number of jets."""
        return len(self.names)


@pytree
class AeroLinks:
    """Links on which aerodynamic force acts, in the order of every aerodynamic table."""

    names: Static[tuple[str, ...]]
    bodies: Static[tuple[int, ...]]
    """Body that carries each link."""
    is_sphere: Static[tuple[bool, ...]]
    rotations: Array
    """(L, 3, 3) `body_from_link`."""
    positions: Array
    """(L, 3) origins in body axes [m]."""
    axes: Array
    """(L, 3) unit axes of symmetry in link axes."""
    centres: Array
    """(L, 3) where the force acts, in link axes [m]."""
    diameters: Array
    """(L,) [m]."""
    lengths: Array
    """(L,) along the axis [m]."""
    coefficients: dict[str, Array]
    """By set: (L, 6) force areas `w0 .. w4` of the drag and `w5` of the normal force [m²]."""

    @property
    def count(self) -> int:
        """Number of links."""
        return len(self.names)


@pytree
class RobotModel:
    """A robot. Body 0 is the floating base; joint `i` moves body `i + 1`; ancestors come first."""

    name: Static[str]
    parent: Static[tuple[int, ...]]
    """(nb,) parent of each body; −1 for the base."""
    body_names: Static[tuple[str, ...]]
    joint_names: Static[tuple[str, ...]]
    joint_groups: Static[tuple[tuple[str, tuple[int, ...]], ...]]
    """Groups of joints as (name, indices); together they hold every joint once, in order."""
    source: Static[str]
    """Path of the TOML file, from which the MuJoCo model is built too."""
    masses: Array
    """(nb,) [kg]."""
    coms: Array
    """(nb, 3) centres of mass in body axes [m]."""
    inertias: Array
    """(nb, 3, 3) about the centre of mass, body axes [kg m²]."""
    joint_rotations: Array
    """(n, 3, 3) `parent_from_child` at joint position zero."""
    joint_positions: Array
    """(n, 3) origins of the child bodies in parent axes [m]."""
    joint_axes: Array
    """(n, 3) unit axes in child axes."""
    joint_limits: Array
    """(n, 2) limits the controller respects, lower and upper [rad]."""
    gravity: Array
    """() [m/s²], positive; pulls along −z."""
    jets: Jets
    aero_links: AeroLinks
    engines: dict[str, Array]
    """By name: (12,) coefficients in the order of `ENGINE_KEYS`."""

    @property
    def n_joints(self) -> int:
        """Number of joints that move."""
        return len(self.joint_names)

    @property
    def n_velocities(self) -> int:
        """Length of `ν`."""
        return 6 + len(self.joint_names)

    @property
    def mass(self) -> Array:
        """Total mass [kg]."""
        return self.masses.sum()

    @property
    def ancestors(self) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """Whether joint `j` moves body `i`: a static mask (nb, n)."""
        return ancestors_of(self.parent)

    @property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """Bodies by depth in the tree, the base's level first."""
        return levels_of(self.parent)


@functools.lru_cache
def ancestors_of(parent: tuple[int, ...]) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Whether joint `j` moves body `i`, (bodies, joints)."""
    mask = np.zeros((len(parent), len(parent) - 1), dtype=np.bool_)
    for body, carrier in enumerate(parent):
        if carrier >= 0:
            mask[body] = mask[carrier]
            mask[body, body - 1] = True
    mask.setflags(write=False)
    return mask


@functools.lru_cache
def levels_of(parent: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """Bodies by their distance from the base."""
    depth = ancestors_of(parent).sum(axis=1)
    return tuple(tuple(int(body) for body in np.flatnonzero(depth == level)) for level in range(int(depth.max()) + 1))


def load_robot(path: str | PathLike[str]) -> RobotModel:
    """Read a robot's TOML file and the URDF it names.

    The leaves are NumPy arrays in double precision: they become what the precision of the caller makes of them.

    Raises
    ------
    ValueError
        Naming the key, its value and what was expected.
    """
    toml_path = Path(path).resolve()
    table = tomllib.loads(toml_path.read_text())
    _refuse_unknown_keys(table)
    groups = [(group["name"], group["joints"]) for group in table["joint_groups"]]
    entries = [entry for _, joints in groups for entry in joints]
    order = [entry["name"] for entry in entries]
    urdf_text = toml_path.with_name(table["urdf"]).read_text()
    tree = read_tree(urdf_text, table["base_link"], order, table.get("locked", {}))
    limits = [_limits(entry, joint.limits) for entry, joint in zip(entries, tree.joints, strict=True)]
    ends = np.cumsum([len(joints) for _, joints in groups])
    starts = [0, *ends[:-1].tolist()]
    return RobotModel(
        name=table["name"],
        parent=tuple(body.parent for body in tree.bodies),
        body_names=tuple(body.name for body in tree.bodies),
        joint_names=tuple(order),
        joint_groups=tuple(
            (name, tuple(range(start, start + len(joints))))
            for (name, joints), start in zip(groups, starts, strict=True)
        ),
        source=str(toml_path),
        masses=_leaf([body.mass for body in tree.bodies]),
        coms=_leaf([body.com for body in tree.bodies]),
        inertias=_leaf([body.inertia for body in tree.bodies]),
        joint_rotations=_leaf([joint.parent_from_child.rotation for joint in tree.joints]),
        joint_positions=_leaf([joint.parent_from_child.position for joint in tree.joints]),
        joint_axes=_leaf([joint.axis for joint in tree.joints]),
        joint_limits=_leaf(limits),
        gravity=_leaf(table.get("gravity", 9.81)),
        jets=_jets(table.get("jets", []), tree, table.get("engines", {})),
        aero_links=_aero_links(table.get("aero_links", []), tree, table.get("coefficients", {})),
        engines={
            name: _leaf([engine[key] for key in ENGINE_KEYS]) for name, engine in table.get("engines", {}).items()
        },
    )


_KEYS = {
    "": {
        *("name", "urdf", "base_link", "gravity", "joint_groups", "locked", "aero_links"),
        *("coefficients", "jets", "engines", "feet"),
    },
    "joint_groups": {"name", "joints"},
    "aero_links": {"name", "frame", "family", "axis", "centre", "diameter", "length", "is_sphere"},
    "jets": {"name", "frame", "axis", "thrust_max", "engine"},
    "feet": {"name", "frame", "vertices"},
}


def _refuse_unknown_keys(table: Mapping[str, Any]) -> None:
    rows = [("", table), *((key, row) for key in _KEYS if key for row in table.get(key, []))]
    for section, row in rows:
        if unknown := set(row) - _KEYS[section]:
            raise ValueError(f"unknown keys {sorted(unknown)} in {section or 'the robot file'}")


def _leaf(value: Any) -> Array:
    return cast(Array, np.asarray(value, dtype=np.float64))


def _limits(entry: Mapping[str, Any], urdf: tuple[float, float] | None) -> tuple[float, float]:
    if "limits_deg" in entry:
        lower, upper = (float(np.deg2rad(limit)) for limit in entry["limits_deg"])
    elif urdf is not None:
        lower, upper = urdf
    else:
        raise ValueError(f"limits_deg of joint `{entry['name']}` are missing, as the joint is continuous in the URDF")
    if not lower < upper:
        raise ValueError(f"limits of joint `{entry['name']}` are {(lower, upper)}; expected lower below upper")
    return lower, upper


def _frames(entries: Sequence[Mapping[str, Any]], tree: BodyTree) -> tuple[tuple[int, ...], Array, Array]:
    """Bodies, rotations and positions of the frames of some entries."""
    for entry in entries:
        if entry["frame"] not in tree.places:
            raise ValueError(f"frame of `{entry['name']}`: unknown link `{entry['frame']}`")
    places = [tree.places[entry["frame"]] for entry in entries]
    rotations = np.reshape([pose.rotation for _, pose in places], (-1, 3, 3))
    positions = np.reshape([pose.position for _, pose in places], (-1, 3))
    return tuple(body for body, _ in places), _leaf(rotations), _leaf(positions)


def _unit(entry: Mapping[str, Any]) -> Any:
    axis = np.asarray(entry["axis"], dtype=np.float64)
    length = np.linalg.norm(axis)
    if abs(length - 1.0) > 1e-6:
        raise ValueError(f"axis of `{entry['name']}` is {entry['axis']}; expected a vector of length 1")
    return axis / length


def _jets(entries: Sequence[Mapping[str, Any]], tree: BodyTree, engines: Mapping[str, Any]) -> Jets:
    for entry in entries:
        if entry["engine"] not in engines:
            raise ValueError(f"engine of jet `{entry['name']}`: unknown name `{entry['engine']}`")
    bodies, rotations, positions = _frames(entries, tree)
    return Jets(
        names=tuple(entry["name"] for entry in entries),
        bodies=bodies,
        engines=tuple(entry["engine"] for entry in entries),
        rotations=rotations,
        positions=positions,
        axes=_leaf(np.reshape([_unit(entry) for entry in entries], (-1, 3))),
        thrust_max=_leaf([entry["thrust_max"] for entry in entries]),
    )


def _aero_links(entries: Sequence[Mapping[str, Any]], tree: BodyTree, sets: Mapping[str, Any]) -> AeroLinks:
    bodies, rotations, positions = _frames(entries, tree)
    coefficients = {}
    for name, families in sets.items():
        if missing := {entry["family"] for entry in entries} - set(families):
            raise ValueError(f"coefficient set `{name}` lacks the families {sorted(missing)}")
        rows = [families[entry["family"]] for entry in entries]
        coefficients[name] = _leaf(np.reshape([[*row["cda"], row["cna"]] for row in rows], (-1, 6)))
    return AeroLinks(
        names=tuple(entry["name"] for entry in entries),
        bodies=bodies,
        is_sphere=tuple(bool(entry.get("is_sphere", False)) for entry in entries),
        rotations=rotations,
        positions=positions,
        axes=_leaf(np.reshape([_unit(entry) for entry in entries], (-1, 3))),
        centres=_leaf(np.reshape([entry["centre"] for entry in entries], (-1, 3))),
        diameters=_leaf([entry["diameter"] for entry in entries]),
        lengths=_leaf([entry["length"] for entry in entries]),
        coefficients=coefficients,
    )
