"""The momentum QP: tasks stacked into a cost, bounds around the unknowns.

Unknowns `u = (Ṫ, ṡ)`. Cost `½ uᵀ H u + gᵀ u` of the weighted squares of

```text
momentum   A_T Ṫ + (Λ_s + K A_s) ṡ + (Λ_b + K A_b) ν_B
               − K L_d − L̈_d + (K_D + 1)(L̇ − L̇_d) + K_P I_L       three linear rows
attitude   Rᵀ (A_T Ṫ + Λ_s ṡ + Λ_b ν_B − σ) − k̈*                three angular rows
angular    Rᵀ A_s,ang ṡ + (I_b − I₀) w                              momentum the limbs may carry
posture    ṡ + K_s (s − s_d)
and of ṡ, Ṫ and the differences of paired thrust rates
```

with `K = K_P + K_D + K_O⁻¹`. Equations M57 and M61 to M64 of `docs/model.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.config import ControllerConfig, MomentumGains
from jax_aero.control.attitude import AttitudeDemand
from jax_aero.control.bounds import rate_bounds
from jax_aero.control.momentum import MomentumModel
from jax_aero.control.qp import BoxQp
from jax_aero.robot import RobotModel
from jax_aero.spatial import multiply, rotate_back
from jax_aero.types import Array, Dynamics, Kinematics, Setpoint, State


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
    regularisation: Float[Array, ""]
    """Added to the diagonal."""
    posture_gain: Float[Array, " n"]
    """`K_s` [1/s]."""
    thrust_rate_max: Float[Array, " j"]
    """[N/s]."""
    thrust_steepness: Float[Array, ""]
    """[1/N]."""
    joint_velocity_max: Float[Array, " n"]
    """[rad/s]."""
    joint_steepness: Float[Array, ""]
    """[1/rad, 1/m]."""


class MomentumQp(NamedTuple):
    """The momentum QP of one tick."""

    task: Float[Array, "9 j+n"]
    """The tasks ask `task · u + offset = 0`."""
    offset: Float[Array, "9"]
    problem: BoxQp


def task_params(config: ControllerConfig, robot: RobotModel) -> TaskParams:
    """Bring weights and bounds into the order of the robot's jets and joints."""
    weights, bounds = config.weights, config.bounds
    gains = [jnp.broadcast_to(config.posture_gain[name], (len(joints),)) for name, joints in robot.joint_groups]
    posture_gain = jnp.concatenate(gains) if gains else jnp.zeros(0)
    velocity_max = bounds.joint_velocity_max_deg
    return TaskParams(
        momentum=weights.momentum,
        angular_momentum=weights.angular_momentum,
        posture=weights.posture,
        joint_velocity=weights.joint_velocity,
        thrust_rate=_per_jet(weights.thrust_rate, robot),
        symmetry=weights.symmetry,
        regularisation=weights.regularisation,
        posture_gain=posture_gain,
        thrust_rate_max=_per_jet(bounds.thrust_rate_max, robot),
        thrust_steepness=bounds.thrust_steepness,
        joint_velocity_max=in_place_of(
            robot.joint_velocity_max, None if velocity_max is None else jnp.deg2rad(velocity_max), robot
        ),
        joint_steepness=bounds.joint_steepness,
    )


def _per_jet(table: Mapping[str, Array], robot: RobotModel) -> Array:
    return jnp.asarray([table[name] for name in robot.jets.names])


def in_place_of(own: Array, common: Array | None, robot: RobotModel) -> Array:
    """Limits (n,) of the joints: the robot's own, or for revolute joints the common one where it is given."""
    if common is None:
        return jnp.asarray(own)
    return jnp.where(np.array(robot.joint_is_prismatic, dtype=bool), own, common)


def symmetric_pairs(config: ControllerConfig, robot: RobotModel) -> tuple[tuple[int, int], ...]:
    """Return the indices of the jets meant to act alike.

    Raises
    ------
    ValueError
        For a jet that the robot does not have.
    """
    known = robot.jets.names
    for name in [name for pair in config.weights.symmetric_jets for name in pair]:
        if name not in known:
            raise ValueError(f"`{name}` in weights.symmetric_jets is no jet of {robot.name}: {', '.join(known)}")
    return tuple((known.index(a), known.index(b)) for a, b in config.weights.symmetric_jets)


def momentum_qp(
    params: TaskParams,
    gains: MomentumGains,
    pairs: tuple[tuple[int, int], ...],
    robot: RobotModel,
    state: State,
    thrust: Array,
    kin: Kinematics,
    dyn: Dynamics,
    momentum: MomentumModel,
    setpoint: Setpoint,
    attitude: AttitudeDemand,
    inertia_0: Array,
    posture: Array,
) -> MomentumQp:
    """Build tasks, cost and bounds of one tick."""
    linear, linear_offset = _linear_task(gains, robot.mass, state, kin, dyn, momentum, setpoint)
    angular, angular_offset = _angular_tasks(state, dyn, momentum, attitude, inertia_0)
    task = jnp.concatenate([linear, angular])
    offset = jnp.concatenate([linear_offset, angular_offset])
    h, g = _cost(params, pairs, task, offset, state.joint_position - posture)
    lower, upper = _bounds(params, robot, state, thrust)
    return MomentumQp(task, offset, BoxQp(h, g, lower, upper))


def _linear_task(
    gains: MomentumGains,
    mass: Array,
    state: State,
    kin: Kinematics,
    dyn: Dynamics,
    momentum: MomentumModel,
    setpoint: Setpoint,
) -> tuple[Array, Array]:
    """Rows 0 to 2, in inertial axes."""
    kp, kd = gains.kp_linear, gains.kd_linear
    k = kp + 1.0 / gains.ko + kd
    motion = momentum.lambda_[:3] + k[:, None] * dyn.momentum_matrix[:3]
    desired = k * mass * setpoint.com_velocity + mass * setpoint.com_jerk
    rate_error = momentum.rate_estimate[:3] - mass * setpoint.com_acceleration
    integral = mass * (kin.com - setpoint.com_position)
    offset = motion[:, :6] @ state.velocity[:6] - desired + (kd + 1.0) * rate_error + kp * integral
    return jnp.concatenate([momentum.a_t[:3], motion[:, 6:]], axis=1), offset


def _angular_tasks(
    state: State, dyn: Dynamics, momentum: MomentumModel, attitude: AttitudeDemand, inertia_0: Array
) -> tuple[Array, Array]:
    """Rows 3 to 8, in base axes."""
    b_from_i = state.base_rotation.T
    jets, lambda_ang = momentum.a_t[3:], momentum.lambda_[3:]
    limbs = dyn.momentum_matrix[3:, 6:]
    task = jnp.concatenate(
        [
            jnp.concatenate([jets, lambda_ang[:, 6:]], axis=1),
            jnp.concatenate([jnp.zeros_like(jets), limbs], axis=1),
        ],
        axis=1,
    )
    columns = jets.shape[1] + limbs.shape[1]
    turned = b_from_i @ task
    demand = rotate_back(state.base_rotation, lambda_ang[:, :6] @ state.velocity[:6] - attitude.sigma)
    inertia_b = multiply(multiply(b_from_i, dyn.centroidal_inertia), state.base_rotation)
    w = rotate_back(state.base_rotation, state.velocity[3:6])
    offset = jnp.concatenate([demand - attitude.k_ddot_desired, (inertia_b - inertia_0) @ w])
    return jnp.concatenate([turned[:, :columns], turned[:, columns:]]), offset


def _cost(
    params: TaskParams, pairs: tuple[tuple[int, int], ...], task: Array, offset: Array, posture_error: Array
) -> tuple[Array, Array]:
    """`H = Σ w Gᵀ G + diagonal`, `g = Σ w Gᵀ offset`."""
    n_jets, n_joints = params.thrust_rate.shape[0], posture_error.shape[0]
    row_weights = jnp.concatenate([jnp.full(6, params.momentum), jnp.full(3, params.angular_momentum)])
    weighted = row_weights[:, None] * task
    joints = jnp.full(n_joints, params.joint_velocity + params.posture)
    diagonal = jnp.concatenate([params.thrust_rate, joints]) + params.regularisation
    h = task.T @ weighted + jnp.diag(diagonal)
    # Rows of differences: H takes their Gram matrix.
    eye = jnp.eye(n_jets + n_joints, dtype=h.dtype)
    for a, b in pairs:
        difference = eye[a] - eye[b]
        h = h + params.symmetry * difference[:, None] * difference
    # A product is symmetric only to rounding, and the QP takes H to be exactly so.
    h = 0.5 * (h + h.T)
    pull = jnp.concatenate([jnp.zeros(n_jets, h.dtype), params.posture * params.posture_gain * posture_error])
    return h, offset @ weighted + pull


def _bounds(params: TaskParams, robot: RobotModel, state: State, thrust: Array) -> tuple[Array, Array]:
    jets = rate_bounds(
        thrust, jnp.zeros_like(thrust), robot.jets.thrust_max, params.thrust_rate_max, params.thrust_steepness
    )
    limits = robot.joint_limits
    joints = rate_bounds(
        state.joint_position, limits[:, 0], limits[:, 1], params.joint_velocity_max, params.joint_steepness
    )
    return jnp.concatenate([jets[0], joints[0]]), jnp.concatenate([jets[1], joints[1]])
