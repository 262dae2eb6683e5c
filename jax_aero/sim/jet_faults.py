"""Faults of jets: slow response, reduced thrust, a dead jet.

    thrust rate command ──delayed──► jets ──limited──► thrust

They surround any jet dynamics. Faults are numbers, not structure, so flights with different faults share one
compilation. That a jet's force differs from its thrust is `Plant.force_scale`.

Equation M41 of `docs/model`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.body.jets import JetDynamics, JetsState
from jax_aero.body.robot import RobotModel
from jax_aero.config import JetFaultsConfig
from jax_aero.types import Array, leaf, pytree


class FaultState(NamedTuple):
    """State of the faults between two steps."""

    engine: Any
    """Additional state of the jets without faults."""
    command: Float[Array, " j"]
    """Thrust rates that reach the jets [N/s]."""
    left: Float[Array, ""]
    """Time until the failure [s]; negative after it."""
    held: Float[Array, ""]
    """Thrust of the failing jet at its failure [N]."""


@pytree
class FaultyJets:
    """`JetDynamics` of `j` jets with faults; without a fault the numbers have no effect."""

    jets: JetDynamics
    """The jets without faults."""
    lag: Float[Array, ""]
    """Time constant of the response [s]."""
    upper: Float[Array, " j"]
    """Greatest thrust [N]."""
    fails: Bool[Array, " j"]
    """Whether the jet is the failing one."""
    is_stuck: Bool[Array, ""]
    """Whether the failing jet keeps its thrust; otherwise the thrust decays."""
    failure_time: Float[Array, ""]
    """Time of the failure [s]."""
    decay: Float[Array, ""]
    """Time constant of the decay [s]."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Return the state at `thrust` [N] with thrust rate zero."""
        state, rest = self.jets.start(thrust), jnp.zeros_like(thrust)
        return state._replace(engine=FaultState(state.engine, rest, jnp.asarray(self.failure_time), rest[0]))

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Return the thrust that the flight controller receives [N]."""
        return self.jets.feedback(state._replace(engine=state.engine.engine))

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
    ) -> JetsState:
        """Advance every jet by `dt` [s] under constant commanded thrust rates [N/s]."""
        faults: FaultState = state.engine
        arriving = delay_rates(self, faults, command, dt)
        jets = self.jets.advance(state._replace(engine=faults.engine), arriving, dt)
        thrust, thrust_rate, faults = limit_thrust(self, faults, jets.thrust, jets.thrust_rate, dt)
        return JetsState(thrust, thrust_rate, faults._replace(engine=jets.engine, command=arriving))


def faulty_jets(jets: JetDynamics, settings: JetFaultsConfig, robot: RobotModel) -> FaultyJets:
    """Return jets with faults.

    Raises
    ------
    ValueError
        For a jet that the robot does not have.
    """
    names, failure = robot.jets.names, settings.failure
    if failure is not None and failure.jet not in names:
        raise ValueError(f"disturbances.jets.failure.jet is `{failure.jet}`; {robot.name} has {', '.join(names)}")
    for name in settings.force_scale.keys() - set(names):
        raise ValueError(f"disturbances.jets.force_scale has `{name}`; {robot.name} has {', '.join(names)}")
    thrust_max, zero = jnp.asarray(robot.jets.thrust_max), jnp.zeros(())
    scale = settings.thrust_limit_scale
    return FaultyJets(
        jets=jets,
        lag=leaf(settings.lag),
        upper=jnp.full(thrust_max.shape, np.inf) if scale is None else scale * thrust_max,
        fails=jnp.array([failure is not None and name == failure.jet for name in names]),
        is_stuck=jnp.array(failure is not None and failure.kind == "stuck"),
        failure_time=zero if failure is None else leaf(failure.time),
        decay=zero if failure is None else leaf(failure.decay),
    )


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

    A jet that has failed decays from its thrust at the failure: `T = T₀ exp(−(t − t₀)/τ)`.
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
    failed_thrust = jnp.where(faults.is_stuck, held, fading)
    failed_rate = jnp.where(faults.is_stuck, 0.0, -fading / tau)
    is_dead = faults.fails & has_failed
    after = state._replace(left=left, held=held)
    return jnp.where(is_dead, failed_thrust, thrust), jnp.where(is_dead, failed_rate, rate), after
