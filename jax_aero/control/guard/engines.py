"""Detection of engines that do not follow their commands, and of faulty thrust sensors.

    d ← e^{−Δt/τ} d + (T_k − T̂_k)              deviation of a thrust from the commanded one
    l ← e^{−Δt/τ} l + Δt (Ṫ_e − Ṫ*)             that of an engine at the limits of its throttle
    d̄ ← d − [0, λ l] after lags of τ_e and τ_n  the part outside, delayed as the estimated momentum is
    n ← n + (1 − e^{−Δt/τ_n}) (w − ŵ − n)       wrench in the momentum in excess of the observed wrench

A limited engine's last thrust bounds its commands from then on. Equations M105, M106 and M144 of `docs/model`.
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
from jax_aero.jets import Engines, engines, nearest_rate
from jax_aero.robot import RobotModel
from jax_aero.types import Array, leaf, leaves, pytree, where

FORCE_ARM = 0.04
"""Lever arm that makes a force comparable with a moment [m]: that of the air that no model contains. Gyroscopes are
less noisy than velocities, and aerodynamic forces change more than their moments."""


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
    models: Engines
    """What the engine of each jet can follow."""
    descent: Descent | None
    """Control law after the loss of an engine; `None` to keep the usual one."""


class EngineState(NamedTuple):
    """State of the detection for all engines."""

    deviation: Float[Array, " j"]
    """`d` [N]."""
    rate: Float[Array, " j"]
    """Thrust rates of engines that follow the commands at the limits of their throttles, `Ṫ_e` [N/s]."""
    lag: Float[Array, " j"]
    """`l` [N]."""
    fit: Float[Array, "2 j"]
    """`Σ d l` and `Σ l²`, which give `λ` [N²]."""
    estimated: Float[Array, "2 j"]
    """The part of `d` outside `[0, λ l]` after the first lag, as late as the momentum's force and as its moment [N]."""
    late: Float[Array, "2 j"]
    """The same after both lags, `d̄` [N]."""
    is_doubted: Bool[Array, " j"]
    """Whether that part exceeds half of its limit: the thrust may not be the one that is used."""
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
        models=engines(robot, robot.jets.engines),
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
    pair = jnp.stack([none, none])
    return EngineState(none, none, none, pair, pair, pair, none > 0.0, none, none, jnp.full_like(like, jnp.inf))


def update(
    limits: EngineLimits,
    last: EngineState,
    dt: Float[Array, ""],
    thrust: Float[Array, " j"],
    innovation: Float[Array, " j"],
    command: Float[Array, " j"],
    is_measured: Bool[Array, ""],
    a_t: Float[Array, "6 j"],
    residual: Float[Array, "6"],
    has_momentum: Bool[Array, ""],
    momentum_shares: Float[Array, "2"],
) -> tuple[EngineState, Bool[Array, " j"], Float[Array, " j"]]:
    """Process thrusts and their innovations [N] under the last commanded rates [N/s].

    Returns the new state, which sensors are faulty, and the deviations `d` before their reset [N].

    `is_measured` says whether all thrusts are measured; otherwise how engines follow their commands is not learnt.
    `a_t` maps thrusts to the momentum rate; `residual` is the `n` above [N, N m]. `momentum_shares` are the shares of a
    change of force and moment that the estimated momentum follows per tick, 1 if it is measured. Without momentum
    nothing is judged, and lags and confirmation restart. Several thrusts that deviate at once are wrong sensors or
    failing engines together.
    """
    kept, half = jnp.exp(-dt / limits.time_constant), 0.5 * limits.deviation_max
    rate = nearest_rate(limits.models, thrust, last.rate, command, dt)
    deviation = kept * last.deviation + innovation
    lag = kept * last.lag + dt * (0.5 * (last.rate + rate) - command)
    # A deviation that may be a fault teaches nothing.
    is_learnt = is_measured & (jnp.abs(deviation) <= half)
    fit = last.fit + jnp.where(is_learnt[None], jnp.stack([deviation * lag, lag * lag]), 0.0)
    follows = lag * jnp.clip((half**2 + fit[0]) / (half**2 + fit[1]), 0.0, 1.0)
    outside = deviation - jnp.clip(deviation, jnp.minimum(follows, 0.0), jnp.maximum(follows, 0.0))
    estimated = last.estimated + momentum_shares[:, None] * (outside[None] - last.estimated)
    late = last.late + residual_share(dt) * (estimated - last.late)
    estimated, late = jnp.where(has_momentum, estimated, 0.0), jnp.where(has_momentum, late, 0.0)
    found = late[1]
    exceeds = jnp.abs(found) > limits.deviation_max
    suspected = jnp.where(exceeds, last.suspected + dt, 0.0)
    # Half a tick allows for rounding.
    is_sure = exceeds & (suspected >= limits.confirmation + 0.5 * dt)
    is_suspect = ~last.is_limited & (jnp.abs(found) > half)
    of_sensors = jnp.sum(a_t * jnp.repeat(jnp.where(is_suspect[None], late, 0.0), 3, axis=0), axis=1)
    is_wrong = is_suspect & jnp.any(is_sure) & (_square(residual + of_sensors) < _square(residual))
    is_short, is_stuck = (is_sure & ~is_wrong & (sign * found > 0.0) for sign in (-1.0, 1.0))
    least = jnp.where(is_stuck, thrust, jnp.where(is_short, jnp.minimum(last.least, thrust), last.least))
    greatest = jnp.where(is_short, thrust, jnp.where(is_stuck, jnp.maximum(last.greatest, thrust), last.greatest))
    # A rejected sensor gives no information about its engine.
    is_doubted = (jnp.abs(outside) > half) & ~is_wrong
    state = EngineState(deviation, rate, lag, fit, estimated, late, is_doubted, suspected, least, greatest)
    known = {name: getattr(state, name) for name in _OF_SENSOR}
    forgotten = {name: jnp.where(jnp.broadcast_to(is_wrong, x.shape), 0.0, x) for name, x in known.items()}
    return state._replace(**forgotten), is_wrong, deviation


_OF_SENSOR = ("deviation", "rate", "lag", "fit", "estimated", "late", "suspected")


def _square(wrench: Float[Array, "6"]) -> Float[Array, ""]:
    return FORCE_ARM**2 * jnp.sum(wrench[:3] ** 2) + jnp.sum(wrench[3:] ** 2)


def limit(settings: EngineLimits, engines: EngineState, usual: Limits) -> tuple[Limits, Bool[Array, ""]]:
    """Return the limits of the law, and whether an engine is lost.

    Of a limited engine the law may use the thrusts that it reaches, so that the others take over its share; after the
    loss of an engine the limits are those of the descent.
    """
    greatest = jnp.minimum(engines.greatest, usual.thrust_greatest)
    least = jnp.minimum(jnp.maximum(engines.least, usual.thrust_least), greatest)
    limits = usual._replace(thrust_least=least, thrust_greatest=greatest)
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
