"""The momentum balance and its derivative along the motion.

    L̇ = Σ_i T_i (a_i ; r_i × a_i) + Σ_j (f_j ; r_j × f_j) − m g e₃    r: arm from the centre of mass

Differentiation along q̇ gives M50 to M52 of `docs/model`: A_T from the change of the thrusts, Λ_T from the change of
the jets' positions and directions, and Λ_a from the change of the points at which the link forces act, with the forces
held constant. The change of the link forces themselves is neglected.

Equations M9, M18, M27 and M56 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from jax_aero.symbolic.aero import link_force
from jax_aero.symbolic.dynamics import Dynamics
from jax_aero.symbolic.kinematics import Kinematics
from jax_aero.symbolic.robot import Array, Robot
from jax_aero.symbolic.spatial import SX


class Terms(NamedTuple):
    """Every term of one state, inertial axes; n = 6 + joints, momenta with linear part first."""

    com_position: Array
    """(3,) [m]."""
    mass_matrix: Array
    """(n, n) M of M ν̇ + h = S τ + Σ Jᵀ f."""
    bias: Array
    """(n,) h: Coriolis, centrifugal, gravity."""
    momentum_matrix: Array
    """(6, n) A_G."""
    momentum: Array
    """(6,) L = A_G ν."""
    centroidal_inertia: Array
    """(3, 3) [kg m²]."""
    aero_force: Array
    """(links, 3) force on each link [N]."""
    aero_generalised: Array
    """(n,) Σ J_aᵀ f_a."""
    jet_generalised: Array
    """(n,) Σ Jᵀ T a."""
    a_t: Array
    """(6, jets) momentum rate per thrust."""
    lambda_t: Array
    """(6, n) Λ_T."""
    lambda_a: Array
    """(6, n) Λ_a."""
    momentum_rate: Array
    """(6,) L̇ [N, N m]."""


class MomentumModel:
    """Expressions of one robot with one aerodynamic model, compiled to functions on first use."""

    def __init__(self, robot: Robot, aero: Mapping[str, Any]) -> None:
        self.robot = robot
        self.tree = tree = Kinematics(robot)
        self.dynamics = Dynamics(tree)
        self.thrust = ca.SX.sym("T", len(robot.jets))
        self.wind = ca.SX.sym("w", 3)
        model = link_force(aero, robot)

        self.jet_points = [tree.bodies[jet.body].point(jet.position) for jet in robot.jets]
        self.jet_axes = [tree.bodies[jet.body].direction(jet.axis) for jet in robot.jets]
        self.link_points = [tree.bodies[link.body].point(link.centre) for link in robot.aero_links]
        self.link_axes = [tree.bodies[link.body].direction(link.axis) for link in robot.aero_links]
        velocities = tree.rate(ca.vertcat(ca.SX(0, 1), *self.link_points))
        self.link_forces = [
            model(i, axis, velocities[3 * i : 3 * i + 3] - self.wind) for i, axis in enumerate(self.link_axes)
        ]
        # Symbols that replace the link forces where these are held constant.
        self._held = ca.SX.sym("f", 3, len(robot.aero_links))
        self._forces = ca.horzcat(ca.SX(3, 0), *self.link_forces)

        com = self.dynamics.com
        jets = zip(ca.vertsplit(self.thrust), robot.jets, self.jet_points, self.jet_axes, strict=True)
        held = zip(ca.horzsplit(self._held), self.link_points, strict=True)
        wrenches = (t * _wrench(a, p - com, jet.torque_to_thrust * a) for t, jet, p, a in jets)
        self._jet_wrench = sum(wrenches, ca.SX.zeros(6))
        self._held_wrench = sum((_wrench(f, p - com) for f, p in held), ca.SX.zeros(6))
        self.link_wrench = self._with_forces(self._held_wrench)
        self.momentum_rate = self._jet_wrench + self.link_wrench
        self.momentum_rate[2] -= robot.mass * robot.gravity

    def _with_forces(self, expression: SX) -> SX:
        """Substitute the link forces for their symbols."""
        return ca.substitute(expression, self._held, self._forces)

    def generalised_forces(self) -> tuple[SX, SX]:
        """Return Σ Jᵀ f of the jets and of the link forces, as gradients of the work of constant forces.

        A couple c on a body is the sum of the forces `c × x / 2` at the ends of its three unit vectors x.
        """
        tree = self.tree
        forces, points = [], []
        jets = zip(ca.vertsplit(self.thrust), self.robot.jets, self.jet_axes, self.jet_points, strict=True)
        for thrust, thruster, axis, point in jets:
            units = [tree.bodies[thruster.body].direction(unit) for unit in np.eye(3)]
            couple = thruster.torque_to_thrust * thrust * axis
            forces += [thrust * axis, *(ca.cross(couple, unit) / 2 for unit in units)]
            points += [point, *units]
        constant = ca.SX.sym("f", 3, len(forces))
        jet_work = sum((ca.dot(f, p) for f, p in zip(ca.horzsplit(constant), points, strict=True)), ca.SX(0))
        jet = ca.substitute(ca.gradient(jet_work, tree.q), constant, ca.horzcat(ca.SX(3, 0), *forces))
        held = zip(ca.horzsplit(self._held), self.link_points, strict=True)
        link_work = sum((ca.dot(f, p) for f, p in held), ca.SX(0))
        return jet, self._with_forces(ca.gradient(link_work, tree.q))

    @property
    def inputs(self) -> list[SX]:
        """State, thrusts and wind: the first arguments of every function of a state."""
        tree = self.tree
        return [tree.base_position, tree.base_rotation, tree.joint_position, tree.velocity, self.thrust, self.wind]

    def function(self, name: str, outputs: Sequence[SX], extra: Sequence[SX] = ()) -> Any:
        """Return the function of `inputs` and `extra` with these outputs."""
        return ca.Function(name, [*self.inputs, *extra], self.tree.evaluate_at_base(*outputs))

    def terms(
        self,
        base_position: ArrayLike,
        base_rotation: ArrayLike,
        joint_position: ArrayLike,
        velocity: ArrayLike,
        thrust: ArrayLike,
        wind: ArrayLike,
    ) -> Terms:
        """Return every term at one state; arguments as in `docs/reference.md`."""
        values = self._terms(base_position, base_rotation, joint_position, velocity, thrust, wind)
        flat = {0, 2, 4, 7, 8, 12}
        arrays = [np.array(value.full()) for value in values]
        return Terms(*(value[:, 0] if index in flat else value for index, value in enumerate(arrays)))

    @cached_property
    def _terms(self) -> Any:
        d, tree = self.dynamics, self.tree
        jet_generalised, aero_generalised = self.generalised_forces()
        outputs = [
            d.com,
            d.mass_matrix,
            d.bias,
            d.momentum_matrix,
            d.momentum,
            d.centroidal_inertia,
            self._forces.T,
            aero_generalised,
            jet_generalised,
            ca.jacobian(self._jet_wrench, self.thrust),
            ca.jacobian(self._jet_wrench, tree.q),
            self._with_forces(ca.jacobian(self._held_wrench, tree.q)),
            self.momentum_rate,
        ]
        return self.function("terms", outputs)


def _wrench(force: SX, arm: SX, couple: SX | float = 0.0) -> SX:
    return ca.vertcat(force, ca.cross(arm, force) + couple)
