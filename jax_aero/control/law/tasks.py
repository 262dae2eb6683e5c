"""The controller's own tasks of the momentum QP.

```text
linear momentum    A_T Ṫ + (Λ_s + K A_s) ṡ + (Λ_b + K A_b) ν_B
                      − K L_d − L̈_d + (K_D + 1)(L̇ − L̇_d) + K_P I_L = 0       three rows, inertial axes
attitude           Rᵀ (A_T Ṫ + Λ_s ṡ + Λ_b ν_B − σ) − k̈* = 0                three rows, base axes
angular momentum   Rᵀ A_s,ang ṡ + (I_b − I₀) w = 0                             joint motion only
symmetric jets     Ṫ_a − Ṫ_b = 0                                               for each pair
posture            ṡ + K_s (s − s_d) = 0
and Ṫ, ṡ and all unknowns towards zero
```

with `K = K_P + K_D + K_O⁻¹`. Equations M57 and M61 to M63 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.base.arrays import namespace
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import multiply, rotate_back
from jax_aero.config import ControllerSection
from jax_aero.control.law.bounds import rate_bounds
from jax_aero.control.law.momentum_qp import Diagonal, Rows, TaskInputs
from jax_aero.types import Array, leaf

REGULARISATION = 1e-4
"""Weight of all unknowns, added to the diagonal."""


class TaskParams(NamedTuple):
    """Weights and bounds of the momentum QP; `j` jets, `n` joints."""

    momentum: Float[Array, ""]
    """Weight of the momentum and attitude rows."""
    angular_momentum: Float[Array, ""]
    """Weight of the angular-momentum rows."""
    posture: Float[Array, ""]
    """Weight of the posture."""
    joint_velocity: Float[Array, ""]
    """Weight of joint velocities."""
    thrust_rate: Float[Array, " j"]
    """Weights of thrust rates."""
    symmetry: Float[Array, ""]
    """Weight of the difference within a pair of jets."""
    posture_gain: Float[Array, " n"]
    """`K_s` [1/s]."""
    thrust_rate_max: Float[Array, " j"]
    """Greatest thrust rates [N/s]."""
    thrust_steepness: Float[Array, ""]
    """Steepness of the thrust bounds [1/N]."""
    joint_velocity_max: Float[Array, " n"]
    """Greatest joint velocities [rad/s]."""
    joint_steepness: Float[Array, ""]
    """Steepness of the joint bounds [1/rad, 1/m]."""


def task_params(config: ControllerSection, robot: RobotModel) -> TaskParams:
    """Return weights and bounds in the order of the robot's jets and joints; the crate has checked them."""
    weights, bounds, jets = config.weights, config.bounds, robot.jets.names
    gains = [config.posture_gain[name] for name, joints in robot.joint_groups for _ in joints]
    common = bounds.joint_velocity_max_deg
    velocity_max = choose_limits(robot.joint_velocity_max, None if common is None else np.deg2rad(common), robot)
    return TaskParams(
        momentum=leaf(weights.momentum),
        angular_momentum=leaf(weights.angular_momentum),
        posture=leaf(weights.posture),
        joint_velocity=leaf(weights.joint_velocity),
        thrust_rate=leaf([weights.thrust_rate[name] for name in jets]),
        symmetry=leaf(weights.symmetry),
        posture_gain=leaf(gains),
        thrust_rate_max=leaf([bounds.thrust_rate_max[name] for name in jets]),
        thrust_steepness=leaf(bounds.thrust_steepness),
        joint_velocity_max=velocity_max,
        joint_steepness=leaf(bounds.joint_steepness),
    )


def choose_limits(
    own: Float[Array, " n"], common: Float[Array, ""] | float | None, robot: RobotModel
) -> Float[Array, " n"]:
    """Return the joint limits: the robot's own, or for revolute joints the common one if given."""
    if common is None:
        return leaf(own)
    return leaf(namespace(own).where(np.array(robot.joint_is_prismatic, dtype=bool), own, common))


def symmetric_pairs(config: ControllerSection, robot: RobotModel) -> tuple[tuple[int, int], ...]:
    """Return the index pairs of jets that should have equal thrust rates."""
    known = robot.jets.names
    return tuple((known.index(a), known.index(b)) for a, b in config.weights.symmetric_jets)


def standard_tasks(params: TaskParams, pairs: tuple[tuple[int, int], ...], inputs: TaskInputs) -> list[Rows | Diagonal]:
    """Return the tasks of one tick, those of momentum first."""
    return [
        linear_momentum(params, inputs),
        attitude(params, inputs),
        angular_momentum(params, inputs),
        symmetric_jets(params, pairs, inputs),
        posture(params, inputs),
        *keep_small(params, inputs),
    ]


def linear_momentum(params: TaskParams, inputs: TaskInputs) -> Rows:
    """Return the task of following the set-point with the linear momentum (M57); inertial axes."""
    gains, mass, setpoint, momentum = inputs.gains, inputs.robot.mass, inputs.setpoint, inputs.momentum
    kp, kd = gains.kp_linear, gains.kd_linear
    k = kp + 1.0 / gains.ko + kd
    motion = momentum.lambda_[:3] + k[:, None] * inputs.dynamics.momentum_matrix[:3]
    desired = k * mass * setpoint.com_velocity + mass * setpoint.com_jerk
    rate_error = momentum.rate_estimate[:3] - mass * setpoint.com_acceleration
    integral = mass * (inputs.kinematics.com - setpoint.com_position)
    offset = motion[:, :6] @ inputs.state.velocity[:6] - desired + (kd + 1.0) * rate_error + kp * integral
    return Rows(inputs.blocks(momentum.a_t[:3], motion[:, 6:]), offset, jnp.repeat(params.momentum, 3))


def attitude(params: TaskParams, inputs: TaskInputs) -> Rows:
    """Return the task of following the attitude law with the angular momentum (M61); base axes."""
    state, demand = inputs.state, inputs.attitude
    b_from_i, lambda_ang = state.base_rotation.T, inputs.momentum.lambda_[3:]
    matrix = b_from_i @ inputs.blocks(inputs.momentum.a_t[3:], lambda_ang[:, 6:])
    offset = rotate_back(state.base_rotation, lambda_ang[:, :6] @ state.velocity[:6] - demand.sigma)
    return Rows(matrix, offset - demand.k_ddot_desired, jnp.repeat(params.momentum, 3))


def angular_momentum(params: TaskParams, inputs: TaskInputs) -> Rows:
    """Return the task on the limbs' angular momentum, which compensates the change of inertia (M62); base axes."""
    state, dyn = inputs.state, inputs.dynamics
    b_from_i = state.base_rotation.T
    matrix = b_from_i @ inputs.blocks(jnp.zeros_like(inputs.momentum.a_t[3:]), dyn.momentum_matrix[3:, 6:])
    inertia_b = multiply(multiply(b_from_i, dyn.centroidal_inertia), state.base_rotation)
    w = rotate_back(state.base_rotation, state.velocity[3:6])
    return Rows(matrix, (inertia_b - inputs.inertia_0) @ w, jnp.repeat(params.angular_momentum, 3))


def symmetric_jets(params: TaskParams, pairs: tuple[tuple[int, int], ...], inputs: TaskInputs) -> Rows:
    """Return the task of equal thrust rates within each pair of jets."""
    n = inputs.joints + inputs.posture.shape[0]
    eye = np.eye(n)
    matrix = jnp.asarray(np.array([eye[a] - eye[b] for a, b in pairs]).reshape(len(pairs), n), inputs.thrust.dtype)
    return Rows(matrix, jnp.zeros(len(pairs), matrix.dtype), jnp.repeat(params.symmetry, len(pairs)))


def posture(params: TaskParams, inputs: TaskInputs) -> Diagonal:
    """Return the task of returning to the desired posture (M63)."""
    offset = params.posture_gain * (inputs.state.joint_position - inputs.posture)
    return Diagonal(inputs.joints, offset, jnp.broadcast_to(params.posture, offset.shape))


def keep_small(params: TaskParams, inputs: TaskInputs) -> tuple[Diagonal, ...]:
    """Return the tasks that keep thrust rates, joint velocities and all unknowns small."""
    jets, joints = jnp.zeros_like(inputs.thrust), jnp.zeros_like(inputs.posture)
    everything = jnp.concatenate([jets, joints])
    return (
        Diagonal(0, jets, params.thrust_rate),
        Diagonal(inputs.joints, joints, jnp.broadcast_to(params.joint_velocity, joints.shape)),
        Diagonal(0, everything, jnp.full(everything.shape, REGULARISATION)),
    )


def unknown_bounds(params: TaskParams, inputs: TaskInputs) -> tuple[Float[Array, " u"], Float[Array, " u"]]:
    """Return lower and upper bounds of the unknowns, which keep thrusts and joints in their ranges (M65)."""
    engines, (least, greatest) = inputs.robot.jets, inputs.robot.joint_limits.T
    jets = rate_bounds(
        inputs.thrust, engines.thrust_min, engines.thrust_max, params.thrust_rate_max, params.thrust_steepness
    )
    position = inputs.state.joint_position
    joints = rate_bounds(position, least, greatest, params.joint_velocity_max, params.joint_steepness)
    return jnp.concatenate([jets[0], joints[0]]), jnp.concatenate([jets[1], joints[1]])
