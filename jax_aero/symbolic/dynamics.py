"""Energy and momentum of the tree, and the terms derived from them by differentiation.

Equations M10 to M14 of `docs/model`.
"""

from __future__ import annotations

import casadi as ca

from jax_aero.symbolic.kinematics import Kinematics


class Dynamics:
    """Lagrange's equations and the centroidal momentum of the tree.

    A body is a cloud of points r = p + R ρ with mass m, centre p and scatter E = ∫ ρ ρᵀ dm. Summing over the cloud,

        kinetic energy      ½ m |ṗ|² + ½ tr(Ṙ E Ṙᵀ)
        potential energy    m g p_z
        angular momentum    m (p − p_G) × ṗ + axial(Ṙ E Rᵀ)     about the centre of mass p_G

    so neither angular velocities nor inertia tensors appear. Then, with q̇ = ν at the point of evaluation,

        M = ∂²T/∂q̇²,    h = ∂²T/∂q̇∂q q̇ − ∂T/∂q + ∂V/∂q,    A_G = ∂(l, k)/∂q̇

    `momentum`, `kinetic` and `potential` are expressions with symbolic φ; the other attributes are at φ = 0.
    """

    def __init__(self, tree: Kinematics) -> None:
        robot = tree.robot
        centres = [pose.point(body.centre) for pose, body in zip(tree.bodies, robot.bodies, strict=True)]
        turns = [pose.rotation for pose in tree.bodies]
        # All rates in one pass through the tree.
        rates = tree.rate(ca.vertcat(*centres, *(ca.vec(turn) for turn in turns)))
        count = len(centres)
        centre_rates = [rates[3 * i : 3 * i + 3] for i in range(count)]
        turn_rates = [ca.reshape(rates[3 * count + 9 * i : 3 * count + 9 * i + 9], 3, 3) for i in range(count)]

        mass = robot.mass
        self.com = sum((body.mass * c for body, c in zip(robot.bodies, centres, strict=True)), ca.SX(3, 1)) / mass
        linear, angular, scatter = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3, 3)
        kinetic = ca.SX(0)
        for body, centre, turn, v, turn_rate in zip(
            robot.bodies, centres, turns, centre_rates, turn_rates, strict=True
        ):
            carried = ca.mtimes(turn_rate, ca.DM(body.scatter))
            kinetic += 0.5 * body.mass * ca.dot(v, v) + 0.5 * ca.trace(ca.mtimes(carried, turn_rate.T))
            linear += body.mass * v
            arm = centre - self.com
            scatter += body.mass * ca.mtimes(arm, arm.T) + ca.mtimes([turn, ca.DM(body.scatter), turn.T])
            # The angular momentum Σ r × ṙ of points with Σ ṙ rᵀ = A is the axial vector of A − Aᵀ.
            angular += body.mass * ca.cross(arm, v) + 2 * ca.inv_skew(ca.mtimes(carried, turn.T))
        self.kinetic = kinetic
        self.potential = mass * robot.gravity * self.com[2]
        self.momentum = ca.vertcat(linear, angular)
        # For a common rotation of all points, ∫ r × (ω × r) dm = (tr(P) 1 − P) ω with P = ∫ r rᵀ dm.
        self.locked_inertia = ca.trace(scatter) * ca.SX.eye(3) - scatter

        q, nu = tree.q, tree.velocity
        mass_matrix, impulse = ca.hessian(kinetic, nu)
        bias = ca.jtimes(impulse, q, nu) - ca.gradient(kinetic, q) + ca.gradient(self.potential, q)
        momentum_matrix = ca.jacobian(self.momentum, nu)
        self.mass_matrix, self.bias, self.momentum_matrix = tree.evaluate_at_base(mass_matrix, bias, momentum_matrix)
        self.centroidal_inertia = self.momentum_matrix[3:, 3:6]
