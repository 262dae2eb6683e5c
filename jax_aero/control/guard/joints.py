"""Detection of joints that do not follow their torques: stuck, weak, free.

    e = (ν_k − ν_{k−1}) / Δt − ν̇_{k−1}          acceleration of the joints that the model does not explain
    ē ← e after a lag of τ_e,  m ← e after a lag of τ_m,  x = ē − m
    z_j = g_jᵀ x / |g_j|                       its part along G's column g_j: what a torque of joint j causes

A faulty joint causes `x` along one column; errors of the model accelerate several joints at once, and a push changes
the momentum. The regression of the unexplained torque on the commanded one gives the share of the torque that acts. A
stuck joint does not move while it is commanded to. Equation M143 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.types import Array, pytree

LAG, MEAN_LAG, LEVEL_LAG, WINDOW = 0.02, 0.3, 1.0, 0.3
"""Lags of the unexplained acceleration, of its mean and of `z²`; time in which displacements are forgotten [s]."""
LEVELS = 4.0
"""How often the root of the mean of `z²` a suspicion has to be."""
SETTLING, PAUSE = 2.0, 0.2
"""Time without judgement after the start, and after something was found [s]."""
DOMINANCE, STUCK_DOMINANCE = 0.75, 0.5
"""Share of `|x|²` that is along one column if one joint causes it, and for a joint that stands still too."""
STUCK_SHARE, STILL, STILL_WAY = 0.4, 0.1, 0.004
"""Share of `acceleration_max` that a stuck joint has at least; share of its commanded displacement that it moves."""
STOP_MARGIN, STOP_CONFIRMATION = 0.087, 0.3
"""Distance from a stop within which a joint may be at it [rad, m], and how long it has to stand still there [s]."""
CONFIRMATION, STUCK_CONFIRMATION, REVISION, SUSPICION_MAX = 0.06, 0.03, 0.1, 0.2
"""Times until something is found, and until a suspicion is an error of the model [s]."""
FREE_SHARE, HEALTHY_SHARE = 0.15, 0.85
"""A joint with less of its torque is free, and one with more is as it should be."""
MOVED, RELEASED = 0.002, 0.02
"""Displacements of a joint that is not stuck, and of one that moves again [rad, m]."""
PUSH_SHARE = 0.05
"""Share of the observer's greatest moment that its residual has in a push, and beyond which nothing is judged."""
TRIED_VELOCITY = 0.02
"""Velocity with which a stuck joint is tried [rad/s, m/s]."""


@pytree
class JointLimits:
    """When a joint counts as stuck, weak or free."""

    acceleration_max: Float[Array, ""]
    """Greatest unexplained acceleration in the direction of one joint's torque [rad/s²]."""
    share_max: Float[Array, ""]
    """Greatest share of the torque that acts at a weak joint."""
    displacement_min: Float[Array, ""]
    """Least commanded displacement that shows whether a joint is stuck [rad, m]."""


class JointsState(NamedTuple):
    """State of the detection between two ticks."""

    acceleration: Float[Array, " n"]
    """`ē` [rad/s²]."""
    mean: Float[Array, " n"]
    """`m` [rad/s²]."""
    level: Float[Array, " n"]
    """Mean of `z²` of every joint [rad²/s⁴]."""
    position: Float[Array, " n"]
    """Last measured positions [rad, m]."""
    way: Float[Array, " n"]
    """Length of the measured way of every joint [rad, m]."""
    commanded: Float[Array, " n"]
    """Commanded displacement [rad, m]."""
    still: Float[Array, " n"]
    """Time for which the joint has stood still against its command [s]."""
    velocity: Float[Array, " n"]
    """Joint velocities of the last tick [rad/s]."""
    torque: Float[Array, " n"]
    """Torques commanded in the last tick, or those that replaced them [N m]."""
    suspected: Float[Array, " n"]
    """Time since the first tick of the suspicion that its torque may not act; zero without one [s]."""
    evidence: Float[Array, " n"]
    """Time that counts for the judgement [s]."""
    product: Float[Array, " n"]
    """`Σ u τ` of unexplained and commanded torques."""
    square: Float[Array, " n"]
    """`Σ τ²`."""
    begun_at: Float[Array, " n"]
    """Position at the beginning of the suspicion [rad, m]."""
    pause: Float[Array, ""]
    """Time until judgement begins [s]."""
    share: Float[Array, " n"]
    """Share of the torque that acts, as found."""
    is_stuck: Bool[Array, " n"]
    """Which joints are found to be stuck."""
    stuck_at: Float[Array, " n"]
    """Position in which a joint was found to be stuck [rad, m]."""

    @property
    def is_limited(self) -> Bool[Array, " n"]:
        """Return which joints do not follow their torques."""
        return self.is_stuck | (self.share < 1.0)


def start(position: Float[Array, " n"]) -> JointsState:
    """Return the state of a flight that starts in these positions [rad, m]."""
    none = jnp.zeros_like(position)
    return JointsState(
        acceleration=none,
        mean=none,
        level=none,
        position=position,
        way=none,
        commanded=none,
        still=none,
        velocity=none,
        torque=none,
        suspected=none,
        evidence=none,
        product=none,
        square=none,
        begun_at=none,
        pause=jnp.full_like(none, SETTLING, shape=()),
        share=jnp.ones_like(position),
        is_stuck=none > 0.0,
        stuck_at=none,
    )


def begin_again(last: JointsState, position: Float[Array, " n"]) -> JointsState:
    """Return the state of a flight that begins again in these positions [rad, m]; what is found stays."""
    none = jnp.zeros_like(last.mean)
    pause = jnp.full_like(last.pause, SETTLING)
    return hold(last._replace(position=position, way=none, commanded=none, mean=none, level=none, pause=pause))


def measure(
    last: JointsState, position: Float[Array, " n"], is_measured: Bool[Array, ""], dt: Float[Array, ""]
) -> JointsState:
    """Take in the measured positions of a tick [rad, m], `dt` [s] after the last one."""
    left = jnp.exp(-dt / WINDOW)
    moved = jnp.where(is_measured, jnp.abs(position - last.position), 0.0)
    return last._replace(
        way=left * last.way + moved,
        commanded=left * last.commanded,
        position=jnp.where(is_measured, position, last.position),
    )


def hold(last: JointsState) -> JointsState:
    """Forget what is not explained, in a tick in which nothing can be compared, and judge nothing for a while."""
    none, pause = jnp.zeros_like(last.mean), jnp.maximum(last.pause, PAUSE)
    forgotten = last._replace(acceleration=last.mean, still=none, suspected=none, evidence=none)
    return forgotten._replace(product=none, square=none, pause=pause)


def judge(
    limits: JointLimits,
    last: JointsState,
    dt: Float[Array, ""],
    unexplained: Float[Array, " n"],
    gain: Float[Array, "n n"],
    stops: Float[Array, "n 2"],
) -> JointsState:
    """Compare a tick with the last one.

    `unexplained` is `e` [rad/s²], `gain` is `G` [1/(kg m²)], `stops` are the lower and upper ones [rad, m].
    """
    norm = jnp.sqrt(jnp.sum(gain**2, axis=0))
    acceleration = last.acceleration - jnp.expm1(-dt / LAG) * (unexplained - last.acceleration)
    pause = last.pause - dt
    judges = pause < 0.5 * dt  # half a tick absorbs rounding
    x = acceleration - last.mean
    along, size = (gain.T @ x) / norm, x @ x

    z = jnp.abs(along)
    is_known = last.share < 1.0
    # A level of zero has no derivative of its root.
    level = jnp.where(is_known, 0.0, LEVELS**2 * last.level)
    least = jnp.sqrt(jnp.maximum(limits.acceleration_max**2, level))
    suspects = judges & ~last.is_stuck & (z > least) & (z**2 > DOMINANCE * size)
    goes_on = last.suspected > 0.0
    u = gain.T @ (unexplained - last.mean) / norm**2
    begun_at = jnp.where(goes_on, last.begun_at, last.position)
    suspected, evidence = last.suspected + dt, last.evidence + dt * z / least
    product, square = last.product + u * last.torque, last.square + last.torque**2
    is_sure = jnp.where(is_known, suspected > REVISION, goes_on & (evidence > CONFIRMATION))
    has_moved = jnp.abs(last.position - begun_at) > MOVED
    acting = last.share + product / jnp.where(square > 0.0, square, 1.0)
    greatest = jnp.where(is_known, 1.0 + FREE_SHARE, limits.share_max)
    is_share = (square > 0.0) & (acting > -2.0 * FREE_SHARE) & (acting < greatest)
    is_candidate = suspects & is_sure & has_moved & is_share
    is_found = jnp.any(is_candidate)
    worst = jnp.argmax(jnp.where(is_candidate, z, -1.0))
    found = jnp.where(acting < FREE_SHARE, 0.0, jnp.where(acting > HEALTHY_SHARE, 1.0, acting))
    share = jnp.where(is_found, last.share.at[worst].set(found[worst]), last.share)

    lower, upper = stops.T
    above, below = upper - last.position, last.position - lower
    ahead, behind = jnp.where(last.commanded < 0.0, jnp.stack([below, above]), jnp.stack([above, below]))
    with_mean = (gain.T @ acceleration) / norm  # the mean contains what a stop behind the joint carries

    def opposes(z: Array) -> Array:
        return -z * jnp.sign(last.commanded) > STUCK_SHARE * limits.acceleration_max

    is_still = (
        (jnp.abs(last.commanded) > limits.displacement_min)
        & (ahead > STOP_MARGIN)
        & ((behind > STOP_MARGIN) | opposes(with_mean))
        & (last.way < jnp.minimum(STILL_WAY, STILL * jnp.abs(last.commanded)))
        & opposes(along)
        & (along**2 > STUCK_DOMINANCE * size)
        & ~last.is_stuck
        & ~is_found
    )
    still = jnp.where(judges, jnp.where(is_still, last.still + dt, 0.0), last.still)
    confirmation = jnp.where(behind > STOP_MARGIN, STUCK_CONFIRMATION, STOP_CONFIRMATION)
    sticks = judges & (still > confirmation - 0.5 * dt)
    stuck_at = jnp.where(sticks, last.position, last.stuck_at)
    moves = judges & (jnp.abs(last.position - stuck_at) > RELEASED)
    is_suspected = suspects & ~is_found
    is_usual = ~is_suspected | (suspected > SUSPICION_MAX)
    adapts = jnp.all(is_usual)
    squared = jnp.where(is_found, 0.0, z**2)  # what was found leaves nothing unexplained
    level = last.level - jnp.expm1(-dt / LEVEL_LAG) * (squared - last.level)
    return last._replace(
        acceleration=jnp.where(is_found, last.mean, acceleration),
        mean=jnp.where(adapts, last.mean - jnp.expm1(-dt / MEAN_LAG) * (unexplained - last.mean), last.mean),
        level=jnp.where(is_usual, level, last.level),
        still=jnp.where(sticks, 0.0, still),
        suspected=jnp.where(is_suspected, suspected, 0.0),
        evidence=jnp.where(is_suspected, evidence, 0.0),
        product=jnp.where(is_suspected, product, 0.0),
        square=jnp.where(is_suspected, square, 0.0),
        begun_at=begun_at,
        pause=jnp.where(is_found, PAUSE, pause),
        share=jnp.where(sticks, 1.0, share),
        is_stuck=(last.is_stuck | sticks) & ~moves,
        stuck_at=stuck_at,
    )
