"""The tree of bodies as transforms that depend on the coordinates; velocities are derivatives along the motion.

Equations M7 and M8 of `docs/model`.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from jax_aero.symbolic.robot import Robot
from jax_aero.symbolic.spatial import SX, Pose, constant, small_turn, turn_about


class Kinematics:
    """Pose of every body as a function of the coordinates q = (p_B, φ, s).

    The base has the rotation `small_turn(φ) R_B`. At φ = 0, where everything is finally evaluated, q̇ is the mixed
    velocity ν = (v_B, ω_B, ṡ) of `docs/reference.md` and q̈ its derivative. Derivatives are taken before φ is set to
    zero by `evaluate_at_base`.
    """

    def __init__(self, robot: Robot) -> None:
        n = robot.n_joints
        self.robot = robot
        self.base_rotation = ca.SX.sym("R_B", 3, 3)
        self.base_position = ca.SX.sym("p_B", 3)
        self.joint_position = ca.SX.sym("s", n)
        self._phi = ca.SX.sym("phi", 3)
        self.q = ca.vertcat(self.base_position, self._phi, self.joint_position)
        self.velocity = ca.SX.sym("nu", 6 + n)
        self.bodies = self._place(robot)

    def _place(self, robot: Robot) -> list[Pose]:
        bodies = [Pose(ca.mtimes(small_turn(self._phi), self.base_rotation), self.base_position)]
        for joint, along in zip(robot.joints, ca.vertsplit(self.joint_position), strict=True):
            if joint.is_prismatic:
                moved = Pose(ca.SX.eye(3), constant(joint.axis) * along)
            else:
                moved = Pose(turn_about(joint.axis, along), ca.SX.zeros(3))
            mount = Pose(constant(joint.rotation), constant(joint.position))
            bodies.append(bodies[joint.parent] @ mount @ moved)
        return bodies

    @cached_property
    def poses(self) -> dict[str, Pose]:
        """Pose of every link of the URDF."""
        frames = self.robot.frames.items()
        return {
            name: self.bodies[frame.body] @ Pose(constant(frame.rotation), constant(frame.position))
            for name, frame in frames
        }

    def rate(self, expression: SX) -> SX:
        """Return the time derivative of a function of the coordinates."""
        return ca.jtimes(expression, self.q, self.velocity)

    def evaluate_at_base(self, *expressions: SX) -> list[SX]:
        """Return expressions at φ = 0, that is, at the base rotation itself."""
        return list(ca.substitute(list(expressions), [self._phi], [ca.SX.zeros(3)]))
