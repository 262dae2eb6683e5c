"""Poses, velocities and centre of mass of a state; the generalised force of forces at points.

Only rotations are composed along the tree. All other quantities of a body are sums over its ancestors, computed as one
product with the static matrix of ancestors: few large operations instead of a loop over bodies.

Equations M8 to M10 of `docs/model`.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.body.robot import AeroLinks, Jets, RobotModel
from jax_aero.body.spatial import axis_angle, cross, exp_so3, multiply, rotate
from jax_aero.types import Array, Kinematics, State


def kinematics(robot: RobotModel, state: State) -> Kinematics:
    """Return poses and velocities of all bodies, and the centre of mass, in inertial axes."""
    parents = np.array(robot.parent[1:], dtype=int)
    moves = jnp.asarray(robot.ancestors, state.velocity.dtype)
    turns = jnp.asarray(robot.joint_turns, state.velocity.dtype)
    shifts = (1.0 - turns) * state.joint_position
    local = multiply(robot.joint_rotations, axis_angle(jnp.asarray(robot.joint_axes), turns * state.joint_position))
    rotations = _compose_along_tree(robot, state.base_rotation, local)
    # Offset of each body from its parent, and the joint axis, which has equal components in child and joint frame.
    axes = rotate(rotations[1:], robot.joint_axes)
    arms = rotate(rotations[parents], robot.joint_positions) + shifts[:, None] * axes
    joint_linear, joint_angular = (1.0 - turns)[:, None] * axes, turns[:, None] * axes
    rates = state.velocity[6:, None]
    angular = state.velocity[None, 3:6] + moves @ (joint_angular * rates)
    positions = state.base_position[None] + moves @ arms
    linear = state.velocity[None, :3] + moves @ (cross(angular[parents], arms) + joint_linear * rates)
    offsets = rotate(rotations, robot.coms) + (positions - state.base_position[None])
    com = state.base_position + robot.masses @ offsets / robot.mass
    return Kinematics(rotations, positions, joint_linear, joint_angular, com, angular, linear, state.joint_position)


def kinematics_at_rest(robot: RobotModel, joint_position: Float[Array, " n"]) -> Kinematics:
    """Return the kinematics at rest with base axes equal to inertial axes, at joint positions [rad]."""
    zero = jnp.zeros(robot.n_velocities, joint_position.dtype)
    return kinematics(robot, State(zero[:3], jnp.eye(3, dtype=zero.dtype), joint_position, zero))


def move(state: State, velocity: Float[Array, " N"], step: Float[Array, ""]) -> State:
    """Return the state after `step` [s] at a constant velocity ν [m/s, rad/s], which it then has; M78."""
    return State(
        base_position=state.base_position + step * velocity[:3],
        base_rotation=multiply(exp_so3(step * velocity[3:6]), state.base_rotation),
        joint_position=state.joint_position + step * velocity[6:],
        velocity=velocity,
    )


def carried(robot: RobotModel, bodies: tuple[int, ...], of_points: Float[Array, "k d"]) -> Float[Array, "n d"]:
    """Return, for each joint, the sum of what is given for points on `bodies` over those that it moves.

    Not a product of matrices, since XLA's compiler for GPUs refuses its transpose.
    """
    moves = jnp.asarray(robot.ancestors[np.array(bodies, dtype=int)], of_points.dtype)
    return jnp.sum(moves[:, :, None] * of_points[:, None], axis=0)


def _compose_along_tree(robot: RobotModel, base_rotation: Array, local: Array) -> Array:
    """Return the rotations of all bodies (nb, 3, 3) from those relative to their parents, level by level.

    Bodies of one level are multiplied together; a static permutation restores the order of the bodies.
    """
    levels = robot.levels
    place_in_level = {body: place for level in levels for place, body in enumerate(level)}
    done = [base_rotation[None]]
    for level in levels[1:]:
        parents = np.array([place_in_level[robot.parent[body]] for body in level])
        done.append(multiply(done[-1][parents], local[np.array(level) - 1]))
    order = np.argsort(np.concatenate([np.array(level) for level in levels]))
    return jnp.concatenate(done)[order]


def generalised_force(
    robot: RobotModel,
    kin: Kinematics,
    bodies: tuple[int, ...],
    points: Float[Array, "k 3"],
    forces: Float[Array, "k 3"],
    couples: Float[Array, "k 3"] | float = 0.0,
) -> Float[Array, " N"]:
    """Return `Σ J_kᵀ (f_k, c_k)` of forces [N] and couples [N m] on `bodies` at `points` [m], without a Jacobian.

    A revolute joint carries the force and moment of its subtree, `τ_j = a · (Σ (p × f + c) − o_j × Σ f)`, about the
    base origin; a prismatic one `a · Σ f`.
    """
    origin = kin.body_positions[:1]
    moments = cross(points - origin, forces) + couples
    summed = carried(robot, bodies, jnp.concatenate([forces, moments], axis=1))
    about_joint = summed[:, 3:] - cross(kin.body_positions[1:] - origin, summed[:, :3])
    joints = jnp.sum(kin.joint_angular * about_joint + kin.joint_linear * summed[:, :3], axis=1)
    return jnp.concatenate([forces.sum(0), moments.sum(0), joints])


def generalised_thrust(robot: RobotModel, kin: Kinematics, thrust: Float[Array, " j"]) -> Float[Array, " N"]:
    """Return the generalised force of thrusts [N] along the jets' axes, and of their moments."""
    rotations, points = frame_poses(kin, robot.jets)
    forces = thrust[:, None] * rotate(rotations, robot.jets.axes)
    couples = robot.jets.torque_to_thrust[:, None] * forces
    return generalised_force(robot, kin, robot.jets.bodies, points, forces, couples)


def velocities_at(kin: Kinematics, bodies: tuple[int, ...], points: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
    """Return the velocities [m/s] of points [m] that move with `bodies`, inertial axes."""
    b = np.array(bodies, dtype=int)
    turning: Array = cross(kin.angular_velocities[b], points - kin.body_positions[b])
    return kin.linear_velocities[b] + turning


def frame_poses(kin: Kinematics, frames: Jets | AeroLinks) -> tuple[Float[Array, "k 3 3"], Float[Array, "k 3"]]:
    """Return rotations and origins [m] of the frames of jets or links, inertial axes."""
    b = np.array(frames.bodies, dtype=int)
    carriers = kin.body_rotations[b]
    return multiply(carriers, frames.rotations), rotate(carriers, frames.positions) + kin.body_positions[b]
