"""Mass matrix, bias forces and centroidal momentum of the floating-base tree.

    M(q) ν̇ + h(q, ν) = S τ + Σ Jᵀ f        h contains gravity
    (l, k) = A_G(q) ν                        momentum about the centre of mass

Two backends compute `M` and `h`, from which everything else follows. `tree` is written for this package, with sums over
ancestors and descendants as products with one static matrix. `mjx` uses MuJoCo's JAX implementation.

Equations M11 to M14, M17 and M69 (`joint_gain`) of `docs/model`.
"""

from __future__ import annotations

from typing import assert_never

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.body.linalg import invert, solve_positive_definite
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import cross, inverse, multiply, rotate, rotate_back, skew
from jax_aero.config import DynamicsBackend
from jax_aero.types import Array, Dynamics, InverseMass, Kinematics, State


def dynamics(robot: RobotModel, state: State, kin: Kinematics, backend: DynamicsBackend = "tree") -> Dynamics:
    """Return the rigid-body dynamics of one state; `kin` must belong to it."""
    match backend:
        case "tree":
            mass_matrix, bias = _tree_mass_matrix_and_bias(robot, state, kin)
        case "mjx":
            from jax_aero.body.mujoco_model import mass_matrix_and_bias  # MuJoCo is loaded only when needed

            mass_matrix, bias = mass_matrix_and_bias(robot, state)
        case _:
            assert_never(backend)
    if robot.rotor_inertia is not None:
        mass_matrix = mass_matrix + jnp.diag(jnp.pad(robot.rotor_inertia, (6, 0)))
    # The base's rows of M ν are the momentum and its moment about the base origin.
    linear = mass_matrix[:3]
    angular = mass_matrix[3:6] - skew(kin.com - kin.body_positions[0]) @ linear
    momentum_matrix = jnp.concatenate([linear, angular.at[:, :3].set(0.0)])
    return Dynamics(mass_matrix, bias, momentum_matrix, momentum_matrix @ state.velocity, momentum_matrix[3:, 3:6])


def forward_dynamics(dyn: Dynamics, force: Float[Array, " N"]) -> Float[Array, " N"]:
    """Return the acceleration `ν̇` under a generalised force: `M ν̇ = force − h`."""
    return solve_positive_definite(dyn.mass_matrix, (force - dyn.bias)[:, None])[:, 0]


def invert_mass(dyn: Dynamics) -> InverseMass:
    """Return the inverse of the mass matrix.

    About the centre of mass the base's block is diagonal: with `P` from base origin to centre of mass

        M_b = P⁻¹ D⁻¹ P⁻ᵀ,   M_bs = P⁻¹ A_s,   D = diag(1/m, I_G⁻¹),   A_s the joints' columns of A_G
    """
    mass, eye = dyn.mass_matrix[0, 0], jnp.eye(3, dtype=dyn.bias.dtype)
    zero, a_s = jnp.zeros_like(eye), dyn.momentum_matrix[:, 6:]
    p = jnp.block([[eye, zero], [-dyn.mass_matrix[3:6, :3] / mass, eye]])
    d = jnp.block([[eye / mass, zero], [zero, inverse(dyn.centroidal_inertia)]])
    moved = d @ a_s
    inertia = dyn.mass_matrix[6:, 6:] - a_s.T @ moved
    return InverseMass(p.T @ d @ p, p.T @ moved, inertia, invert(inertia))


def add_joint_inertia(
    inverse_mass: InverseMass,
    added: Float[Array, " n"],
    unless: tuple[Bool[Array, ""], Float[Array, "n n"]] | None = None,
) -> InverseMass:
    """Return the inverse of the mass matrix with more inertia on the diagonal of its joints.

    `unless` says whether its `joint_gain` is known already, and what it then is; by default, where nothing is added.
    """
    inertia = inverse_mass.joint_inertia + jnp.diag(added)
    gain = invert(inertia, unless or (jnp.all(added == 0.0), inverse_mass.joint_gain))
    return inverse_mass._replace(joint_inertia=inertia, joint_gain=gain)


def accelerate(inverse_mass: InverseMass, force: Float[Array, " N"]) -> Float[Array, " N"]:
    """Return `M⁻¹ force`."""
    base, coupling, _, gain = inverse_mass
    joints = gain @ (force[6:] - force[:6] @ coupling)
    return jnp.concatenate([base @ force[:6] - coupling @ joints, joints])


def momentum(robot: RobotModel, kin: Kinematics) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Return linear and angular momentum about the centre of mass, as sums over the bodies."""
    arms, omega = rotate(kin.body_rotations, robot.coms), kin.angular_velocities
    linear = robot.masses[:, None] * (kin.linear_velocities + cross(omega, arms))
    spin = rotate(kin.body_rotations, rotate(robot.inertias, rotate_back(kin.body_rotations, omega)))
    angular = spin + cross(kin.body_positions + arms - kin.com[None], linear)
    return linear.sum(0), angular.sum(0)


def _tree_mass_matrix_and_bias(robot: RobotModel, state: State, kin: Kinematics) -> tuple[Array, Array]:
    """Composite rigid bodies and recursive Newton–Euler, in inertial axes about the base origin.

    A unit velocity of joint j gives its subtree the angular velocity `ω` and, at the base origin, the velocity `v`
    (revolute: `a` and `(o_j − o_B) × a`; prismatic: zero and `a`). The subtree's momentum about the base origin is
    `l = m v + ω × s`, `k = I ω + s × v` with the first moment s. Then `M_ij = ω_i·k_j + v_i·l_j` for every joint i
    between j and the base.
    """
    rotations, origin = kin.body_rotations, kin.body_positions[:1]
    arms = rotate(rotations, robot.coms)
    coms = kin.body_positions - origin + arms
    inertias = multiply(multiply(rotations, robot.inertias), jnp.swapaxes(rotations, -1, -2))

    axes = kin.joint_angular
    v = kin.joint_linear + cross(kin.body_positions[1:] - origin, axes)
    force, moment = _inertial_wrenches(robot, state, kin, arms, coms, inertias)
    # Subtree sums of mass, first moment, inertia about the base origin, force and moment, all at once.
    first = robot.masses[:, None] * coms
    about_origin = inertias - multiply(skew(first), skew(coms))
    quantities = jnp.concatenate([robot.masses[:, None], first, about_origin.reshape(-1, 9), force, moment], axis=1)
    moves = jnp.asarray(robot.ancestors, quantities.dtype)
    subtree = moves.T @ quantities
    whole = quantities.sum(0)

    s, inertia = subtree[:, 1:4], subtree[:, 4:13].reshape(-1, 3, 3)
    linear = subtree[:, :1] * v + cross(axes, s)
    angular = rotate(inertia, axes) + cross(s, v)
    is_ancestor = moves[1:].T  # [i, j]: joint i moves the body of joint j
    upper = is_ancestor * (axes @ angular.T + v @ linear.T)
    below = upper * (1.0 - jnp.eye(robot.n_joints, dtype=upper.dtype))
    base_coupling = -skew(whole[1:4])
    base = jnp.concatenate(
        [
            jnp.concatenate([whole[0] * jnp.eye(3, dtype=upper.dtype), base_coupling, linear.T], axis=1),
            jnp.concatenate([base_coupling.T, whole[4:13].reshape(3, 3), angular.T], axis=1),
        ]
    )
    mass_matrix = jnp.concatenate([base, jnp.concatenate([base[:, 6:].T, upper + below.T], axis=1)])

    joints = jnp.sum(axes * subtree[:, 16:19] + v * subtree[:, 13:16], axis=1)
    return mass_matrix, jnp.concatenate([whole[13:19], joints])


def _inertial_wrenches(
    robot: RobotModel, state: State, kin: Kinematics, arms: Array, coms: Array, inertias: Array
) -> tuple[Array, Array]:
    """Force (nb, 3) [N] and moment about the base origin (nb, 3) [N m] on each body for `ν̇ = 0`, with gravity."""
    parents = np.array(robot.parent[1:], dtype=int)
    moves = jnp.asarray(robot.ancestors, state.velocity.dtype)
    omega = kin.angular_velocities
    rates = state.velocity[6:, None]
    alpha = moves @ (cross(omega[parents], kin.joint_angular) * rates)
    links = kin.body_positions[1:] - kin.body_positions[parents]
    coriolis = 2.0 * cross(omega[parents], kin.joint_linear) * rates
    turning = cross(alpha[parents], links) + cross(omega[parents], cross(omega[parents], links))
    a_origin = moves @ (turning + coriolis)
    a_com = a_origin + cross(alpha, arms) + cross(omega, cross(omega, arms))
    up = jnp.array([[0.0, 0.0, 1.0]], dtype=state.velocity.dtype)
    force = robot.masses[:, None] * (a_com + robot.gravity * up)
    moment = rotate(inertias, alpha) + cross(omega, rotate(inertias, omega)) + cross(coms, force)
    return force, moment
