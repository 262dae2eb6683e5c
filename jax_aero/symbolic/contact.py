"""Contribution of supporting feet to the momentum balance: constant wrenches, and the motion of the soles.

A wrench (f, m) about the origin p of a sole contributes (f ; (p − p_G) × f + m) to the momentum rate. Differentiation
with respect to the wrench gives A_c, with respect to the coordinates Λ_c. Differentiation of the soles' velocities
(ṗ, ω) with respect to ν gives J_c, and along the motion J̇_c ν.

Equations M54 and M73 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from jax_aero.symbolic.dynamics import Dynamics
from jax_aero.symbolic.kinematics import Kinematics
from jax_aero.symbolic.robot import Array, Robot


class ContactTerms(NamedTuple):
    """Terms of one state, inertial axes; six rows or columns per foot, force or linear velocity first."""

    a_c: Array
    """(6, 6 feet) momentum rate per wrench."""
    lambda_c: Array
    """(6, n) Λ_c."""
    jacobian: Array
    """(6 feet, n) J_c."""
    velocity_product: Array
    """(6 feet,) J̇_c ν."""


class ContactModel:
    """Expressions of the feet of one robot, in the order of the given names of sole frames."""

    def __init__(self, robot: Robot, soles: Sequence[str]) -> None:
        tree = Kinematics(robot)
        dynamics = Dynamics(tree)
        poses = [tree.poses[sole] for sole in soles]
        wrenches = ca.SX.sym("f_c", 6, len(soles))
        total = ca.SX.zeros(6)
        motion = ca.SX(0, 1)
        for pose, wrench in zip(poses, ca.horzsplit(wrenches), strict=True):
            force, moment = wrench[:3], wrench[3:]
            total += ca.vertcat(force, ca.cross(pose.position - dynamics.com, force) + moment)
            turning = ca.mtimes(ca.reshape(tree.rate(ca.vec(pose.rotation)), 3, 3), pose.rotation.T)
            motion = ca.vertcat(motion, tree.rate(pose.position), ca.inv_skew(turning))
        outputs = [
            ca.jacobian(total, ca.vec(wrenches)),
            ca.jacobian(total, tree.q),
            ca.jacobian(motion, tree.velocity),
            tree.rate(motion),
        ]
        inputs = [tree.base_position, tree.base_rotation, tree.joint_position, tree.velocity, wrenches]
        self._function: Any = ca.Function("contact", inputs, tree.evaluate_at_base(*outputs))

    def terms(
        self,
        base_position: ArrayLike,
        base_rotation: ArrayLike,
        joint_position: ArrayLike,
        velocity: ArrayLike,
        wrenches: ArrayLike,
    ) -> ContactTerms:
        """Return every term at one state; `wrenches` is (feet, 6) [N, N m]."""
        state = (base_position, base_rotation, joint_position, velocity)
        a_c, lambda_c, jacobian, product = self._function(*state, np.transpose(wrenches))
        return ContactTerms(a_c.full(), lambda_c.full(), jacobian.full(), product.full()[:, 0])
