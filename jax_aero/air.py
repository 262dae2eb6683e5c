"""Aerodynamic forces on links for other simulators: MuJoCo and MJX here, MuJoCo Warp and Newton in `air_warp`.

Examples
--------
>>> import mujoco
>>> from jax_aero import air
>>> arm = '''<mujoco><worldbody><body name="arm"><joint axis="0 1 0"/>
...     <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03"/></body></worldbody></mujoco>'''
>>> model = mujoco.MjModel.from_xml_string(arm)
>>> wind = air.from_links(model, [air.Link("arm", diameter=0.06, length=0.5, centre=(0.0, 0.0, -0.25))])
>>> mujoco.set_mjcb_control(wind.callback([8.0, 0.0, 0.0]))
>>> data = mujoco.MjData(model)
>>> mujoco.mj_step(model, data)
>>> bool(data.xfrc_applied[1, 0] > 0.0)
True
>>> mujoco.set_mjcb_control(None)

Links come from one of our robot files (`from_robot`; `mujoco_model` makes its bodies) or are declared (`from_links`);
models are those of `configs/aero`. The forces are those of `jax_aero.aero.link_forces` with physically correct points:
each acts at its link's aerodynamic centre and depends on the wind relative to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jax_aero import config, rust
from jax_aero.aero import AeroModel, LinkConventions, aero_model, link_forces
from jax_aero.aero.axisymmetric import Axisymmetric
from jax_aero.base import places, typed_config
from jax_aero.body.mujoco_model import mjx as mjx
from jax_aero.body.mujoco_model import mujoco_spec
from jax_aero.body.robot import AeroLinks, RobotModel, load_robot
from jax_aero.body.spatial import cross
from jax_aero.types import Array, Kinematics, leaf, pytree, static

__all__ = [
    "AIR_DENSITY",
    "Air",
    "Link",
    "LinkLoads",
    "Wind",
    "default_model",
    "from_links",
    "from_robot",
    "mujoco_model",
    "settings",
]

Wind = ArrayLike | Callable[[float], ArrayLike]
"""Velocity of the air (3,) [m/s, world axes], or a function of time [s] that returns it."""

AIR_DENSITY = 1.225
"""Air density for links that are declared with coefficients [kg/m³]."""


@dataclass(frozen=True)
class Link:
    """A link of the aerodynamic models, in the frame of the MuJoCo body that carries it."""

    body: str
    diameter: float
    """Diameter [m]."""
    length: float | None = None
    """Length of a cylinder along its axis [m]; `None` for a sphere."""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction of the axis of symmetry."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point at which the force acts [m]."""
    coefficients: tuple[float, ...] | None = None
    """Force areas w0 to w5 [m²] of the axisymmetric model; given for all links or for none."""


@pytree
class _Limbs:
    """Substitute for a robot when links are declared: all that a model of single links needs."""

    name: str = static()
    aero_links: AeroLinks


class LinkLoads(NamedTuple):
    """Forces on the links and their points, world axes."""

    forces: Float[Array, "L 3"]
    """Forces [N]."""
    points: Float[Array, "L 3"]
    """Points at which they act [m]."""


@pytree
class Air:
    """The air around the links of one model of another simulator. Every number is a leaf."""

    aero: AeroModel
    robot: RobotModel
    names: tuple[str, ...] = static()
    """Names of the model's bodies that carry links, in the order of the bodies of `robot`."""
    bodies: tuple[int, ...] = static()
    """Indices of these bodies."""
    roots: tuple[int, ...] = static()
    """Root body of the tree of each of these bodies; empty for a model of Newton."""
    joints: tuple[int, ...] = static()
    """Index in `qpos` of each joint of the robot; empty if links are declared."""

    def loads(self, data: Any, wind: Float[Array, "3"]) -> LinkLoads:
        """Return the forces on the links, from MuJoCo or MJX data with current positions and velocities.

        `cvel` holds the angular velocity, and the linear velocity of the body's point at the centre of mass of its
        whole tree; velocities here are those of the bodies' origins.

        Raises
        ------
        ValueError
            If `wind` does not have three components.
        """
        wind = jnp.asarray(wind)
        if wind.shape != (3,):
            raise ValueError(f"`wind` has shape {wind.shape}; expected (3,), the velocity of the air in world axes")
        bodies, roots = np.array(self.bodies, dtype=int), np.array(self.roots, dtype=int)
        positions, velocities = jnp.asarray(data.xpos)[bodies], jnp.asarray(data.cvel)[bodies]
        angular = velocities[:, :3]
        linear = velocities[:, 3:] + cross(angular, positions - jnp.asarray(data.subtree_com)[roots])
        nothing = jnp.zeros((len(self.joints), 3), positions.dtype)
        kin = Kinematics(
            body_rotations=jnp.asarray(data.xmat)[bodies].reshape(-1, 3, 3),
            body_positions=positions,
            joint_linear=nothing,
            joint_angular=nothing,
            com=positions[0],
            angular_velocities=angular,
            linear_velocities=linear,
            joint_position=jnp.asarray(data.qpos)[np.array(self.joints, dtype=int)],
        )
        links = link_forces(self.aero, self.robot, kin, LinkConventions(), wind)
        return LinkLoads(links.forces, links.arm_points)

    def xfrc(self, data: Any, wind: Float[Array, "3"]) -> Float[Array, "nbody 6"]:
        """Return force and torque on every body about its centre of mass [N, N m], as in `xfrc_applied`. Pure."""
        loads = self.loads(data, wind)
        carriers = np.array(self.bodies, dtype=int)[np.array(self.robot.aero_links.bodies, dtype=int)]
        centres = jnp.asarray(data.xipos)
        wrenches = jnp.concatenate([loads.forces, cross(loads.points - centres[carriers], loads.forces)], axis=1)
        return jnp.zeros((len(centres), 6), wrenches.dtype).at[carriers].add(wrenches)

    def blow(self, model: Any, data: Any, wind: Float[Array, "3"]) -> Any:
        """Return MJX data with `xfrc_applied` set for this state and wind; call it before `mjx.step`. Pure."""
        placed = mjx.com_vel(model, mjx.com_pos(model, mjx.kinematics(model, data)))
        return data.replace(xfrc_applied=self.xfrc(placed, wind))

    def callback(self, wind: Wind) -> Callable[[Any, Any], None]:
        """Return a function for `mujoco.set_mjcb_control` that sets `xfrc_applied` at every evaluation of forces.

        It overwrites the entries of bodies that carry links and leaves the other bodies unchanged.
        """
        with jax.enable_x64(True):
            air = jax.tree.map(jnp.asarray, self)
        rows = sorted({self.bodies[body] for body in self.robot.aero_links.bodies})

        def apply(model: Any, data: Any) -> None:  # noqa: ARG001 - the signature is MuJoCo's
            now = wind(data.time) if callable(wind) else wind
            with jax.enable_x64(True):
                state = _MujocoState(*(np.array(getattr(data, name)) for name in _MujocoState._fields))
                data.xfrc_applied[rows] = np.asarray(_xfrc(air, state, jnp.asarray(now, jnp.float64)))[rows]

        return apply


class _MujocoState(NamedTuple):
    """Fields of MuJoCo's data that the forces depend on."""

    xpos: Any
    xmat: Any
    xipos: Any
    cvel: Any
    subtree_com: Any
    qpos: Any


@jax.jit
def _xfrc(air: Air, data: _MujocoState, wind: Array) -> Array:
    return air.xfrc(data, wind)


def settings(name: str) -> config.AeroConfig:
    """Return the configuration of an aerodynamic model, given its name in `configs/aero` or the path of a file."""
    return typed_config.aero_config(rust.load_aero(name))


def default_model(robot: RobotModel) -> str:
    """Return the name of a robot's model: axisymmetric if it has the coefficients, otherwise by Reynolds number."""
    return "axisymmetric_corrected" if "corrected" in robot.aero_links.coefficients else "sphere_cylinder"


def mujoco_model(robot: str = "ironcub_mk1") -> Any:
    """Return a new `mujoco.MjModel` of one of our robots: free base, motors at the joints, without meshes and contacts.

    Parameters
    ----------
    robot
        Name in `configs/robot`, or the path of a robot's TOML file.
    """
    return mujoco_spec(str(places.find("robot", robot))).compile()


def from_robot(model: Any, robot: str = "ironcub_mk1", aero: str | AeroModel | None = None, prefix: str = "") -> Air:
    """Return the air around one of our robots in a model whose bodies and joints have the names of its URDF.

    Parameters
    ----------
    model
        A `mujoco.MjModel`, such as that of `mujoco_model`, or a `newton.Model`.
    robot
        Name in `configs/robot`, or the path of a robot's TOML file.
    aero
        Name in `configs/aero`, path of a file, or a user-defined model; by default `default_model`.
    prefix
        Prefix of every name in `model`, for scenes with several robots.

    Raises
    ------
    ValueError
        If `model` lacks a body or joint of the robot; the message names it.
    """
    ours = load_robot(places.find("robot", robot))
    aero = default_model(ours) if aero is None else aero
    chosen = aero_model(settings(aero), ours) if isinstance(aero, str) else aero
    try:
        air = _air(model, chosen, ours, [prefix + name for name in ours.body_names])
        joints = [_index(model, "joint", prefix + name) for name in ours.joint_names]
    except ValueError as reason:
        hint = f"MuJoCo fixes the base of a URDF to its world; air.mujoco_model({robot!r}) makes a model that has all"
        raise ValueError(f"{reason}; {hint}") from None
    starts = model.joint_q_start.numpy() if _is_newton(model) else model.jnt_qposadr
    return replace(air, joints=tuple(int(starts[joint]) for joint in joints))


def from_links(model: Any, links: Sequence[Link], aero: str = "sphere_cylinder") -> Air:
    """Return the air around declared links of a `mujoco.MjModel` or a `newton.Model`.

    `aero` is a sphere and cylinder model of `configs/aero`; links with coefficients use the axisymmetric model.

    Raises
    ------
    ValueError
        If a link is invalid; the message names the link and the reason.
    """
    if not links:
        raise ValueError("there is no link; expected one or more")
    bodies = list(dict.fromkeys(link.body for link in links))
    for link in links:
        if not (link.diameter > 0.0 and (link.length is None or link.length > 0.0)):
            size = f"diameter {link.diameter} and length {link.length}"
            raise ValueError(f"link of `{link.body}` has {size}; expected positive numbers")
        if np.linalg.norm(link.axis) == 0.0:
            raise ValueError(f"axis of the link of `{link.body}` is zero; expected a direction")
    given = [link.coefficients for link in links if link.coefficients is not None]
    if given and (len(given) < len(links) or any(len(row) != 6 for row in given)):
        raise ValueError("some links have coefficients; expected six for every link, or none at all")
    axes = np.array([link.axis for link in links], dtype=np.float64)
    aero_links = AeroLinks(
        names=tuple(link.body for link in links),
        bodies=tuple(bodies.index(link.body) for link in links),
        is_sphere=tuple(link.length is None for link in links),
        rotations=leaf(np.tile(np.eye(3), (len(links), 1, 1))),
        positions=leaf(np.zeros((len(links), 3))),
        axes=leaf(axes / np.linalg.norm(axes, axis=1, keepdims=True)),
        centres=leaf([link.centre for link in links]),
        diameters=leaf([link.diameter for link in links]),
        lengths=leaf([link.diameter if link.length is None else link.length for link in links]),
        coefficients={},
    )
    limbs = cast(RobotModel, _Limbs("declared links", aero_links))
    chosen: AeroModel
    if given:
        chosen = Axisymmetric(k_a=leaf(0.5 * AIR_DENSITY), areas=leaf(given))
    else:
        shapes = settings(aero)
        if not isinstance(shapes, config.SphereCylinderAeroConfig):
            raise ValueError(f"`aero` is `{aero}`; expected a sphere and cylinder model, or links with coefficients")
        with jax.enable_x64(True):
            chosen = aero_model(shapes, limbs)
    return _air(model, chosen, limbs, bodies)


def _air(model: Any, aero: AeroModel, robot: RobotModel, names: Sequence[str]) -> Air:
    bodies = tuple(_index(model, "body", name) for name in names)
    roots = () if _is_newton(model) else tuple(int(model.body_rootid[body]) for body in bodies)
    return Air(aero, robot, tuple(names), bodies, roots, ())


def _index(model: Any, kind: Literal["body", "joint"], name: str) -> int:
    names = names_in(model, kind)
    if name not in names:
        raise ValueError(f"the model has no {kind} `{name}`{places.did_you_mean(name, names)}")
    return names.index(name)


def names_in(model: Any, kind: Literal["body", "joint"]) -> list[str]:
    """Return the names of the bodies or joints of a model; Newton's are paths, of which the last part is taken."""
    if _is_newton(model):
        return [label.rpartition("/")[2] for label in getattr(model, f"{kind}_label")]
    count, of = (model.nbody, model.body) if kind == "body" else (model.njnt, model.joint)
    return [of(index).name for index in range(count)]


def _is_newton(model: Any) -> bool:
    return hasattr(model, "body_label")
