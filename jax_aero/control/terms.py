"""Intermediate values of a tick, in the order in which they are computed."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float

from jax_aero.aero import AeroModel, LinkConventions, generalised_aero_force, link_forces
from jax_aero.body.dynamics import accelerate, dynamics, invert_mass
from jax_aero.body.kinematics import generalised_thrust, kinematics
from jax_aero.body.robot import RobotModel
from jax_aero.control.law.attitude import AttitudeDemand
from jax_aero.control.law.momentum import MomentumModel, momentum_model
from jax_aero.control.law.momentum_qp import MomentumQp
from jax_aero.control.law.torque import TorqueQp
from jax_aero.control.measurement import Measurement
from jax_aero.types import Array, Dynamics, InverseMass, Kinematics, LinkForces, Setpoint


class Terms(NamedTuple):
    """Intermediate values of a tick of the momentum controller."""

    estimates: Measurement
    """Output of the estimators; without estimators the measurement."""
    wind_std: Float[Array, "3"]
    """Standard deviation of the wind in `estimates` [m/s]; zero without an observer of the wind."""
    kinematics: Kinematics
    dynamics: Dynamics
    inverse_mass: InverseMass
    link_forces: LinkForces
    momentum: MomentumModel
    setpoint: Setpoint
    attitude: AttitudeDemand
    momentum_qp: MomentumQp
    torque_qp: TorqueQp
    unlimited_torque: Float[Array, " n"]
    """Torques before the rate limiter [N m]."""
    friction: Float[Array, " n"] | None
    """Friction of the drives that is compensated [N m]; `None` if it is not."""
    residual: tuple[Float[Array, " j"], Float[Array, " n"]] | None
    """Thrust rates [N/s], joint velocities [rad/s] that are added to the law's or replace them; `None` without any."""


class Model(NamedTuple):
    """The part of the terms that depends on the measurement only."""

    kinematics: Kinematics
    dynamics: Dynamics
    inverse_mass: InverseMass
    link_forces: LinkForces
    momentum: MomentumModel
    free_acceleration: Float[Array, " N"]
    """Acceleration without torques, `M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a − h)`."""


def update_model(
    robot: RobotModel,
    aero: AeroModel,
    conventions: LinkConventions,
    rate_feedback: Float[Array, "6"],
    lambda_feedback: bool,
    torque_feedback: bool,
    now: Measurement,
) -> Model:
    """Compute the model; the feedbacks say which of its terms contain the link forces, see `momentum_model`."""
    kin = kinematics(robot, now.state)
    dyn = dynamics(robot, now.state, kin)
    link = link_forces(aero, robot, kin, conventions, now.wind)
    momentum = momentum_model(
        robot, kin, dyn, now.thrust, link, rate_feedback=rate_feedback, lambda_feedback=lambda_feedback
    )
    force = generalised_thrust(robot, kin, now.thrust) - dyn.bias
    if torque_feedback:
        force = force + generalised_aero_force(robot, kin, link, link.jacobian_points)
    inverse_mass = invert_mass(dyn)
    return Model(kin, dyn, inverse_mass, link, momentum, accelerate(inverse_mass, force))
