"""Flights from start to end: a scan over ticks for gradients and batches, and `fly` for one flight with its log.

>>> from jax_aero.io import load_config
>>> from jax_aero.sim import fly
>>> config = load_config("configs/experiments/test2.toml", {"simulator.duration": 0.05})
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

from jax_aero.config import ScenarioConfig
from jax_aero.result import FlightResult, Progress
from jax_aero.sim.step import (
    FLYING,
    LOST_BY_COM,
    LOST_BY_ROTATION,
    FlightRow,
    FlightState,
    Scenario,
    prepare,
    step,
)
from jax_aero.summary import condense, figures
from jax_aero.types import Array

Kept = TypeVar("Kept")

CHECKPOINT_EVERY = 50
"""Ticks between the states that reverse mode stores; those between are computed again."""

CHUNK = 250
"""Ticks that `fly` flies between two looks at the fall and at the keyboard."""


def everything(row: FlightRow) -> FlightRow:
    """Keep the whole row."""
    return row


def rollout(
    scenario: Scenario,
    state: FlightState,
    n_ticks: int,
    keep: Callable[[FlightRow], Kept],
    first_tick: Array | int = 0,
    checkpoint_every: int = CHECKPOINT_EVERY,
) -> tuple[FlightState, Kept]:
    """Fly `n_ticks` ticks; return the state after them and, tick by tick, what `keep` takes from every row.

    Pure: `jit`, `vmap` and `grad` it. Reverse mode stores one state in `checkpoint_every` ticks and what `keep` takes,
    so its memory does not grow with all that happens within a tick.
    """

    def one(state: FlightState, tick: Array) -> tuple[FlightState, Kept]:
        state, row = step(scenario, state, tick)
        return state, keep(row)

    @partial(jax.checkpoint, prevent_cse=False)
    def several(state: FlightState, ticks: Array) -> tuple[FlightState, Kept]:
        return jax.lax.scan(one, state, ticks)

    ticks = first_tick + jnp.arange(n_ticks, dtype=jnp.int32)
    whole = n_ticks // checkpoint_every
    parts: list[Kept] = []
    if whole:
        state, rows = jax.lax.scan(several, state, ticks[: whole * checkpoint_every].reshape(whole, checkpoint_every))
        parts.append(jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), rows))
    if n_ticks % checkpoint_every:
        state, rows = several(state, ticks[whole * checkpoint_every :])
        parts.append(rows)
    kept: Kept = jax.tree.map(lambda *x: jnp.concatenate(x), *parts)
    return state, kept


@jax.jit(static_argnames=("n_ticks",))
def fly_chunk(scenario: Scenario, state: FlightState, first_tick: Array, n_ticks: int) -> tuple[FlightState, FlightRow]:
    """Fly some ticks forwards, with the whole log."""
    ticks = first_tick + jnp.arange(n_ticks, dtype=jnp.int32)
    return jax.lax.scan(partial(step, scenario), state, ticks)


def fly(
    config: ScenarioConfig | Mapping[str, Any], progress: Progress | None = None, *, dtype: Any = np.float64
) -> FlightResult:
    """Fly one configuration from start to end, or to the fall, as `rust.fly` does and with the same result.

    Works in double precision by default, whatever the setting of JAX.
    """
    with jax.enable_x64(True):
        return run(*prepare(config, dtype=dtype), progress)


def run(scenario: Scenario, state: FlightState, progress: Progress | None = None) -> FlightResult:
    """Fly a scenario from this state to its end, or to the fall; as `fly` does with one of its own."""
    n_ticks = int(scenario.n_ticks)
    posture = np.asarray(state.plant.robot.joint_position, np.float64)
    rows: list[FlightRow] = []
    for first in range(0, n_ticks + 1, CHUNK):
        # Chunks are of one length, so that they compile once; the last one flies beyond the end.
        state, chunk = fly_chunk(scenario, state, jnp.array(first, jnp.int32), CHUNK)
        rows.append(jax.device_get(chunk))
        if progress is not None:
            progress(min(first + CHUNK, n_ticks), n_ticks)
        if int(state.fall) != FLYING:
            break
    log = {
        name: np.concatenate([np.asarray(getattr(chunk, name), np.float64) for chunk in rows])
        for name in FlightRow._fields
    }
    return finished(log, posture, Ending(int(state.fall), float(state.fall_error), int(state.fall_tick)), n_ticks)


class Ending(NamedTuple):
    """How a flight was lost, as in `FlightState`."""

    fall: int
    error: float
    tick: int


def finished(
    signals: Mapping[str, Any], posture: Any, ending: Ending, n_ticks: int, *, is_whole_log: bool = True
) -> FlightResult:
    """Return the flight of these signals: whole rows, or condensed ones without a log. Ticks beyond its end are cut."""
    fell = 0 <= ending.tick <= n_ticks
    signals = {name: signal[: (ending.tick if fell else n_ticks) + 1] for name, signal in signals.items()}
    return FlightResult(
        log=signals if is_whole_log else {},
        joint_setpoint=posture,
        outcome="fell" if fell else "completed",
        fall_time=float(signals["time"][-1]) if fell else None,
        fall_reason=fall_reason(ending.fall, ending.error) if fell else None,
        summary=figures(condense(signals, posture) if is_whole_log else signals),
    )


def fall_reason(fall: int, error: float) -> str:
    """Say in words why a flight was lost."""
    if fall == LOST_BY_ROTATION:
        return f"rotation error {np.rad2deg(error):.1f} deg"
    if fall == LOST_BY_COM:
        return f"CoM error {error:.2f} m"
    return "state not finite"
