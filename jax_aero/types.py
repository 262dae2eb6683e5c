"""Structures passed between modules, each for one sample; `vmap` adds the batch axis in front.

SI units and radians; vectors and Jacobians are in inertial axes unless a suffix says otherwise. The axes named in
shapes are listed in `docs/reference.md`.

Equation M7 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar, cast, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Shaped

from jax_aero.base.places import did_you_mean

if TYPE_CHECKING:
    Array: TypeAlias = jax.Array
else:
    Array = jax.Array | np.ndarray | np.generic
"""An array; outside traced functions it may be a NumPy array, which keeps its 64 bits."""

T = TypeVar("T")
Tree = TypeVar("Tree")

COMPUTED_FROM = ("time_step",)
"""Fields, anywhere in a tree, from which others were computed; a class adds its own in `computed_from`."""


def static(*, default: Any = MISSING) -> Any:
    """Return a field of a `pytree` that is structure, not a leaf: a name, switch or length, fixed at compilation."""
    return field(default=default, metadata={"static": True})


@dataclass_transform(frozen_default=True, field_specifiers=(static,))
def pytree(cls: type[T]) -> type[T]:
    """Make a frozen dataclass whose fields are leaves or subtrees, except those that are `static()`."""
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(cls))


def leaf(value: Any) -> Shaped[Array, "..."]:
    """Return a number, or a list of them, as a leaf in double precision and without weak type."""
    return value if isinstance(value, jax.Array) else cast(Array, np.asarray(value, dtype=np.float64))


def leaves(cls: type[T], settings: Any) -> T:
    """Return a pytree of leaves only, with the values of the same names in a table of a configuration."""
    return cls(**{item.name: leaf(getattr(settings, item.name)) for item in fields(cast(Any, cls))})


class State(NamedTuple):
    """Pose and velocity of the robot.

    Velocities are *mixed*: `ν = (v_B, ω_B, ṡ)` with the velocity of the base origin and the angular velocity of the
    base, both in inertial axes.
    """

    base_position: Float[Array, "3"]
    """Position of the base origin [m]."""
    base_rotation: Float[Array, "3 3"]
    """Rotation `inertial_from_base`."""
    joint_position: Float[Array, " n"]
    """Joint positions [rad]."""
    velocity: Float[Array, " N"]
    """Mixed velocity `ν` [m/s, rad/s, rad/s]."""


class Kinematics(NamedTuple):
    """Poses and velocities of all bodies. Body 0 is the base; joint `i` moves body `i + 1`."""

    body_rotations: Float[Array, "nb 3 3"]
    """`inertial_from_body`."""
    body_positions: Float[Array, "nb 3"]
    """Origins of the bodies [m]."""
    joint_linear: Float[Array, "n 3"]
    """Velocity of the child's origin per unit rate of a joint: the axis of a prismatic joint, otherwise zero."""
    joint_angular: Float[Array, "n 3"]
    """Angular velocity of the child per unit rate of a joint: the axis of a revolute joint, otherwise zero."""
    com: Float[Array, "3"]
    """Centre of mass [m]."""
    angular_velocities: Float[Array, "nb 3"]
    """Angular velocities of the bodies [rad/s]."""
    linear_velocities: Float[Array, "nb 3"]
    """Velocities of the bodies' origins [m/s]."""
    joint_position: Float[Array, " n"]
    """Joint positions of these kinematics [rad]."""


class Dynamics(NamedTuple):
    """Rigid-body dynamics `M ν̇ + h = Σ generalised forces` and centroidal momentum `(l, k) = A_G ν`."""

    mass_matrix: Float[Array, "N N"]
    """`M`."""
    bias: Float[Array, " N"]
    """`h`: Coriolis, centrifugal and gravity forces."""
    momentum_matrix: Float[Array, "6 N"]
    """`A_G`, linear rows first."""
    momentum: Float[Array, "6"]
    """`A_G ν` [kg m/s, kg m²/s]."""
    centroidal_inertia: Float[Array, "3 3"]
    """Rotational inertia about the centre of mass [kg m²]."""


class InverseMass(NamedTuple):
    """Inverse of a mass matrix with the base eliminated first."""

    base: Float[Array, "6 6"]
    """`M_b⁻¹`, of the robot with rigid joints."""
    coupling: Float[Array, "6 n"]
    """`M_b⁻¹ M_bs`: velocity of the base per joint velocity without momentum, with the opposite sign."""
    joint_inertia: Float[Array, "n n"]
    """`M_s − M_sb M_b⁻¹ M_bs`: inertia of the joints on a base that floats freely."""
    joint_gain: Float[Array, "n n"]
    """`G = (M⁻¹)_ss`, its inverse: joint acceleration per unit of torque [1/(kg m²)]."""


class LinkForces(NamedTuple):
    """Aerodynamic quantities of every link."""

    axes: Float[Array, "L 3"]
    """Unit axes of symmetry."""
    v_air: Float[Array, "L 3"]
    """Velocity of the air relative to each link [m/s]; a network uses that relative to the base origin instead."""
    arm_points: Float[Array, "L 3"]
    """Points about whose position moments are formed [m]."""
    jacobian_points: Float[Array, "L 3"]
    """Points whose Jacobians carry the forces [m]."""
    forces: Float[Array, "L 3"]
    """Forces on the links [N]."""


class Setpoint(NamedTuple):
    """Set-point of the controller at one tick. Angular quantities are in axes of the desired base."""

    com_position: Float[Array, "3"]
    """Position of the centre of mass [m]."""
    com_velocity: Float[Array, "3"]
    """Velocity of the centre of mass [m/s]."""
    com_acceleration: Float[Array, "3"]
    """Acceleration of the centre of mass [m/s²]."""
    com_jerk: Float[Array, "3"]
    """Jerk of the centre of mass [m/s³]."""
    rotation: Float[Array, "3 3"]
    """Desired `inertial_from_base`."""
    angular_velocity: Float[Array, "3"]
    """Angular velocity [rad/s]."""
    angular_acceleration: Float[Array, "3"]
    """Angular acceleration [rad/s²]."""
    angular_jerk: Float[Array, "3"]
    """Angular jerk [rad/s³]."""


def where(condition: Bool[Array, ""] | bool, yes: Tree, no: Tree) -> Tree:
    """Return `yes` if the condition holds and `no` otherwise, for every leaf."""
    chosen: Tree = jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
    return chosen


def join(*parts: Float[Array, " _"]) -> Float[Array, " _"]:
    """Return the concatenated vectors.

    Empty ones are left out, since jaxlib 0.10 miscompiles a slice of an empty last one, or crashes.
    """
    return jnp.concatenate([part for part in parts if part.size])


def replace_values(tree: Tree, values: Mapping[str, Any]) -> Tree:
    """Return a scenario, or a part of it, with other numbers at dotted names such as `controller.momentum.c0`.

    A number keeps its shape, so nothing is compiled again.

    Raises
    ------
    ValueError
        If a name does not exist or is not that of a leaf; if the value is not a number or array; if shape or type are
        wrong; or if other leaves were computed from it, since those would not change. The message names it.
    """
    for name, value in values.items():
        tree = _replace_value(tree, name.split("."), name, value)
    return tree


def value_names(tree: Any) -> list[str]:
    """Return the names of a scenario, or of a part of it, whose numbers `replace_values` replaces."""
    accepted = []
    for path, value in jax.tree_util.tree_leaves_with_path(tree):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        with suppress(ValueError):
            replace_values(tree, {name: value})
            accepted.append(name)
    return accepted


def _replace_value(node: Any, path: list[str], name: str, value: Any) -> Any:
    first, *rest = path
    known = {item.name for item in fields(node)} if is_dataclass(node) else set(getattr(node, "_fields", ()))
    if first not in known:
        raise ValueError(f"`{first}` in `{name}` is unknown{did_you_mean(first, sorted(known))}")
    if first in (*COMPUTED_FROM, *getattr(node, "computed_from", ())):
        raise ValueError(f"`{name}` is what others were computed from; expected `prepare` with another configuration")
    if is_dataclass(node) and any(item.name == first and item.metadata.get("static") for item in fields(node)):
        raise ValueError(f"`{name}` is fixed at compilation; expected `prepare` with another configuration")
    before = getattr(node, first)
    after = _replace_value(before, rest, name, value) if rest else _convert_like(before, name, value)
    return cast(Any, replace if is_dataclass(node) else type(node)._replace)(node, **{first: after})


def _convert_like(before: Any, name: str, value: Any) -> Array:
    """Return a value as a leaf with the shape and type of another."""
    if not isinstance(before, Array | int | float):
        raise ValueError(f"`{name}` is {type(before).__name__}; expected the name of a number or an array")
    try:
        new = jnp.asarray(value)
    except (TypeError, ValueError):
        raise ValueError(f"`{name}` is {value!r}; expected a number or an array") from None
    if new.shape != jnp.shape(before):
        raise ValueError(f"`{name}` has shape {new.shape}; expected {jnp.shape(before)}")
    wanted = jnp.result_type(before)
    if jnp.issubdtype(new.dtype, jnp.inexact) and not jnp.issubdtype(wanted, jnp.inexact):
        raise ValueError(f"`{name}` is {value!r}; expected values of type {wanted}")
    return new.astype(wanted)


def with_dtype(tree: Tree, dtype: Any) -> Tree:
    """Return the tree with every floating-point leaf in a precision."""

    def convert(leaf: Any) -> Any:
        array = np.asarray(leaf) if isinstance(leaf, float) else leaf
        return jnp.asarray(array, dtype) if jnp.issubdtype(array.dtype, np.floating) else leaf

    converted: Tree = jax.tree.map(convert, tree)
    return converted
