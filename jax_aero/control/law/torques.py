"""From commanded joint velocities to torques, by the torque QP and a rate limiter.

Compensated friction is `F = f tanh(ṡ* / v)`: of the commanded velocity, since that of a joint that sticks has no sign.

This file has the integral of M68 and the friction of M69 of `docs/model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.control import qp
from jax_aero.control.law.rates import Rates
from jax_aero.control.law.torque import TorqueParams, TorqueQp, limit_rate, torque_qp
from jax_aero.control.qp import QpAnswer
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.rust import MODES
from jax_aero.types import Array, State

INTEGRAL_LIMIT = 20.0
"""Saturation of the published integrator of the joint velocity error [rad]; no flight comes near it."""


SLIP = 0.02
"""Commanded velocity at which three quarters of the friction are compensated [rad/s]."""


class Torque(NamedTuple):
    """Output of the torque law."""

    torque_qp: TorqueQp
    answer: QpAnswer
    is_solved: Bool[Array, ""]
    """Whether the QP has a certified answer."""
    unlimited_torque: Float[Array, " n"]
    """Torques before the rate limiter [N m]."""
    joint_torque: Float[Array, " n"]
    """Torques after the rate limiter [N m]."""
    friction: Float[Array, " n"] | None
    """Friction with which the drives oppose the commanded velocities [N m]; `None` if it is not compensated."""


@dataclass(frozen=True)
class Torques:
    """The torque law of one controller."""

    params: TorqueParams
    friction: Float[Array, " n"] | None
    """Dry friction of the drives [N m]; `None` if it is not compensated."""
    torque_max: Float[Array, " n"]
    """Greatest joint torques [N m]."""
    torque_rate_max: Float[Array, " n"]
    """Greatest torque rates [N m/s]."""
    time_step: Float[Array, ""]
    """[s]."""

    def solve(
        self, memory: ControllerState, state: State, model: Model, rates: Rates
    ) -> tuple[ControllerState, Torque]:
        """Compute torques with which the joints follow the commanded velocities."""
        gain, free = model.inverse_mass.joint_gain, model.free_acceleration[6:]
        friction = None
        if self.friction is not None:
            friction = self.friction * jnp.tanh(rates.joint_velocity / SLIP)
            free = free - gain @ friction
        velocity_error, integral = state.velocity[6:] - rates.joint_velocity, memory.velocity_error_integral
        following = torque_qp(self.params, self.torque_max, gain, free, velocity_error, integral)
        answer = qp.solve(following.problem, memory.torque_start)
        is_solved = answer.status == qp.SOLVED
        # The published rate limiter starts from its first input.
        last = jnp.where(memory.torque_is_known, memory.joint_torque, answer.x)
        limited = limit_rate(last, answer.x, self.torque_rate_max * self.time_step)
        joint_torque = jnp.where(is_solved, limited, memory.joint_torque)
        # Forward Euler: used first, advanced after. Without a commanded velocity there is no error to integrate; with
        # held torques the integral would grow without effect on the torques.
        advanced = jnp.clip(integral + self.time_step * velocity_error, -INTEGRAL_LIMIT, INTEGRAL_LIMIT)
        integrates = is_solved & (rates.modes & MODES["momentum_held"] == 0)
        memory = memory._replace(
            velocity_error_integral=jnp.where(integrates, advanced, integral),
            joint_torque=joint_torque,
            torque_is_known=memory.torque_is_known | is_solved,
            torque_start=answer.warm_start,
        )
        return memory, Torque(following, answer, is_solved, answer.x, joint_torque, friction)
