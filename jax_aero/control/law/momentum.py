"""Effect of thrusts and joint motion on the centroidal momentum.

```text
L̇ = A_T T + Σ_j (f_j, r_j × f_j) − m g e₃                     estimated momentum rate
L̈ = A_T Ṫ + (Λ_T + Λ_a) ν                                     what the controller shapes
```

with `r` the arm from the centre of mass. Source: paper, Methods, "Flight Control Design".

A column of `Λ` is the change of all forces per unit speed of one joint. It needs no Jacobian, only the sums of forces
and moments over the joint's subtree, which are one product with the static matrix of ancestors.

Equations M50 to M52, M55, M56 and M86 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.aero import wrench_about
from jax_aero.body.kinematics import carried, frame_poses
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import cross, rotate, skew, trace
from jax_aero.types import Array, Dynamics, Kinematics, LinkForces


class MomentumModel(NamedTuple):
    """Terms of the momentum rate and of its derivative; `j` jets."""

    jet_axes: Float[Array, "j 3"]
    """Unit thrust directions `a_i`."""
    jet_points: Float[Array, "j 3"]
    """Points at which the thrusts act [m]."""
    a_t: Float[Array, "6 j"]
    """`A_T = (a_i ; r_i × a_i + κ_i a_i)`."""
    lambda_t: Float[Array, "6 N"]
    """`Λ_T`: momentum acceleration per unit of ν due to turning and moving thrusts."""
    lambda_a: Float[Array, "6 N"]
    """`Λ_a`: the same due to moving aerodynamic forces, with the change of the forces themselves neglected."""
    rate_estimate: Float[Array, "6"]
    """`L̇` [N, N m]."""
    unmodelled_wrench: Float[Array, "6"]
    """Observed unmodelled wrench `ŵ`, included in the rate; zero without an observer [N, N m]."""

    def add_unmodelled(self, wrench: Float[Array, "6"]) -> MomentumModel:
        """Return the same model with the observed wrench `ŵ` added to the momentum rate."""
        return self._replace(rate_estimate=self.rate_estimate + wrench, unmodelled_wrench=wrench)

    @property
    def lambda_(self) -> Float[Array, "6 N"]:
        """`Λ = Λ_T + Λ_a`."""
        return self.lambda_t + self.lambda_a


def momentum_model(
    robot: RobotModel,
    kin: Kinematics,
    dyn: Dynamics,
    thrust: Float[Array, " j"],
    link: LinkForces,
    *,
    rate_feedback: Float[Array, "6"] | float = 1.0,
    lambda_feedback: bool = True,
) -> MomentumModel:
    """Return all terms of the momentum rate and its derivative.

    `rate_feedback` is the share of the total aerodynamic force and moment that enters the momentum rate;
    `lambda_feedback` says whether link forces enter its derivative.
    """
    axes, points, a_t = thrust_map(robot, kin)
    com_jacobian = dyn.momentum_matrix[:3] / robot.mass
    forces = thrust[:, None] * axes
    lambda_t = _lambda_t(robot, kin, com_jacobian, points, forces, robot.jets.torque_to_thrust[:, None] * forces)
    lambda_a = jnp.zeros_like(lambda_t)
    if lambda_feedback:
        lambda_a = _lambda_a(robot, kin, com_jacobian, link)

    rate_estimate = jnp.sum(a_t * thrust[None], axis=1) + rate_feedback * wrench_about(link, kin.com)
    rate_estimate = rate_estimate.at[2].add(-robot.mass * robot.gravity)
    return MomentumModel(axes, points, a_t, lambda_t, lambda_a, rate_estimate, jnp.zeros_like(rate_estimate))


def thrust_map(
    robot: RobotModel, kin: Kinematics
) -> tuple[Float[Array, "j 3"], Float[Array, "j 3"], Float[Array, "6 j"]]:
    """Return directions and points [m] of the thrusts, and `A_T`."""
    rotations, points = frame_poses(kin, robot.jets)
    axes = rotate(rotations, robot.jets.axes)
    moments = cross(points - kin.com[None], axes) + robot.jets.torque_to_thrust[:, None] * axes
    return axes, points, jnp.concatenate([axes, moments], axis=1).T


def _lambda_t(
    robot: RobotModel, kin: Kinematics, com_jacobian: Array, points: Array, forces: Array, couples: Array
) -> Array:
    """Thrusts `f_i = T_i a_i` and their moments `κ_i f_i` rotate with the body that carries the jet.

    ```text
    Λ_T = −Σ_i ( (0 ; S(f_i)) (J_i^v − J_G) + (I ; S(r_i) + κ_i I) S(f_i) J_i^ω )
    ```

    The subtree of joint k has the wrench (F, M) about the joint's origin o. Rotation about the axis a changes it to
    `(F + a × F, M + a × M)`, and so about the centre of mass c by `(a × F ; a × M + (o − c) × (a × F))`. Translation
    along the axis a changes it by `(0 ; a × F)`.
    """
    base = kin.body_positions[:1]
    moments = cross(points - base, forces) + couples
    total, total_moment = forces.sum(0), moments.sum(0)
    summed = carried(robot, robot.jets.bodies, jnp.concatenate([forces, moments], axis=1))
    force, moment_about_base = summed[:, :3], summed[:, 3:]
    origins = kin.body_positions[1:]
    moment = moment_about_base - cross(origins - base, force)

    axes = jnp.concatenate([jnp.eye(3, dtype=force.dtype), kin.joint_angular])
    shifts = jnp.concatenate([jnp.zeros((3, 3), force.dtype), kin.joint_linear])
    force = jnp.concatenate([jnp.broadcast_to(total, (3, 3)), force])
    moment = jnp.concatenate([jnp.broadcast_to(total_moment, (3, 3)), moment])
    arms = jnp.concatenate([jnp.broadcast_to(base, (3, 3)), origins]) - kin.com[None]
    turned = cross(axes, force)
    changed = cross(axes, moment) + cross(arms, turned) + cross(shifts, force)
    turning = jnp.concatenate([turned, changed], axis=1).T
    shifting = jnp.concatenate([jnp.zeros((3, 3), force.dtype), -skew(total)])  # base translation moves the points
    return jnp.concatenate([shifting, turning], axis=1) + _com_motion(total, com_jacobian)


def _lambda_a(robot: RobotModel, kin: Kinematics, com_jacobian: Array, link: LinkForces) -> Array:
    """Aerodynamic forces keep their direction while their points move.

    ```text
    Λ_a = (0 ; −Σ_j S(f_j) (J_j − J_G))
    ```

    A revolute joint with axis a at o moves a point p by `a × d`, d = p − o, and `(a × d) × f = d (a·f) − a (d·f)`.
    Summed over the joint's subtree this only needs `P = Σ d fᵀ`: `P a − a tr P`. A prismatic joint moves all points by
    a, which gives `a × Σ f`.
    """
    base = kin.body_positions[:1]
    arms = link.jacobian_points - base
    products = (arms[:, :, None] * link.forces[:, None, :]).reshape(-1, 9)
    sums = jnp.concatenate([link.forces, products], axis=1)
    summed = carried(robot, robot.aero_links.bodies, sums)
    force, about_base = summed[:, :3], summed[:, 3:].reshape(-1, 3, 3)
    origins = kin.body_positions[1:] - base
    p = about_base - origins[:, :, None] * force[:, None, :]

    axes = jnp.concatenate([jnp.eye(3, dtype=force.dtype), kin.joint_angular])
    shifts = jnp.concatenate([jnp.zeros((3, 3), force.dtype), kin.joint_linear])
    total, total_p = link.forces.sum(0), sums[:, 3:].sum(0).reshape(3, 3)
    p = jnp.concatenate([jnp.broadcast_to(total_p, (3, 3, 3)), p])
    forces = jnp.concatenate([jnp.zeros((3, 3), force.dtype), force])
    moving = (rotate(p, axes) - axes * trace(p)[:, None] + cross(shifts, forces)).T
    moment = jnp.concatenate([-skew(total), moving], axis=1)
    return jnp.concatenate([jnp.zeros_like(moment), moment]) + _com_motion(total, com_jacobian)


def _com_motion(total_force: Array, com_jacobian: Array) -> Array:
    """Part `(0 ; Σ S(f) J_G)` common to all forces: the arms change as the centre of mass moves."""
    return jnp.concatenate([jnp.zeros_like(com_jacobian), cross(total_force[None], com_jacobian.T).T])
