"""The time from a command to its effect, measured from the response of joints and thrusts.

```text
torques        y = Δ(s_k − 2 s_{k−1} + s_{k−2} − s̈_0 Δt²),    u = Δ(G τ) Δt²
thrust rates   y = T_k − T_{k−1},                              u = Ṫ* Δt
ν, φ ← y, u after lags                J_d = ⟨(ν_k − φ_{k−d})²⟩,   d = −1, 0, 1, … ticks
L_d = Σ_j J_dj / (J_d̂j + σ²)          d̂ = argmin L, with a parabola through its neighbours
```

Equations M164 and M165 of `docs/model`; the Rust crate says why.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from jax_aero.config import EstimatorConfig, LatencyMonitorConfig
from jax_aero.types import Array, Static, leaf, pytree, where

DELAY_MAX, MEMORY, SETTLING, JITTER = 0.25, 3.0, 3.0, 0.1
"""Greatest delay [s]; memory of residuals [s]; filter times after a gap until residuals count; share of a tick by which
the time between two measurements may differ from it."""


class Kind(NamedTuple):
    """What of one kind of command is compared."""

    lags: int
    lag: float
    """Time constant of each [s]."""
    floor: float
    """What a model and a sensor leave unexplained at best [rad, m; N]."""
    deviation_max: float
    """Greatest standard deviation of a known delay [s]."""


TORQUE, THRUST = Kind(3, 0.025, 1e-4, 6e-4), Kind(1, 0.3, 0.1, 4e-3)


@pytree
class LatencyMonitor:
    """Settings of the measurement."""

    greatest: Float[Array, "2"]
    """Greatest differences of torques and thrust rates from what is known [s]."""
    confirmation: Float[Array, ""]
    """Time for which one of them has to be exceeded [s]."""
    known: Float[Array, "2"]
    """Latencies that the controller knows [s]."""
    ages: Float[Array, "2"]
    """Ages of the measured joints, with the mean time after a tick when its torques are given, and of thrusts [s]."""
    time_step: Float[Array, ""]
    """[s]."""
    rest: Float[Array, ""]
    """What is left of the ticks after which a predicted acceleration is measured."""
    lead: Static[int]
    """Whole ticks of that."""
    delays: Static[int]
    """Number of delays, from −1 tick on."""
    waits: Static[tuple[int, int]]
    """Ticks after a gap until residuals count."""


class BankState(NamedTuple):
    """State of the comparison of one kind of command."""

    response: tuple[Float[Array, " c"], ...]
    """Lags of the response."""
    command: tuple[Float[Array, " c"], ...]
    """Lags of the command."""
    last: Float[Array, " c"]
    """`ν` of the last tick."""
    line: Float[Array, "d c"]
    """`φ` of the last ticks, the latest first."""
    square: Float[Array, "d c"]
    """`J`: mean squares."""
    best: Int[Array, ""]
    """Number of the best delay."""
    ticks: Int[Array, ""]
    """Ticks since the last gap."""


class LatencyState(NamedTuple):
    """State of the measurement between two ticks."""

    torque_bank: BankState
    thrust_bank: BankState
    positions: Float[Array, "3 n"]
    """Measured joint positions of the last ticks, the latest first [rad, m]."""
    measured_positions: Int[Array, ""]
    """How many follow each other."""
    thrusts: Float[Array, "2 j"]
    """Measured thrusts, likewise [N]."""
    measured_thrusts: Int[Array, ""]
    free: Float[Array, "k n"]
    """Accelerations without torques of the last ticks, the latest first [rad/s²]."""
    moved: Float[Array, " n"]
    """Second difference of the positions less its part without torques [rad, m]."""
    driven: Float[Array, " n"]
    """Its part by torques as commanded [rad, m]."""
    torque: Float[Array, " n"]
    """Torques commanded in the last tick, or those that replaced them [N m]."""
    exceeded: Float[Array, "2"]
    """Time for which each differs from what is known [s]."""
    measured: Float[Array, "2"]
    """Latency of torques and thrust rates as measured; NaN while it is not known [s]."""


def latency_monitor(
    config: LatencyMonitorConfig, estimates: EstimatorConfig | None, torque_steps: int, time_step: float
) -> LatencyMonitor:
    """Return the settings for ticks every `time_step` [s], with so many torques in each, beside this estimator."""
    known = (0.0, 0.0) if estimates is None else (estimates.latency.torque, estimates.latency.thrust)
    ages = (0.0, 0.0) if estimates is None else (estimates.joint_position.delay, estimates.thrust.delay)
    lead = round((known[0] + ages[0]) / time_step * 1e6) / 1e6  # decimal fractions are not exact
    delays = math.ceil(DELAY_MAX / time_step) + 2
    waits = tuple(delays + math.ceil(SETTLING * kind.lags * kind.lag / time_step) for kind in (TORQUE, THRUST))
    return LatencyMonitor(
        greatest=leaf([config.torque_max, config.thrust_max]),
        confirmation=leaf(config.confirmation),
        known=leaf(known),
        # The mean of several torques is compared, which are given after the tick.
        ages=leaf([ages[0] + 0.5 * time_step * (1.0 - 1.0 / torque_steps), ages[1]]),
        time_step=leaf(time_step),
        rest=leaf(lead - math.floor(lead)),
        lead=math.floor(lead),
        delays=delays,
        waits=(waits[0], waits[1]),
    )


def start(settings: LatencyMonitor, position: Float[Array, " n"], thrust: Float[Array, " j"]) -> LatencyState:
    """Return the state of a flight that begins."""
    none, no_jets, zero = jnp.zeros_like(position), jnp.zeros_like(thrust), jnp.array(0)

    def bank(kind: Kind, like: Array) -> BankState:
        lags, line = (like,) * kind.lags, jnp.zeros((settings.delays, *like.shape), like.dtype)
        return BankState(lags, lags, like, line, line, jnp.array(1), zero)

    return LatencyState(
        torque_bank=bank(TORQUE, none),
        thrust_bank=bank(THRUST, no_jets),
        positions=jnp.stack([none] * 3),
        measured_positions=zero,
        thrusts=jnp.stack([no_jets] * 2),
        measured_thrusts=zero,
        free=jnp.stack([none] * (settings.lead + 2)),
        moved=none,
        driven=none,
        torque=none,
        exceeded=jnp.zeros(2, none.dtype),
        measured=jnp.full(2, jnp.nan, none.dtype),
    )


def measure(
    settings: LatencyMonitor,
    last: LatencyState,
    position: Float[Array, " n"],
    thrust: Float[Array, " j"],
    are_measured: tuple[Bool[Array, ""], Bool[Array, ""]],
    elapsed: Float[Array, ""],
) -> LatencyState:
    """Take in what a tick measures, `elapsed` [s] after the last one."""
    is_next = jnp.abs(elapsed - settings.time_step) < JITTER * settings.time_step

    def count(before: Array, is_measured: Array) -> Array:
        return jnp.where(is_measured, jnp.where(is_next, before + 1, 1), 0)

    def push(line: Array, now: Array, is_measured: Array) -> Array:
        return jnp.where(is_measured, jnp.concatenate([now[None], line[:-1]]), line)

    return last._replace(
        positions=push(last.positions, position, are_measured[0]),
        measured_positions=count(last.measured_positions, are_measured[0]),
        thrusts=push(last.thrusts, thrust, are_measured[1]),
        measured_thrusts=count(last.measured_thrusts, are_measured[1]),
    )


def compare(
    settings: LatencyMonitor,
    last: LatencyState,
    acceleration: Float[Array, " n"],
    by_torque: Float[Array, " n"],
    thrust_rate: Float[Array, " j"],
    is_torque_comparable: Bool[Array, ""],
    elapsed: Float[Array, ""],
) -> tuple[LatencyState, Bool[Array, ""]]:
    """Compare a tick with the commands before it; return also whether commands are late, or earlier than is known.

    `acceleration` is what is predicted under the command of the last tick, `by_torque` its part `G τ` [rad/s²],
    `thrust_rate` was commanded [N/s].
    """
    h, lead, rest = settings.time_step, settings.lead, settings.rest
    free = jnp.concatenate([(acceleration - by_torque)[None], last.free[:-1]])
    now, before, first = last.positions
    moved = now - 2.0 * before + first - h**2 * ((1.0 - rest) * free[lead] + rest * free[lead + 1])
    driven = h**2 * by_torque
    is_usable = is_torque_comparable & (last.measured_positions > 2) & jnp.all(jnp.isfinite(free[0]))
    torques, torque = _update(
        settings, TORQUE, settings.waits[0], last.torque_bank, moved - last.moved, driven - last.driven, is_usable
    )
    turned, is_thrust_usable = last.thrusts[0] - last.thrusts[1], last.measured_thrusts > 1
    thrusts, thrust = _update(
        settings, THRUST, settings.waits[1], last.thrust_bank, turned, h * thrust_rate, is_thrust_usable
    )
    measured = jnp.stack([torque, thrust]) - settings.ages
    differs = jnp.abs(measured - settings.known) > settings.greatest  # false where it is not known
    exceeded = jnp.where(differs, last.exceeded + elapsed, 0.0)
    state = last._replace(
        torque_bank=torques,
        thrust_bank=thrusts,
        free=free,
        moved=jnp.where(is_usable, moved, last.moved),
        driven=jnp.where(is_usable, driven, last.driven),
        exceeded=exceeded,
        measured=measured,
    )
    return state, jnp.any(exceeded > settings.confirmation)


def _update(
    settings: LatencyMonitor,
    kind: Kind,
    wait: int,
    last: BankState,
    response: Float[Array, " n"],
    command: Float[Array, " n"],
    is_usable: Bool[Array, ""],
) -> tuple[BankState, Float[Array, ""]]:
    """Take in the response of the last tick and its command; return also the delay [s]."""
    h = settings.time_step
    pole, share = jnp.exp(-h / kind.lag), -jnp.expm1(-h / MEMORY)

    def lag(lags: tuple[Array, ...], value: Array) -> tuple[Array, ...]:
        after = []
        for before in lags:
            value = value + pole * before
            after.append(value)
        return tuple(after)

    responses, commands = lag(last.response, response), lag(last.command, command)
    line = jnp.concatenate([commands[-1][None], last.line[:-1]])
    residual = last.last[None] - line
    square = jnp.where(last.ticks >= wait, last.square + share * (residual**2 - last.square), last.square)
    sums = _sums(kind, square, last.best)
    after = BankState(responses, commands, responses[-1], line, square, jnp.argmin(sums), last.ticks + 1)
    gap = last._replace(
        response=tuple(jnp.zeros_like(x) for x in last.response),
        command=tuple(jnp.zeros_like(x) for x in last.command),
        last=jnp.zeros_like(last.last),
        line=jnp.zeros_like(last.line),
        ticks=jnp.zeros_like(last.ticks),
    )
    state = where(is_usable, after, gap)
    return state, _delay(settings, kind, state)


def _sums(kind: Kind, square: Float[Array, "d n"], weights: Int[Array, ""]) -> Float[Array, " d"]:
    """Return `L` of every delay, with the weights of one."""
    return jnp.sum(square / (square[weights][None] + kind.floor**2), axis=1)


def _delay(settings: LatencyMonitor, kind: Kind, state: BankState) -> Float[Array, ""]:
    """Return the measured delay; NaN while it is not known [s]."""
    h, inner = settings.time_step, jnp.clip(state.best, 1, settings.delays - 2)
    sums = _sums(kind, state.square, state.best)
    before, at, after = sums[inner - 1], sums[inner], sums[inner + 1]
    curvature = before - 2.0 * at + after
    is_known = (inner == state.best) & (curvature * MEMORY / h * kind.deviation_max**2 > h**2)
    delay = h * (inner.astype(h.dtype) - 1.0 + 0.5 * (before - after) / jnp.where(is_known, curvature, 1.0))
    return jnp.where(is_known, delay, jnp.nan)
