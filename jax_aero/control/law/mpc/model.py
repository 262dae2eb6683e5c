"""Centroidal dynamics with aerodynamics, linearised at the present state by automatic differentiation.

```text
δẇ = ∂w/∂(v, θ, k, T, s, ṡ)       rate of linear and angular momentum, w = A_T T + (Σ f ; Σ r × f) + const
ω = I_G⁻¹ (k − A_k ṡ)              angular velocity of the base
```

`θ` rotates the whole robot about its centre of mass, which stays. All in inertial axes. Equations M116 to M119 of
`docs/model.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.aero import AeroModel, LinkConventions, link_forces, wrench_about
from jax_aero.config import Air
from jax_aero.control.law.attitude import inverse
from jax_aero.control.law.momentum import thrust_map
from jax_aero.dynamics import dynamics
from jax_aero.kinematics import kinematics
from jax_aero.robot import RobotModel
from jax_aero.spatial import exp_so3, multiply
from jax_aero.types import Array, State


class Linearised(NamedTuple):
    """Derivatives of the momentum rate and of the angular velocity; `f` joints that the law moves."""

    rate_v: Float[Array, "6 3"]
    """Momentum rate [N, N m] by the velocity of the centre of mass."""
    rate_theta: Float[Array, "6 3"]
    """By the rotation `θ` [rad]."""
    rate_k: Float[Array, "6 3"]
    """By the angular momentum `k`."""
    rate_t: Float[Array, "6 j"]
    """By the thrusts: `A_T`."""
    rate_s: Float[Array, "6 f"]
    """By the positions of the joints that the law moves."""
    rate_sigma: Float[Array, "6 f"]
    """By their velocities."""
    omega_theta: Float[Array, "3 3"]
    """Angular velocity [rad/s] by `θ`."""
    omega_k: Float[Array, "3 3"]
    """By `k`."""
    omega_s: Float[Array, "3 f"]
    """By the positions of the joints that the law moves."""
    omega_sigma: Float[Array, "3 f"]
    """By their velocities."""


class Variables(NamedTuple):
    """Variables of the centroidal dynamics."""

    v: Float[Array, "3"]
    """Velocity of the centre of mass [m/s]."""
    theta: Float[Array, "3"]
    """Rotation from the present attitude [rad]."""
    k: Float[Array, "3"]
    """Angular momentum about the centre of mass [kg m²/s]."""
    t: Float[Array, " j"]
    """Thrusts [N]."""
    s: Float[Array, " f"]
    """Positions of the joints that the law moves [rad]."""
    sigma: Float[Array, " f"]
    """Their velocities [rad/s]."""


def linearise(
    robot: RobotModel,
    aero: AeroModel,
    air: Air,
    joints: tuple[int, ...],
    state: State,
    momentum: Float[Array, "6"],
    thrust: Float[Array, " j"],
    wind: Float[Array, "3"],
) -> Linearised:
    """Linearise at a state with its `momentum` [kg m/s, kg m²/s], thrusts [N] and wind [m/s]."""
    moved = np.array(joints, dtype=int)

    def response(at: Variables) -> tuple[Array, Array]:
        position = state.joint_position.at[moved].set(at.s)
        rates = state.velocity[6:].at[moved].set(at.sigma)
        rotation = multiply(exp_so3(at.theta), state.base_rotation)
        still = State(state.base_position, rotation, position, jnp.zeros_like(state.velocity))
        kin = kinematics(robot, still)
        matrix = dynamics(robot, still, kin).momentum_matrix
        omega = inverse(matrix[3:, 3:6]) @ (at.k - matrix[3:, 6:] @ rates)
        rate = thrust_map(robot, kin)[2] @ at.t
        if air == "linear":
            linear = at.v - (matrix[:3, 3:6] @ omega + matrix[:3, 6:] @ rates) / robot.mass
            kin = kinematics(robot, still._replace(velocity=jnp.concatenate([linear, omega, rates])))
            rate = rate + wrench_about(link_forces(aero, robot, kin, LinkConventions(), wind), kin.com)
        return rate, omega

    at = Variables(
        v=momentum[:3] / robot.mass,
        theta=jnp.zeros_like(wind),
        k=momentum[3:],
        t=thrust,
        s=state.joint_position[moved],
        sigma=state.velocity[6 + moved],
    )
    rate, omega = jax.jacfwd(response)(at)
    return Linearised(
        *(rate.v, rate.theta, rate.k, rate.t, rate.s, rate.sigma),
        *(omega.theta, omega.k, omega.s, omega.sigma),
    )
