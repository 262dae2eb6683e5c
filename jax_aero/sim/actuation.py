"""The way from a command to what executes it: delay, jitter, lost commands.

```text
command of a tick ──► lost? ──► delay + jitter ──► held until a later command arrives
```

Delays and losses are drawn before the flight; the length of the way is structure.

Equation M140 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jax_aero import rust
from jax_aero.config import ActuationConfig
from jax_aero.control.measurement import Measurement
from jax_aero.sim.plant import Acting
from jax_aero.types import Array, pytree, static

STREAM = 3

LOST = -1
"""Delay of a command that is lost."""


@pytree
class Actuation:
    """Delays of the commands of one flight."""

    lag: Int[Array, "ticks 2"]
    """Delay of thrust rates and torques of a tick [physics steps]; `LOST` if lost."""
    ticks: int = static()
    """Commands that can be on their way: ticks of the greatest delay plus one."""

    def start(self, first: Measurement) -> ActuationState:
        """Return a way without commands."""

        def line(command: Array) -> Line:
            sent = jnp.zeros((self.ticks, *command.shape), command.dtype)
            return Line(sent, jnp.full(self.ticks, LOST, jnp.int32), jnp.zeros_like(command))

        return ActuationState(line(first.thrust), line(first.state.joint_position), jnp.array(0, jnp.int32))

    def act(self, state: ActuationState, given: Acting) -> tuple[ActuationState, Acting]:
        """Let the command arrive that does; thrust rates act by their mean over the tick."""
        substeps = given.torques.shape[0]
        way = send(self, state, given.thrust_rate, given.torques[0])
        rates, torques = (acting(line, substeps) for line in way[:2])
        arrived = Acting(jnp.sum(rates / substeps, axis=0), torques)
        # What acts is held until another command arrives.
        held = way.thrust_rate._replace(held=rates[-1]), way.torque._replace(held=torques[-1])
        return ActuationState(*held, way.tick), arrived


class Line(NamedTuple):
    """Commands of one kind on their way, the latest first."""

    sent: Float[Array, "h x"]
    lag: Int[Array, " h"]
    """Their delays [physics steps]."""
    held: Float[Array, " x"]
    """The latest command that has arrived."""


class ActuationState(NamedTuple):
    """State of the actuation between two ticks."""

    thrust_rate: Line
    torque: Line
    tick: Int[Array, ""]
    """Number of ticks taken."""


def actuation(config: ActuationConfig, time_step: float, substeps: int, ticks: int) -> Actuation:
    """Return the actuation of a flight of `ticks` ticks; `time_step` [s].

    Call it outside loops, since it draws delays and losses.
    """
    step = time_step / substeps
    thrust, torque, jitter = (
        int(np.floor(time / step + 0.5)) for time in (config.thrust_delay, config.torque_delay, config.jitter)
    )
    # Thrust rates and torques of a tick are sent together.
    loss, late = rust.uniforms(config.seed, STREAM, 2 * (ticks + 1)).reshape(-1, 2).T[:, :, None]
    delay = np.array([thrust, torque], np.int32)
    lag = np.where(loss >= config.drop, np.floor(late * (jitter + 1.0)).astype(np.int32) + delay, LOST)
    return Actuation(jnp.asarray(lag), (max(thrust, torque) + jitter) // substeps + 1)


def send(
    way: Actuation, before: ActuationState, thrust_rate: Float[Array, " j"], torque: Float[Array, " n"]
) -> ActuationState:
    """Send the command of a tick; the first one acts at once and until another arrives."""
    lag, is_first = way.lag[jnp.minimum(before.tick, way.lag.shape[0] - 1)], before.tick == 0
    rates, torques = _send(before.thrust_rate, thrust_rate, lag[0]), _send(before.torque, torque, lag[1])
    return ActuationState(
        rates._replace(held=jnp.where(is_first, thrust_rate, rates.held)),
        torques._replace(held=jnp.where(is_first, torque, torques.held)),
        before.tick + 1,
    )


def _send(line: Line, command: Array, lag: Array) -> Line:
    return Line(
        jnp.concatenate([command[None], line.sent[:-1]]), jnp.concatenate([lag[None], line.lag[:-1]]), line.held
    )


def acting(line: Line, substeps: int) -> Float[Array, "s x"]:
    """Return the latest command that has arrived at each sub-step of a tick; one is sent at the first of each tick."""
    ages = jnp.arange(substeps, dtype=jnp.int32)[:, None] + substeps * jnp.arange(line.lag.shape[0], dtype=jnp.int32)
    has_arrived = (line.lag != LOST)[None] & (line.lag[None] <= ages)
    latest = line.sent[jnp.argmax(has_arrived, axis=1)]
    return jnp.where(jnp.any(has_arrived, axis=1)[:, None], latest, line.held[None])
