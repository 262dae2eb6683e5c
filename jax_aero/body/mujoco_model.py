"""The interface to MuJoCo: its model of our robot, conversion of conventions, smooth dynamics in JAX.

MuJoCo's free joint has a world-frame linear but a body-frame angular velocity, and its bodies are in depth-first order;
here velocities are mixed (both parts in inertial axes) and joints have the order of the robot's TOML file. Only MJX's
kinematics, composite inertias and Newton–Euler algorithm are used: without contacts, constraints and integrator,
reverse mode needs no flags.

It is here since `dynamics` offers it as a backend.
"""

from __future__ import annotations

import contextlib
import functools
import io
import tomllib
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco  # type: ignore[import-untyped]
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jax_aero.base import crate
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import multiply, rotate_back, skew, wxyz_from_rotation
from jax_aero.types import Array, State

with contextlib.redirect_stdout(io.StringIO()):  # MJX prints that an unused GPU backend is not installed
    from mujoco import mjx as mjx


class Order(NamedTuple):
    """MuJoCo's indices of quantities that we order by the robot's TOML file."""

    bodies: NDArray[np.int64]
    """MuJoCo body of each of our bodies (its body 0 is the world)."""
    dofs: NDArray[np.int64]
    """MuJoCo degree of freedom of each of our velocities."""
    joints: NDArray[np.int64]
    """Index in `qpos` of each joint position."""


def mujoco_spec(source: str) -> Any:
    """Return MuJoCo's description of the robot: its bodies with free joint, joint motors, and sites at jets and links.

    It has no geometry, as nothing of it collides, and the inertias of the crate, since MuJoCo judges every link alone.
    """
    robot = crate.Robot(source)
    table, numbers = tomllib.loads(robot.toml_text), robot.arrays()
    spec = mujoco.MjSpec.from_string(robot.urdf_text)
    for element in (*spec.geoms, *spec.meshes, *spec.equalities):
        spec.delete(element)
    spec.option.gravity = [0.0, 0.0, -robot.gravity]
    # With joint limits or friction, MJX would run a constraint solver throughout the flight.
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for body in spec.bodies:
        body.mass, body.inertia, body.fullinertia = 0.0, np.zeros(3), np.full(6, np.nan)
    inertials = zip(numbers["masses"], numbers["coms"], numbers["inertias"], strict=True)
    for name, inertial in zip(robot.body_names, inertials, strict=True):
        body = spec.body(name)
        body.explicitinertial, body.iquat = True, [1.0, 0.0, 0.0, 0.0]
        body.mass, body.ipos, tensor = inertial
        body.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for joint in spec.joints:  # torques have the bounds of the crate, where the URDF's -1 means none
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    spec.body(robot.body_names[0]).add_freejoint()
    for name, position in robot.held_joints.items():
        joint = next(joint for joint in spec.joints if joint.name == name)
        body, axis = joint.parent, joint.axis / np.linalg.norm(joint.axis)
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            shift = np.zeros(3)
            mujoco.mju_rotVecQuat(shift, position * axis, body.quat)
            body.pos = body.pos + shift
        else:
            turn, carrier = np.zeros(4), np.zeros(4)
            mujoco.mju_axisAngle2Quat(turn, axis, position)
            mujoco.mju_mulQuat(carrier, body.quat, turn)
            body.quat = carrier
        spec.delete(joint)
    for jet in table.get("jets", []):
        spec.body(jet["frame"]).add_site(name=f"jet_{jet['name']}", pos=jet.get("position", [0.0, 0.0, 0.0]))
    for link in table.get("aero_links", []):
        spec.body(link["frame"]).add_site(name=f"aero_{link['name']}", pos=link["centre"])
    for name in robot.joint_names:
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    return spec


def mujoco_model(source: str) -> Any:
    """Return the compiled `mujoco.MjModel` of the robot whose TOML file is `source`."""
    return _compiled(source, _contents(source))


def _contents(source: str) -> tuple[str, str]:
    """Return the present texts of a robot's files, which what is kept of the robot follows."""
    robot = crate.Robot(source)
    return robot.toml_text, robot.urdf_text


@functools.lru_cache
def _compiled(source: str, _: tuple[str, str]) -> Any:
    return mujoco_spec(source).compile()


def order_of(source: str, joint_names: tuple[str, ...]) -> Order:
    """Return the indices of our bodies, velocities and joint positions in MuJoCo's arrays."""
    model = mujoco_model(source)
    joints = np.array([model.joint(name).id for name in joint_names], dtype=np.int64)
    base = int(np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])
    return Order(
        bodies=np.concatenate([[model.jnt_bodyid[base]], model.jnt_bodyid[joints]]).astype(np.int64),
        dofs=np.concatenate([np.arange(6) + model.jnt_dofadr[base], model.jnt_dofadr[joints]]).astype(np.int64),
        joints=model.jnt_qposadr[joints].astype(np.int64),
    )


def to_mujoco(robot: RobotModel, state: State) -> tuple[Float[Array, " q"], Float[Array, " N"]]:
    """Return `qpos` and `qvel` of a state."""
    order = order_of(robot.source, robot.joint_names)
    dtype = state.velocity.dtype
    n = 7 + robot.n_joints
    qpos = jnp.zeros(n, dtype).at[:3].set(state.base_position).at[3:7].set(wxyz_from_rotation(state.base_rotation))
    qpos = qpos.at[order.joints].set(state.joint_position)
    angular_b = rotate_back(state.base_rotation, state.velocity[3:6])
    ours = jnp.concatenate([state.velocity[:3], angular_b, state.velocity[6:]])
    return qpos, jnp.zeros(n - 1, dtype).at[order.dofs].set(ours)


def mass_matrix_and_bias(robot: RobotModel, state: State) -> tuple[Float[Array, "N N"], Float[Array, " N"]]:
    """Return `M` and `h` in our order and mixed velocities, from MJX.

    With `ν_mj = T ν`, `T = blkdiag(1, Rᵀ, 1)`: `M = Tᵀ M_mj T` and `h = Tᵀ h_mj`, since `Ṫ ν = −Rᵀ (ω × ω) = 0`.
    """
    order = order_of(robot.source, robot.joint_names)
    model = _mjx_model(robot, state.velocity.dtype)
    data = _smooth_dynamics(robot, model, *to_mujoco(robot, state))
    m = mjx.full_m(model, data)[order.dofs[:, None], order.dofs]
    r = state.base_rotation
    rows = jnp.concatenate([m[:3], r @ m[3:6], m[6:]])
    mass_matrix = jnp.concatenate([rows[:, :3], rows[:, 3:6] @ r.T, rows[:, 6:]], axis=1)
    bias = data.qfrc_bias[order.dofs]
    return mass_matrix, jnp.concatenate([bias[:3], r @ bias[3:6], bias[6:]])


def _smooth_dynamics(robot: RobotModel, model: Any, qpos: Array, qvel: Array) -> Any:
    """Return MJX data with the mass matrix and bias of a state."""
    with jax.ensure_compile_time_eval():
        data = mjx.make_data(mujoco_model(robot.source))
    data = mjx.com_pos(model, mjx.kinematics(model, data.replace(qpos=qpos, qvel=qvel)))
    data = data.tree_replace({"_impl.cinert": _inertias_about_com(robot, data)})
    return mjx.rne(model, mjx.com_vel(model, mjx.crb(model, data)))


def _inertias_about_com(robot: RobotModel, data: Any) -> Array:
    """Return the inertia of every body about the total centre of mass, in MJX's ten numbers.

    MJX starts from principal moments; using the robot's full tensors avoids an eigendecomposition, which has no
    gradient if two moments are equal.
    """
    bodies = order_of(robot.source, robot.joint_names).bodies
    rotations = data.xmat[bodies]
    offsets = data.xipos[bodies] - data.subtree_com[bodies[0]]
    mass = jnp.asarray(robot.masses, offsets.dtype)[:, None]
    tensor = multiply(multiply(rotations, robot.inertias), jnp.swapaxes(rotations, -1, -2))
    tensor = tensor - mass[..., None] * multiply(skew(offsets), skew(offsets))
    triangle = tensor[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return jnp.zeros_like(data._impl.cinert).at[bodies].set(jnp.concatenate([triangle, offsets * mass, mass], axis=1))


def _mjx_model(robot: RobotModel, dtype: Any) -> Any:
    """Return MJX's model with the numbers of `robot`, which may be traced; only the structure is from the file."""
    bodies = order_of(robot.source, robot.joint_names).bodies
    with jax.ensure_compile_time_eval():
        model = _structure(robot.source, jnp.dtype(dtype).name)
    down = jnp.array([0.0, 0.0, -1.0], dtype)
    joints = np.array([mujoco_model(robot.source).joint(name).id for name in robot.joint_names], dtype=np.int64)
    return model.tree_replace(
        {
            "opt.gravity": robot.gravity * down,
            "body_mass": model.body_mass.at[bodies].set(robot.masses),
            "body_ipos": model.body_ipos.at[bodies].set(robot.coms),
            "body_pos": model.body_pos.at[bodies[1:]].set(robot.joint_positions),
            "body_quat": model.body_quat.at[bodies[1:]].set(wxyz_from_rotation(jnp.asarray(robot.joint_rotations))),
            "jnt_axis": model.jnt_axis.at[joints].set(robot.joint_axes),
        }
    )


def _structure(source: str, dtype: str) -> Any:
    return _on_device(source, _contents(source), dtype)


@functools.lru_cache
def _on_device(source: str, _: tuple[str, str], dtype: str) -> Any:
    model = mjx.put_model(mujoco_model(source))
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, model)
