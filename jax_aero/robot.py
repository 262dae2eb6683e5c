"""The robot: a tree of rigid bodies with named frames, read once from TOML and URDF.

Everything that is a number is a leaf of the pytree, so masses, coefficients or limits can be batched and
differentiated; everything that gives the computation its shape (names, parents, which body carries a frame) is static.
"""

from __future__ import annotations

import difflib
import functools
import tomllib
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from jax_aero.types import Array, Static, pytree
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
    """[N]."""

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
    rotations: Float[Array, "L 3 3"]
    """`body_from_link`."""
    positions: Float[Array, "L 3"]
    """Origins in body axes [m]."""
    axes: Float[Array, "L 3"]
    """Unit axes of symmetry in link axes."""
    centres: Float[Array, "L 3"]
    """Where the force acts, in link axes [m]."""
    diameters: Float[Array, " L"]
    """[m]."""
    lengths: Float[Array, " L"]
    """Along the axis [m]."""
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
    joint_is_prismatic: Static[tuple[bool, ...]]
    """Whether each joint shifts its child along the axis instead of turning it; m and N stand for rad and N m there."""
    joint_groups: Static[tuple[tuple[str, tuple[int, ...]], ...]]
    """Groups of joints as (name, indices); together they hold every joint once, in order."""
    source: Static[str]
    """Path of the TOML file, from which the MuJoCo model is built too."""
    masses: Float[Array, " nb"]
    """[kg]."""
    coms: Float[Array, "nb 3"]
    """Centres of mass in body axes [m]."""
    inertias: Float[Array, "nb 3 3"]
    """About the centre of mass, body axes [kg m²]."""
    joint_rotations: Float[Array, "n 3 3"]
    """`parent_from_child` at joint position zero."""
    joint_positions: Float[Array, "n 3"]
    """Origins of the child bodies in parent axes [m]."""
    joint_axes: Float[Array, "n 3"]
    """Unit axes in child axes."""
    joint_limits: Float[Array, "n 2"]
    """Limits the controller respects, lower and upper [rad]."""
    joint_stops: Float[Array, "n 2"]
    """Where joints meet their stops [rad]: the range of the URDF, widened to that of the controller."""
    joint_torque_max: Float[Array, " n"]
    """[N m]."""
    joint_torque_rate_max: Float[Array, " n"]
    """[N m/s]; infinite where nothing limits it."""
    joint_velocity_max: Float[Array, " n"]
    """[rad/s]."""
    forward_axis: Float[Array, "3"]
    """Forward direction in base axes, a unit vector orthogonal to z."""
    gravity: Float[Array, ""]
    """[m/s²], positive; pulls along −z."""
    jets: Jets
    aero_links: AeroLinks
    engines: dict[str, Array]
    """By name: (12,) coefficients in the order of `ENGINE_KEYS`."""

    @property
    def n_joints(self) -> int:
        """Number of joints that move."""
        return len(self.joint_names)

    @property
    def joint_turns(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """1 for a joint that turns its child and 0 for one that shifts it, (n,)."""
        return 1.0 - np.array(self.joint_is_prismatic, dtype=np.float64)

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
    try:
        return _robot(toml_path, table)
    except ValueError as reason:
        raise ValueError(f"{toml_path.name}: {reason}") from None


def _robot(toml_path: Path, table: Mapping[str, Any]) -> RobotModel:
    _check_keys(table, _FILE, "")
    groups = [(group["name"], group["joints"]) for group in table.get("joint_groups", [])]
    entries = [entry for _, joints in groups for entry in joints]
    order = [entry["name"] for entry in entries]
    urdf_text = (toml_path.parent / table["urdf"]).read_text()
    locked = {
        name: float(_numbers(f"position of locked joint `{name}`", position, ()))
        for name, position in table.get("locked", {}).items()
    }
    tree = read_tree(urdf_text, table["base_link"], order, locked)
    limits, torque_max, torque_rate_max, velocity_max = _joint_limits(entries, tree)
    ranges = [(-np.inf, np.inf) if joint.limits is None else joint.limits for joint in tree.joints]
    stops = [(min(a, c), max(b, d)) for (a, b), (c, d) in zip(limits, ranges, strict=True)]
    starts = np.cumsum([0] + [len(joints) for _, joints in groups]).tolist()
    return RobotModel(
        name=table["name"],
        parent=tuple(body.parent for body in tree.bodies),
        body_names=tuple(body.name for body in tree.bodies),
        joint_names=tuple(order),
        joint_is_prismatic=tuple(joint.is_prismatic for joint in tree.joints),
        joint_groups=tuple(
            (name, tuple(range(start, start + len(joints))))
            for (name, joints), start in zip(groups, starts, strict=False)
        ),
        source=str(toml_path),
        masses=_leaf([body.mass for body in tree.bodies]),
        coms=_leaf([body.com for body in tree.bodies]),
        inertias=_leaf([body.inertia for body in tree.bodies]),
        joint_rotations=_leaf(np.reshape([joint.parent_from_child.rotation for joint in tree.joints], (-1, 3, 3))),
        joint_positions=_leaf(np.reshape([joint.parent_from_child.position for joint in tree.joints], (-1, 3))),
        joint_axes=_leaf(np.reshape([joint.axis for joint in tree.joints], (-1, 3))),
        joint_limits=_leaf(np.reshape(limits, (-1, 2))),
        joint_stops=_leaf(np.reshape(stops, (-1, 2))),
        joint_torque_max=_leaf(torque_max),
        joint_torque_rate_max=_leaf(torque_rate_max),
        joint_velocity_max=_leaf(velocity_max),
        forward_axis=_forward_axis(table.get("forward_axis", [1.0, 0.0, 0.0])),
        gravity=_numbers("gravity", table.get("gravity", 9.81), (), positive=True),
        jets=_jets(table.get("jets", []), tree, table.get("engines", {})),
        aero_links=_aero_links(table.get("aero_links", []), tree, table.get("coefficients", {})),
        engines={
            name: _numbers(f"engines.{name}", [engine[key] for key in ENGINE_KEYS], (len(ENGINE_KEYS),))
            for name, engine in table.get("engines", {}).items()
        },
    )


def _forward_axis(value: object) -> Array:
    axis = _numbers("forward_axis", value, (3,))
    if abs(np.linalg.norm(axis) - 1.0) > 1e-6 or abs(axis[2]) > 1e-6:
        raise ValueError(f"`forward_axis` is {value!r}; expected a unit vector orthogonal to base z")
    return axis


_ENTRY = {"name": True, "frame": True}
_FILE: dict[str, Any] = {
    "name": True,
    "urdf": True,
    "base_link": True,
    "forward_axis": False,
    "gravity": False,
    "locked": False,
    "joint_groups[]": {
        "name": True,
        "joints[]": {
            "name": True,
            **dict.fromkeys(["limits_deg", "limits", "velocity_max_deg", "velocity_max"], False),
            **dict.fromkeys(["torque_max", "torque_rate_max"], False),
        },
    },
    "aero_links[]": {
        **_ENTRY,
        **dict.fromkeys(["family", "axis", "centre", "diameter", "length"], True),
        "is_sphere": False,
    },
    "coefficients": {"*": {"*": {"cda": True, "cna": True}}},
    "jets[]": {**_ENTRY, "axis": True, "thrust_max": True, "engine": True},
    "engines": {"*": dict.fromkeys(ENGINE_KEYS, True)},
    "feet[]": {**_ENTRY, "vertices": True, "centre_of_pressure_x": False, "centre_of_pressure_y": False},
}
"""Keys of a robot's file, and whether they must be there; `[]` marks lists of tables, `*` any name."""


_TEXTS = ("name", "urdf", "base_link", "frame", "family", "engine")


def _check_keys(table: Any, keys: Mapping[str, Any], where: str) -> None:
    """Refuse unknown and missing keys, naming where they stand."""
    if not isinstance(table, Mapping):
        raise ValueError(f"`{where}` is {table!r}; expected a table")
    place = f"{where}." if where else ""
    if "*" in keys:
        for name, entry in table.items():
            _check_keys(entry, keys["*"], place + name)
        return
    known = {key.removesuffix("[]"): inner for key, inner in keys.items()}
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean `{near[0]}`?" if near else f"expected one of {', '.join(known)}"
            raise ValueError(f"unknown key `{place}{key}`; {hint}")
    for key, inner in known.items():
        if key not in table:
            if inner is True or key == "joints":
                raise ValueError(f"`{place}{key}` is missing")
        elif key in _TEXTS and not isinstance(table[key], str):
            raise ValueError(f"`{place}{key}` is {table[key]!r}; expected a text")
        elif f"{key}[]" in keys:
            if not isinstance(table[key], list):
                raise ValueError(f"`{place}{key}` is {table[key]!r}; expected a list of tables")
            for number, entry in enumerate(table[key]):
                _check_keys(entry, inner, f"{place}{key}[{number}]")
        elif isinstance(inner, Mapping):
            _check_keys(table[key], inner, place + key)


def _numbers(where: str, value: Any, shape: tuple[int, ...], *, positive: bool = False) -> Array:
    """Return finite numbers of this shape."""
    kind = "positive" if positive else "finite"
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.full((), np.nan)
    if numbers.shape != shape or not np.all(np.isfinite(numbers)) or (positive and not np.all(numbers > 0.0)):
        expected = f"{shape[0]} {kind} numbers" if shape else f"a {kind} number"
        raise ValueError(f"{where} is {value!r}; expected {expected}")
    return cast(Array, numbers)


def _leaf(value: Any) -> Array:
    return cast(Array, np.asarray(value, dtype=np.float64))


def _joint_limits(entries: Sequence[Mapping[str, Any]], tree: BodyTree) -> tuple[list[Any], ...]:
    """Position limits, greatest torques, their greatest rates and greatest velocities of all joints."""
    limits = [_limits(entry, joint) for entry, joint in zip(entries, tree.joints, strict=True)]
    return (
        [(lower, upper) for lower, upper, *_ in limits],
        *([each[column] for each in limits] for column in range(2, 5)),
    )


def _limits(entry: Mapping[str, Any], joint: Joint) -> tuple[float, ...]:
    """Lower and upper position, torque, torque rate, velocity of one joint."""
    keys = ("limits", "velocity_max") if joint.is_prismatic else ("limits_deg", "velocity_max_deg")
    wrong = ("limits_deg", "velocity_max_deg") if joint.is_prismatic else ("limits", "velocity_max")
    for key in wrong:
        if key in entry:
            kind = "prismatic" if joint.is_prismatic else "revolute"
            raise ValueError(
                f"{key} of joint `{entry['name']}` is given, which is {kind}; expected {' and '.join(keys)}"
            )
    unit = 1.0 if joint.is_prismatic else np.pi / 180.0
    if keys[0] in entry:
        lower, upper = (unit * _numbers(f"{keys[0]} of joint `{entry['name']}`", entry[keys[0]], (2,))).tolist()
    elif joint.limits is not None:
        lower, upper = joint.limits
    else:
        raise ValueError(f"limits_deg of joint `{entry['name']}` are missing, as the joint is continuous in the URDF")
    if not lower < upper:
        raise ValueError(f"limits of joint `{entry['name']}` are {(lower, upper)}; expected lower below upper")

    def greatest(key: str, unit: float, urdf: float | None) -> float:
        if key in entry:
            return unit * float(_numbers(f"{key} of joint `{entry['name']}`", entry[key], (), positive=True))
        if urdf is None:
            raise ValueError(
                f"{key} of joint `{entry['name']}` is missing; expected a positive number: the URDF has none"
            )
        return urdf

    return (
        lower,
        upper,
        greatest("torque_max", 1.0, joint.torque_max),
        greatest("torque_rate_max", 1.0, np.inf),
        greatest(keys[1], unit, joint.velocity_max),
    )


def _frames(entries: Sequence[Mapping[str, Any]], tree: BodyTree) -> tuple[tuple[int, ...], Array, Array]:
    """Bodies, rotations and positions of the frames of some entries."""
    for entry in entries:
        if entry["frame"] not in tree.places:
            raise ValueError(f"frame of `{entry['name']}`: unknown link `{entry['frame']}`")
    places = [tree.places[entry["frame"]] for entry in entries]
    rotations = np.reshape([pose.rotation for _, pose in places], (-1, 3, 3))
    positions = np.reshape([pose.position for _, pose in places], (-1, 3))
    return tuple(body for body, _ in places), _leaf(rotations), _leaf(positions)


def _size(entry: Mapping[str, Any], key: str) -> Array:
    return _numbers(f"{key} of `{entry['name']}`", entry[key], (), positive=True)


def _unit(entry: Mapping[str, Any]) -> Any:
    axis = _numbers(f"axis of `{entry['name']}`", entry["axis"], (3,))
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
        thrust_max=_leaf([_size(entry, "thrust_max") for entry in entries]),
    )


def _aero_links(entries: Sequence[Mapping[str, Any]], tree: BodyTree, sets: Mapping[str, Any]) -> AeroLinks:
    bodies, rotations, positions = _frames(entries, tree)
    coefficients = {}
    for name, families in sets.items():
        if missing := {entry["family"] for entry in entries} - set(families):
            raise ValueError(f"coefficient set `{name}` lacks the families {sorted(missing)}")
        rows = [
            [
                *_numbers(f"cda of coefficients.{name}.{family}", families[family]["cda"], (5,)),
                _numbers(f"cna of coefficients.{name}.{family}", families[family]["cna"], ()),
            ]
            for family in (entry["family"] for entry in entries)
        ]
        coefficients[name] = _leaf(np.reshape(rows, (-1, 6)))
    return AeroLinks(
        names=tuple(entry["name"] for entry in entries),
        bodies=bodies,
        is_sphere=tuple(bool(entry.get("is_sphere", False)) for entry in entries),
        rotations=rotations,
        positions=positions,
        axes=_leaf(np.reshape([_unit(entry) for entry in entries], (-1, 3))),
        centres=_leaf(
            np.reshape([_numbers(f"centre of `{entry['name']}`", entry["centre"], (3,)) for entry in entries], (-1, 3))
        ),
        diameters=_leaf([_size(entry, "diameter") for entry in entries]),
        lengths=_leaf([_size(entry, "length") for entry in entries]),
        coefficients=coefficients,
    )
