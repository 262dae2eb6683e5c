"""Many flights at once: `vmap` over everything in which they differ, split over the devices there are.

Flights of one structure (the same models, switches and lengths) share one compilation and fly together; numbers that
are the same in all of them are not copied. `fly_batch` has the signature and the result of `rust.fly_batch`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jax_aero import rust
from jax_aero.config import FlightConfig, flight_config
from jax_aero.dynamics import Backend
from jax_aero.robot import RobotModel, load_robot
from jax_aero.sim.rollout import CHUNK, Ending, finished
from jax_aero.sim.step import FLYING, Flight, FlightState, prepare, step
from jax_aero.summary import condense
from jax_aero.types import Array, with_dtype

MOST_TOGETHER = {"cpu": 64}
"""Flights that fly together on a device, by platform: more do not fit into a CPU's cache."""
MOST_ELSEWHERE = 1024


class Prepared(NamedTuple):
    """A flight that is ready to start."""

    flight: Flight
    state: FlightState
    n_ticks: int


class Group(NamedTuple):
    """Flights of one structure, their leaves on the host."""

    structure: Any
    """Of a `Flight`."""
    leaves: list[tuple[Any, ...]]
    """Of each flight."""
    states: list[FlightState]
    n_ticks: int
    places: list[int]
    """Which flights of the batch these are."""


def fly_batch(
    configs: Iterable[Mapping[str, Any]],
    progress: rust.Progress | None = None,
    *,
    full_log: bool = False,
    backend: Backend = "tree",
    dtype: Any = np.float64,
    most_together: int | None = None,
    devices: Sequence[jax.Device] | None = None,
) -> list[rust.Flight]:
    """Fly many configurations; the results do not depend on which fly together, but for rounding.

    Without `full_log` only outcome and summary are sure to be there. `progress(done, total)` counts flights.
    `most_together` flights at most are in memory of a device at once; without `devices`, all of them are used.

    Raises
    ------
    ValueError
        Naming the first flight that cannot be flown, and why.
    """
    with jax.enable_x64(True):
        workers = tuple(jax.devices() if devices is None else devices)
        together = most_together or MOST_TOGETHER.get(workers[0].platform, MOST_ELSEWHERE)
        # All configurations are read before the first flight is prepared: mistakes show at once.
        groups = list(_groups(_prepared(list(_typed(configs)), backend, dtype)))
        total = sum(len(group.places) for group in groups)
        flights: dict[int, rust.Flight] = {}
        for group in groups:
            size = len(workers) * min(together, _power_of_two(-(-len(group.places) // len(workers))))
            shared = _shared(group.leaves)
            for first in range(0, len(group.places), size):
                part = group._replace(
                    leaves=group.leaves[first : first + size],
                    states=group.states[first : first + size],
                    places=group.places[first : first + size],
                )
                flights.update(zip(part.places, _fly_together(part, shared, size, full_log, workers), strict=True))
                if progress is not None:
                    progress(len(flights), total)
    return [flights[place] for place in range(total)]


def _typed(configs: Iterable[Mapping[str, Any]]) -> Iterator[FlightConfig]:
    for index, table in enumerate(configs):
        with _name_flight_in_errors(index):
            yield flight_config(table)


def _prepared(configs: Iterable[FlightConfig], backend: Backend, dtype: Any) -> Iterator[Prepared]:
    robots: dict[str, RobotModel] = {}
    for index, config in enumerate(configs):
        with _name_flight_in_errors(index):
            robot = robots.get(config.robot) or robots.setdefault(config.robot, load_robot(config.robot))
            ready = jax.device_get(with_dtype(prepare(config, robot, backend), dtype))
        yield Prepared(ready[0], ready[1], config.simulator.n_ticks)


@contextmanager
def _name_flight_in_errors(index: int) -> Iterator[None]:
    try:
        yield
    except ValueError as reason:
        raise ValueError(f"flight {index} of the batch: {reason}") from None


def _groups(prepared: Iterable[Prepared]) -> Iterable[Group]:
    """Sort flights by structure; within a group they keep their order."""
    found: dict[Any, Group] = {}
    for place, (flight, state, n_ticks) in enumerate(prepared):
        leaves, structure = jax.tree.flatten(flight)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        key = structure, shapes, jax.tree.structure(state), n_ticks
        group = found.setdefault(key, Group(structure, [], [], n_ticks, []))
        group.leaves.append(tuple(leaves))
        group.states.append(state)
        group.places.append(place)
    return found.values()


def _shared(leaves: Sequence[tuple[Any, ...]]) -> tuple[bool, ...]:
    """Say of each leaf whether all flights have the same."""
    return tuple(all(np.array_equal(other, same[0]) for other in same[1:]) for same in zip(*leaves, strict=True))


def _power_of_two(n: int) -> int:
    """Return the next one: batches of similar size share a compilation."""
    return 1 << max(n - 1, 0).bit_length()


def _fly_together(
    group: Group, shared: tuple[bool, ...], size: int, full_log: bool, devices: tuple[jax.Device, ...]
) -> list[rust.Flight]:
    # Always `size` flights: what is missing is the last one again.
    rows = [min(row, len(group.places) - 1) for row in range(size)]
    leaves = tuple(
        same[0] if is_shared else np.stack([same[row] for row in rows])
        for same, is_shared in zip(zip(*group.leaves, strict=True), shared, strict=True)
    )
    state = jax.tree.map(lambda *x: np.stack([x[row] for row in rows]), *group.states)
    posture = np.asarray(state.memory.posture, np.float64)
    fly = _compiled(group.structure, shared, full_log, devices)
    kept: list[dict[str, Any]] = []
    for first in range(0, group.n_ticks + 1, CHUNK):
        state, chunk = fly(leaves, state, jnp.array(first, jnp.int32))
        kept.append(jax.device_get(chunk))
        if not np.any(np.asarray(state.fall) == FLYING):
            break
    falls, errors, ticks = jax.device_get((state.fall, state.fall_error, state.fall_tick))
    signals = {name: np.concatenate([chunk[name] for chunk in kept], axis=1, dtype=np.float64) for name in kept[0]}
    flights = []
    for row in range(len(group.places)):
        own = {name: signal[row] for name, signal in signals.items()}
        ending = Ending(int(falls[row]), float(errors[row]), int(ticks[row]))
        flights.append(finished(own, posture[row], ending, group.n_ticks, is_whole_log=full_log))
    return flights


@lru_cache(maxsize=64)
def _compiled(
    structure: Any, shared: tuple[bool, ...], full_log: bool, devices: tuple[jax.Device, ...]
) -> Callable[..., tuple[FlightState, dict[str, Array]]]:
    """Fly a chunk of ticks, for flights of one structure."""

    def some(leaves: tuple[Array, ...], state: FlightState, first: Array) -> tuple[FlightState, dict[str, Array]]:
        flight = jax.tree.unflatten(structure, leaves)

        def one(state: FlightState, tick: Array) -> tuple[FlightState, dict[str, Array]]:
            posture = state.memory.posture
            state, row = step(flight, state, tick)
            signals = row._asdict()
            return state, signals if full_log else condense(signals, posture)

        return jax.lax.scan(one, state, first + jnp.arange(CHUNK, dtype=jnp.int32))

    together = jax.vmap(some, in_axes=(tuple(None if same else 0 for same in shared), 0, None))
    if len(devices) > 1:
        split, whole = PartitionSpec("flights"), PartitionSpec()  # type: ignore[no-untyped-call]
        together = jax.shard_map(
            together,
            mesh=Mesh(np.array(devices), ("flights",)),
            in_specs=(tuple(whole if same else split for same in shared), split, whole),
            out_specs=split,
            check_vma=False,
        )
    compiled: Callable[..., Any] = jax.jit(together)
    return compiled
