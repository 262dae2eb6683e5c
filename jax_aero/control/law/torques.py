"""From commanded joint velocities to torques, by the torque QP and a rate limiter.

This file has the integral of M68 of `docs/model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.control import qp
from jax_aero.control.command import MOMENTUM_HELD
from jax_aero.control.law.limits import Limits
from jax_aero.control.law.rates import Rates
from jax_aero.control.law.torque import TorqueParams, TorqueQp, commanded, limit_rate, torque_qp, torque_qp_again
from jax_aero.control.measurement import UsedMeasurement
from jax_aero.control.qp import QpAnswer
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.types import Array

INTEGRAL_LIMIT = 20.0
"""Saturation of the published integrator of the joint velocity error [rad]; no flight comes near it."""


class Torque(NamedTuple):
    """Output of the torque law."""

    torque_qp: TorqueQp
    answer: QpAnswer
    is_solved: Bool[Array, ""]
    """Whether the QP has a certified answer."""
    are_solved: Bool[Array, ""]
    """Whether all QPs since the tick of the law, with its own, have certified answers."""
    unlimited_torque: Float[Array, " n"]
    """Torques before the rate limiter [N m]."""
    joint_torque: Float[Array, " n"]
    """Torques after the rate limiter [N m]."""


@dataclass(frozen=True)
class Torques:
    """The torque law of one controller."""

    params: TorqueParams
    torque_max: Float[Array, " n"]
    """Greatest joint torques [N m]."""
    period: Float[Array, ""]
    """Time between two ticks of the torques [s]."""

    def solve(
        self, memory: ControllerState, used: UsedMeasurement, model: Model, limits: Limits, rates: Rates
    ) -> tuple[ControllerState, Torque]:
        """Compute torques with which the joints follow the commanded velocities."""
        velocity_error, integral = used.state.velocity[6:] - rates.joint_velocity, memory.velocity_error_integral
        share = limits.torque_share
        following = torque_qp(
            self.params,
            self.torque_max,
            model.inverse_mass.joint_gain,
            model.free_acceleration[6:],
            velocity_error,
            integral,
            share,
        )
        return self._decide(memory, following, velocity_error, limits, rates.status != MOMENTUM_HELD)

    def solve_again(
        self,
        memory: ControllerState,
        last: TorqueQp,
        velocity_error: Float[Array, " n"],
        limits: Limits,
        were_solved: Bool[Array, ""],
    ) -> tuple[ControllerState, Torque]:
        """Compute them again for other joint velocities, with the model of the last `solve`."""
        integral, share = memory.velocity_error_integral, limits.torque_share
        following = torque_qp_again(self.params, last, velocity_error, integral, share)
        return self._decide(memory, following, velocity_error, limits, were_solved)

    def _decide(
        self, memory: ControllerState, following: TorqueQp, velocity_error: Array, limits: Limits, were_solved: Array
    ) -> tuple[ControllerState, Torque]:
        integral, share = memory.velocity_error_integral, limits.torque_share
        answer = qp.solve(following.problem, memory.torque_start)
        is_solved = answer.status == qp.SOLVED
        target = commanded(following, self.torque_max, share, answer.x)
        # The published rate limiter starts from its first input.
        last = jnp.where(memory.torque_is_known, memory.joint_torque, target)
        limited = limit_rate(last, target, limits.torque_rate * self.period)
        joint_torque = jnp.where(is_solved, limited, memory.joint_torque)
        # Forward Euler: used first, advanced after. Without a commanded velocity there is no error to integrate; with
        # held torques the integral would grow without effect on the torques.
        advanced = jnp.clip(integral + self.period * velocity_error, -INTEGRAL_LIMIT, INTEGRAL_LIMIT)
        are_solved = is_solved & were_solved
        memory = memory._replace(
            velocity_error_integral=jnp.where(are_solved, advanced, integral),
            joint_torque=joint_torque,
            torque_is_known=memory.torque_is_known | is_solved,
            torque_start=answer.warm_start,
        )
        return memory, Torque(following, answer, is_solved, are_solved, target, joint_torque)
