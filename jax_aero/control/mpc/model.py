"""Centroidal dynamics with aerodynamics, linearised at the present state by automatic differentiation.

```text
δẇ = ∂w/∂(v, θ, k, T, s, ṡ)       rate of linear and angular momentum, w = A_T T + (Σ f ; Σ r × f) + const
ω = I_G⁻¹ (k − A_k ṡ)              angular velocity of the base
```

`θ` rotates the whole robot about its centre of mass, which stays. All in inertial axes. Equations M116 to M119 of
`docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.aero import AeroModel, LinkConventions, link_forces, wrench_about
from jax_aero.body.dynamics import momentum
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import exp_so3, inverse, multiply
from jax_aero.config import Air
from jax_aero.control.law.momentum import thrust_map
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


class _Pose(NamedTuple):
    """Variables of the pose."""

    theta: Float[Array, "3"]
    """Rotation from the present attitude [rad]."""
    s: Float[Array, " f"]
    """Positions of the joints that the law moves [rad]."""


class _Motion(NamedTuple):
    """Variables of the velocities."""

    v_b: Float[Array, "3"]
    """Velocity of the base origin [m/s]."""
    omega: Float[Array, "3"]
    """Angular velocity of the base [rad/s]."""
    sigma: Float[Array, " f"]
    """Velocities of the joints that the law moves [rad/s]."""


def linearise(
    robot: RobotModel,
    aero: AeroModel,
    air: Air,
    joints: tuple[int, ...],
    state: State,
    thrust: Float[Array, " j"],
    wind: Float[Array, "3"],
) -> Linearised:
    """Linearise at a state with its thrusts [N] and wind [m/s].

    Momentum `(l, k)` and momentum rate w are differentiated by θ, s and ν; then ν_B is eliminated by

        m δv_B = m δv − ∂l (θ, s, ω, ṡ)        I_G δω = δk − ∂k (θ, s, ṡ)
    """
    moved = np.array(joints, dtype=int)

    def response(pose: _Pose, motion: _Motion) -> tuple[tuple[Array, Array, Array], Array]:
        rates = state.velocity[6:].at[moved].set(motion.sigma)
        moving = State(
            base_position=state.base_position,
            base_rotation=multiply(exp_so3(pose.theta), state.base_rotation),
            joint_position=state.joint_position.at[moved].set(pose.s),
            velocity=jnp.concatenate([motion.v_b, motion.omega, rates]),
        )
        kin = kinematics(robot, moving)
        by_thrust = thrust_map(robot, kin)[2]
        rate = by_thrust @ thrust
        if air == "linear":
            rate = rate + wrench_about(link_forces(aero, robot, kin, LinkConventions(), wind), kin.com)
        return (rate, *momentum(robot, kin)), by_thrust

    at = _Pose(jnp.zeros(3, thrust.dtype), state.joint_position[moved])
    going = _Motion(state.velocity[:3], state.velocity[3:6], state.velocity[6 + moved])
    # The pose does not change with velocities, by which its derivatives are thus not computed.
    (w, linear, angular), by_thrust = jax.jacfwd(lambda pose: response(pose, going), has_aux=True)(at)
    (w_of, linear_of, angular_of), _ = jax.jacfwd(lambda motion: response(at, motion), has_aux=True)(going)
    omega_k = inverse(angular_of.omega)
    omega_theta, omega_s, omega_sigma = (-omega_k @ by for by in (angular.theta, angular.s, angular_of.sigma))

    def rate_by(of_rate: Array | float, of_momentum: Array | float, of_omega: Array) -> Array:
        """Return the change of w by a variable that changes w, l and ω by these."""
        v_b: Array = -(of_momentum + linear_of.omega @ of_omega) / robot.mass
        change: Array = of_rate + w_of.v_b @ v_b + w_of.omega @ of_omega
        return change

    return Linearised(
        rate_v=w_of.v_b,
        rate_theta=rate_by(w.theta, linear.theta, omega_theta),
        rate_k=rate_by(0.0, 0.0, omega_k),
        rate_t=by_thrust,
        rate_s=rate_by(w.s, linear.s, omega_s),
        rate_sigma=rate_by(w_of.sigma, linear_of.sigma, omega_sigma),
        omega_theta=omega_theta,
        omega_k=omega_k,
        omega_s=omega_s,
        omega_sigma=omega_sigma,
    )
