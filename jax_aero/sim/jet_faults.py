"""Faults of jets: slow response, reduced thrust, a jet that is dead or stuck, a noisy sensor.

    thrust rate command ──delayed──► jets ──limited──► thrust        thrust ──measured──► estimators

They surround any jet dynamics. Faults are numbers, not structure, so flights with different faults share one
compilation. That a jet's force differs from its thrust is `Plant.force_scale`.

Equation M41 of `docs/model`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero import rust
from jax_aero.body.jets import JetDynamics, JetsState
from jax_aero.body.robot import RobotModel
from jax_aero.config import IdealJetsConfig, JetFaultsConfig, JetsConfig
from jax_aero.types import Array, leaf, pytree

MEASUREMENT_STREAM = 1


class FaultState(NamedTuple):
    """State of the faults between two steps."""

    engine: Any
    """Additional state of the jets without faults."""
    command: Float[Array, " j"]
    """Thrust rates that reached the jets last [N/s]."""
    left: Float[Array, ""]
    """Time until the failure [s]; negative after it."""
    held: Float[Array, ""]
    """Thrust of the failing jet at its failure [N]."""
    tick: Int[Array, ""]
    """Number of steps taken."""


@pytree
class FaultyJets:
    """`JetDynamics` of `j` jets with faults; without a fault the numbers have no effect."""

    jets: JetDynamics
    """The jets without faults."""
    lag: Float[Array, ""]
    """Time constant of the response [s]; zero for none."""
    upper: Float[Array, " j"]
    """Greatest thrust [N]."""
    fails: Bool[Array, " j"]
    """Whether the jet is the failing one."""
    failure_time: Float[Array, ""]
    """Time of the failure [s]."""
    decay: Float[Array, ""]
    """Time constant of the decay [s]; zero for at once."""
    is_stuck: Bool[Array, ""]
    """Whether the failing jet keeps its thrust; otherwise it decays."""
    sensor_noise: Float[Array, "ticks j"] | None
    """Noise on the thrust measured for estimators [N]; `None` without estimators."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Return the state at `thrust` [N] with thrust rate zero."""
        state, rest = self.jets.start(thrust), jnp.zeros_like(thrust)
        left, tick = jnp.asarray(self.failure_time), jnp.array(0, jnp.int32)
        return state._replace(engine=FaultState(state.engine, rest, left, rest[0], tick))

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Return the thrust that the flight controller receives [N]."""
        return self.jets.feedback(state._replace(engine=state.engine.engine))

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
        measured: Float[Array, " j"] | None = None,
    ) -> JetsState:
        """Advance every jet by `dt` [s] under constant commanded thrust rates [N/s]."""
        faults: FaultState = state.engine
        seen = measure_thrust(self, faults, state.thrust if measured is None else measured)
        arriving = delay_rates(self, faults, command, dt)
        jets = self.jets.advance(state._replace(engine=faults.engine), arriving, dt, seen)
        thrust, thrust_rate, faults = limit_thrust(self, faults, jets.thrust, jets.thrust_rate, dt)
        return JetsState(thrust, thrust_rate, faults._replace(engine=jets.engine, command=arriving))


def faulty_jets(
    jets: JetDynamics, settings: JetFaultsConfig, dynamics: JetsConfig, robot: RobotModel, n_ticks: int
) -> FaultyJets:
    """Return jets with the faults of a flight of `n_ticks` ticks; the crate has checked them."""
    names, failure = robot.jets.names, settings.failure
    thrust_max, zero = jnp.asarray(robot.jets.thrust_max), jnp.zeros(())
    scale = settings.thrust_limit_scale
    drawn: Array | None = None
    if not isinstance(dynamics, IdealJetsConfig):
        drawn = _sensor_noise(settings, n_ticks, len(names))
    return FaultyJets(
        jets=jets,
        lag=leaf(settings.lag),
        upper=jnp.full(thrust_max.shape, np.inf) if scale is None else scale * thrust_max,
        fails=jnp.array([failure is not None and name == failure.jet for name in names]),
        failure_time=zero if failure is None else leaf(failure.time),
        decay=zero if failure is None else leaf(failure.decay),
        is_stuck=jnp.array(failure is not None and failure.kind == "stuck"),
        sensor_noise=drawn,
    )


def _sensor_noise(settings: JetFaultsConfig, n_ticks: int, jets: int) -> Array:
    """Return the noise (ticks, jets) [N], drawn once per tick for each jet in order."""
    found = settings.measurement_noise
    if found is None:
        return jnp.zeros((n_ticks + 1, jets))
    drawn = rust.normals(found.seed, MEASUREMENT_STREAM, (n_ticks + 1) * jets)
    return jnp.asarray(found.std) * drawn.reshape(-1, jets)


def measure_thrust(faults: FaultyJets, state: FaultState, thrust: Float[Array, " j"]) -> Float[Array, " j"]:
    """Return the thrusts measured for the estimators [N]."""
    if faults.sensor_noise is None:
        return thrust
    return thrust + faults.sensor_noise[jnp.minimum(state.tick, faults.sensor_noise.shape[0] - 1)]


def delay_rates(
    faults: FaultyJets, state: FaultState, command: Float[Array, " j"], dt: Float[Array, ""] | float
) -> Float[Array, " j"]:
    """Return the thrust rates [N/s] that reach the jets under these commands for the next `dt` [s]."""
    has_lag = faults.lag > 0.0
    share = -jnp.expm1(-dt / jnp.where(has_lag, faults.lag, 1.0))
    return jnp.where(has_lag, state.command + (command - state.command) * share, command)


def limit_thrust(
    faults: FaultyJets,
    state: FaultState,
    thrust: Float[Array, " j"],
    thrust_rate: Float[Array, " j"],
    dt: Float[Array, ""] | float,
) -> tuple[Float[Array, " j"], Float[Array, " j"], FaultState]:
    """Return actual thrust and thrust rate of the jets after a step of `dt` [s], and the faults' new state.

    A jet that has failed decays from its thrust at the failure, `T = T₀ exp(−(t − t₀)/τ)`, or keeps it.
    """
    rate = jnp.where(thrust > faults.upper, jnp.minimum(thrust_rate, 0.0), thrust_rate)
    thrust = jnp.minimum(thrust, faults.upper)

    left = state.left - dt
    # Half a step of tolerance for rounding of the summed steps.
    had_failed, has_failed = state.left <= -0.5 * dt, left <= -0.5 * dt
    now = jnp.sum(jnp.where(faults.fails, thrust, 0.0))
    held = jnp.where(had_failed, state.held, now)
    decays = faults.decay > 0.0
    tau = jnp.where(decays, faults.decay, 1.0)
    fading = jnp.where(decays, held * jnp.exp(jnp.minimum(left, 0.0) / tau), 0.0)
    failed, its_rate = jnp.where(faults.is_stuck, held, fading), jnp.where(faults.is_stuck, 0.0, -fading / tau)
    is_dead = faults.fails & has_failed
    after = state._replace(left=left, held=held, tick=state.tick + 1)
    return jnp.where(is_dead, failed, thrust), jnp.where(is_dead, its_rate, rate), after
