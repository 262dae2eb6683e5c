"""Flights from start to end: a scan over ticks for gradients and batches, and `fly` for one flight with its log.

>>> from jax_aero import load as load_config
>>> from jax_aero.sim import fly
>>> config = load_config("test2", {"simulator.duration": 0.05})
>>> fly(config)["thrust"].shape
(6, 4)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jax_aero import rust
from jax_aero.base.result import FlightResult, Outcome
from jax_aero.base.terminal import Progress
from jax_aero.body.batches import compute_again
from jax_aero.config import ScenarioConfig
from jax_aero.sim.outcome import COURSE_ERROR, FLYING, NOT_FINITE, lost_reason
from jax_aero.sim.plant import CHUNK, COMPILER_OPTIONS
from jax_aero.sim.preparation import prepare
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.signals import FlightRow, complete
from jax_aero.sim.step import FlightState, step
from jax_aero.types import Array

Kept = TypeVar("Kept")


def keep_row(row: FlightRow) -> FlightRow:
    """Return the whole row, for `keep` of `rollout`."""
    return row


def rollout(
    scenario: Scenario,
    state: FlightState,
    n_ticks: int,
    keep: Callable[[FlightRow], Kept],
    first_tick: Int[Array, ""] | int = 0,
    *,
    recompute: bool = True,
) -> tuple[FlightState, Kept]:
    """Fly `n_ticks` ticks; return the final state and, for every tick, the part of the row that `keep` returns.

    Pure, for `jit`, `vmap` and `grad`. Reverse mode stores a state and the results of `keep` for each tick and computes
    the tick again: 5 kB a tick and flight for TEST2. Without `recompute` it stores all values, 150 kB.

    Raises
    ------
    ValueError
        For an `n_ticks` that is negative or no integer.
    """
    given: Any = n_ticks
    if not isinstance(given, int | np.integer) or given < 0:
        raise ValueError(f"`n_ticks` is {given}; expected an integer ≥ 0")

    def fly_tick(state: FlightState, tick: Array) -> tuple[FlightState, Kept]:
        state, row = step(scenario, state, tick)
        return state, keep(row)

    ticks = first_tick + jnp.arange(n_ticks, dtype=jnp.int32)
    return jax.lax.scan(compute_again(fly_tick) if recompute else fly_tick, state, ticks)


@jax.jit(static_argnames=("n_ticks",), compiler_options=COMPILER_OPTIONS)
def fly_chunk(
    scenario: Scenario, state: FlightState, first_tick: Int[Array, ""], n_ticks: int
) -> tuple[FlightState, FlightRow]:
    """Fly some ticks with the whole log, without derivatives."""
    ticks = first_tick + jnp.arange(n_ticks, dtype=jnp.int32)
    return jax.lax.scan(partial(step, scenario), state, ticks)


def fly(
    config: ScenarioConfig | Mapping[str, Any], progress: Progress | None = None, *, dtype: Any = np.float64
) -> FlightResult:
    """Fly one configuration to its end or until the flight is lost, with the result of `rust.fly`.

    Computes in double precision by default, independent of JAX's setting.
    """
    with jax.enable_x64(True):
        return run(*prepare(config, dtype=dtype), progress)


def run(scenario: Scenario, state: FlightState, progress: Progress | None = None) -> FlightResult:
    """Fly a scenario from its state at tick zero to its end or until the flight is lost, as `fly` does."""
    n_ticks = int(scenario.n_ticks)
    rows: list[FlightRow] = []
    for first in range(0, n_ticks + 1, CHUNK):
        # Chunks have equal length, so that they compile once; the last one flies beyond the end.
        state, chunk = fly_chunk(scenario, state, jnp.array(first, jnp.int32), CHUNK)
        rows.append(jax.device_get(chunk))
        if progress is not None:
            progress(min(first + CHUNK, n_ticks), n_ticks)
        if int(state.loss) != FLYING:
            break
    log = {name: np.concatenate([chunk[name] for chunk in rows], dtype=np.float64) for name in rows[0]}
    ending = Ending(int(state.loss), float(state.loss_size), int(state.loss_tick))
    return make_result(log, np.asarray(state.posture, np.float64), ending, n_ticks)


class Ending(NamedTuple):
    """Loss of a flight, as in `FlightState`."""

    loss: int
    size: float
    tick: int


def make_result(
    signals: Mapping[str, Any], posture: Any, ending: Ending, n_ticks: int, *, is_whole_log: bool = True
) -> FlightResult:
    """Return the flight of whole or condensed rows, the latter without a log, without the ticks after its end."""
    is_lost = 0 <= ending.tick <= n_ticks
    signals = complete({name: signal[: (ending.tick if is_lost else n_ticks) + 1] for name, signal in signals.items()})
    has_diverged = is_lost and ending.loss >= NOT_FINITE
    # The row that exceeds the divergence limits is in the log, but not in the figures of merit.
    judged = {name: signal[:-1] for name, signal in signals.items()} if has_diverged else signals
    summary = rust.summarise(judged, posture if is_whole_log else [0.0])
    flown: Outcome = "off_course" if summary["max_com_error"] > COURSE_ERROR else "completed"
    return FlightResult(
        log=signals if is_whole_log else {},
        joint_setpoint=posture,
        outcome=("diverged" if has_diverged else "fell") if is_lost else flown,
        lost_time=float(signals["time"][-1]) if is_lost else None,
        lost_reason=lost_reason(ending.loss, ending.size) if is_lost else None,
        summary=summary,
    )
