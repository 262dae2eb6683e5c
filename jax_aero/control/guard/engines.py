"""Detection of engines that do not follow their commands, and of faulty thrust sensors.

    d ← e^{−Δt/τ} d + (T_k − T̂_k)          deviation of a thrust from the commanded one
    d̄ ← d after lags of τ_e and τ_n         the same, delayed as the estimated momentum is
    n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)   wrench in the momentum in excess of the observed wrench

A limited engine's last thrust bounds its commands from then on. Equations M105 and M106 of `docs/model.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.config import EnginesConfig
from jax_aero.control.guard.observer import residual_share
from jax_aero.control.law.attitude import MomentumGains
from jax_aero.control.law.limits import Limits
from jax_aero.control.law.tasks import choose_limits
from jax_aero.robot import RobotModel
from jax_aero.types import Array, leaf, leaves, pytree, where

LEAST_ARM = 0.01
"""Least lever arm about the centre of mass for judging a jet's sensor [m]: there a deviation of 10 N has a moment of
0.1 N m, as large as the noise of the residual."""


@pytree
class Descent:
    """Control law for the descent of a robot that has lost an engine."""

    range_min: Float[Array, " j"]
    """An engine is lost if its greatest and least thrust differ by less than this [N]."""
    momentum: MomentumGains
    """Gains that replace the controller's."""
    joint_velocity_max: Float[Array, " n"]
    """Limit on the velocity of revolute joints whose own limit is lower; zero for other joints [rad/s]."""
    torque_rate_max: Float[Array, " n"]
    """Limit on the torque rate, likewise [N m/s]."""


@pytree
class EngineLimits:
    """Criteria for an engine that does not reach its thrust, and for a lost one."""

    time_constant: Float[Array, ""]
    """`τ` of the deviation [s]."""
    deviation_max: Float[Array, ""]
    """Largest deviation of a healthy engine [N]."""
    confirmation: Float[Array, ""]
    """Time for which the deviation must exceed it [s]."""
    descent: Descent | None
    """Control law after the loss of an engine; `None` to keep the usual one."""


class EngineState(NamedTuple):
    """State of the detection for all engines."""

    deviation: Float[Array, " j"]
    """`d` [N]."""
    estimated: Float[Array, " j"]
    """`d` after the first lag [N]."""
    late: Float[Array, " j"]
    """`d` after both, `d̄` [N]."""
    suspected: Float[Array, " j"]
    """Time for which the deviation has been too large [s]."""
    least: Float[Array, " j"]
    """Least thrust that each engine reaches, as far as detected [N]."""
    greatest: Float[Array, " j"]
    """Greatest thrust that each engine reaches, as far as detected [N]."""

    @property
    def is_limited(self) -> Bool[Array, " j"]:
        """Return which engines do not reach their whole thrust range."""
        return (self.least > 0.0) | (self.greatest < jnp.inf)

    def is_lost(self, descent: Descent) -> Bool[Array, " j"]:
        """Return which engines have too small a thrust range for flight."""
        return self.greatest - self.least < descent.range_min


def engine_limits(config: EnginesConfig, robot: RobotModel) -> EngineLimits:
    """Return the limits of a configuration."""
    none = leaf(np.zeros(robot.n_joints))
    descent = config.descent
    return EngineLimits(
        time_constant=leaf(config.time_constant),
        deviation_max=leaf(config.deviation_max),
        confirmation=leaf(config.confirmation),
        descent=None
        if descent is None
        else Descent(
            range_min=leaf(descent.range_share_min * np.asarray(robot.jets.thrust_max)),
            momentum=leaves(MomentumGains, descent.momentum),
            joint_velocity_max=choose_limits(none, np.deg2rad(descent.joint_velocity_max_deg), robot),
            torque_rate_max=choose_limits(none, descent.torque_rate_max, robot),
        ),
    )


def start(like: Float[Array, " j"]) -> EngineState:
    """Return the initial state for engines with thrusts of this shape and precision [N]."""
    none = jnp.zeros_like(like)
    return EngineState(none, none, none, none, none, jnp.full_like(like, jnp.inf))


def update(
    limits: EngineLimits,
    last: EngineState,
    dt: Float[Array, ""],
    thrust: Float[Array, " j"],
    innovation: Float[Array, " j"],
    a_t: Float[Array, "6 j"],
    residual: Float[Array, "6"],
    has_momentum: Bool[Array, ""],
    momentum_share: Float[Array, ""],
) -> tuple[EngineState, Bool[Array, " j"], Float[Array, " j"]]:
    """Process thrusts and their innovations [N].

    Returns the new state, which sensors are faulty, and the deviations `d` before their reset [N].

    `a_t` maps thrusts to the momentum rate; `residual` is the `n` above [N, N m]. `momentum_share` is the share of a
    change that the estimated momentum follows per tick, 1 if it is measured. Without momentum nothing is judged, and
    lags and confirmation restart. Only moments are compared: gyroscopes are less noisy than velocity estimates, and
    aerodynamic forces change more than their moments.
    """
    deviation = jnp.exp(-dt / limits.time_constant) * last.deviation + innovation
    estimated = last.estimated + momentum_share * (deviation - last.estimated)
    late = last.late + residual_share(dt) * (estimated - last.late)
    estimated, late = jnp.where(has_momentum, estimated, 0.0), jnp.where(has_momentum, late, 0.0)
    exceeds = jnp.abs(late) > limits.deviation_max
    suspected = jnp.where(exceeds, last.suspected + dt, 0.0)
    # Half a tick allows for rounding.
    is_sure = exceeds & (suspected >= limits.confirmation + 0.5 * dt)
    # Multiplied instead of divided as in M106, since a jet may have no moment about the centre of mass.
    moments = a_t[3:]
    arm_squared = jnp.sum(moments**2, axis=0)
    explained = -(moments.T @ residual[3:]) * jnp.sign(late)
    is_known = arm_squared >= LEAST_ARM**2
    is_wrong = is_sure & ~last.is_limited & is_known & (explained > 0.5 * jnp.abs(late) * arm_squared)
    is_short, is_stuck = (is_sure & ~is_wrong & (sign * late > 0.0) for sign in (-1.0, 1.0))
    least = jnp.where(is_stuck, thrust, jnp.where(is_short, jnp.minimum(last.least, thrust), last.least))
    greatest = jnp.where(is_short, thrust, jnp.where(is_stuck, jnp.maximum(last.greatest, thrust), last.greatest))
    # A rejected sensor gives no information about its engine.
    deviation_left, estimated, late, suspected = (
        jnp.where(is_wrong, 0.0, x) for x in (deviation, estimated, late, suspected)
    )
    after = EngineState(deviation_left, estimated, late, suspected, least, greatest)
    return after, is_wrong, deviation


def limit(settings: EngineLimits, engines: EngineState, usual: Limits) -> tuple[Limits, Bool[Array, ""]]:
    """Return the limits of the law, and whether an engine is lost.

    Of a limited engine the law may use the thrusts that it reaches, so that the others take over its share; after the
    loss of an engine the limits are those of the descent.
    """
    greatest = jnp.minimum(engines.greatest, usual.thrust_greatest)
    limits = usual._replace(thrust_least=jnp.minimum(engines.least, greatest), thrust_greatest=greatest)
    descent = settings.descent
    if descent is None:
        return limits, jnp.array(False)
    is_lost = jnp.any(engines.is_lost(descent))
    descending = limits._replace(
        gains=descent.momentum,
        holds_position=jnp.array(False),
        joint_velocity=jnp.maximum(usual.joint_velocity, descent.joint_velocity_max),
        torque_rate=jnp.maximum(usual.torque_rate, descent.torque_rate_max),
    )
    return where(is_lost, descending, limits), is_lost
