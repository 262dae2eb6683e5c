"""Many flights at once: `vmap` over everything in which they differ, distributed over the available devices.

Flights of one structure (the same models, switches and lengths) share one compilation and fly together, with any
numbers. The robot and the weights of networks are not copied for every flight, so flights that differ in these are
computed separately. `fly_batch` has the result of `rust.fly_batch`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jax_aero import rust
from jax_aero.aero.network import Network
from jax_aero.aero.network_card import load_network
from jax_aero.base.result import FlightResult
from jax_aero.base.terminal import Progress
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.config import ScenarioConfig
from jax_aero.sim.outcome import FLYING
from jax_aero.sim.plant import CHUNK, COMPILER_OPTIONS
from jax_aero.sim.preparation import prepare, read_config
from jax_aero.sim.rollout import Ending, make_result
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.step import FlightState, step
from jax_aero.types import Array

MOST_TOGETHER = {"cpu": 64}
"""Greatest number of flights computed together per device, by platform; on a CPU limited by the cache."""
MOST_ELSEWHERE = 1024

SIZE_STEP = 8
"""Larger batches are padded to a multiple of this size: few sizes to compile, few superfluous flights."""


def condense(log: Mapping[str, Any], joint_setpoint: Any) -> dict[str, Any]:
    """Return a log, or a tick of it, with fewer numbers in a row and the same figures of merit; NumPy or JAX arrays.

    Its only joint has the greatest torque, and its position is the sum of the joint errors; its only link has the sums
    of the forces. Of the other signals it has those that figures of merit are computed from.
    """
    condensed = {
        "joint_torque": abs(log["joint_torque"]).max(-1, initial=0.0, keepdims=True),
        "joint_position": abs(log["joint_position"] - joint_setpoint).sum(-1, keepdims=True),
    }
    condensed |= {name: log[name].sum(-2, keepdims=True) for name in log if name.startswith("aero_force")}
    return {name: log[name] for name in rust.summarised() if name in log} | condensed


class Group(NamedTuple):
    """Flights of one structure, with their leaves in the host's memory."""

    structure: Any
    """Tree structure of a `Scenario`, for `jax.tree.unflatten`."""
    is_shared: tuple[bool, ...]
    """For each leaf, whether all flights share one array."""
    leaves: list[tuple[Any, ...]]
    """Leaves of each flight."""
    states: list[FlightState]
    n_ticks: int
    places: list[int]
    """Indices of these flights in the batch."""

    @property
    def axes(self) -> tuple[int | None, ...]:
        """Return the `vmap` axis of each stacked leaf."""
        return tuple(None if shared else 0 for shared in self.is_shared)

    def stack(self, rows: Sequence[int]) -> tuple[tuple[Any, ...], FlightState]:
        """Return leaves and initial states of the flights `rows`, with an additional first axis where they differ."""
        leaves = tuple(
            of_flights[0] if is_shared else np.stack([of_flights[row] for row in rows])
            for of_flights, is_shared in zip(zip(*self.leaves, strict=True), self.is_shared, strict=True)
        )
        states: FlightState = jax.tree.map(lambda *x: np.stack([x[row] for row in rows]), *self.states)
        return leaves, states


def fly_batch(
    configs: Iterable[ScenarioConfig | Mapping[str, Any]],
    progress: Progress | None = None,
    *,
    full_log: bool = False,
    most_together: int | None = None,
) -> list[FlightResult]:
    """Fly many configurations; except for rounding, the results do not depend on how they are grouped.

    Without `full_log` only outcome and summary are guaranteed. `progress(done, total)` counts flights. At most
    `most_together` flights are in the memory of a device at once; all devices are used.

    Raises
    ------
    ValueError
        For a flight that cannot be flown, naming the first one and the reason; and for `most_together` below one.
    """
    if most_together is not None and most_together < 1:
        raise ValueError(f"`most_together` is {most_together}; expected at least 1, or None for the usual number")
    with jax.enable_x64(True):
        workers = tuple(jax.devices())
        together = most_together or MOST_TOGETHER.get(workers[0].platform, MOST_ELSEWHERE)
        # All configurations are read before the first flight is prepared, so that errors are reported at once.
        groups = group_flights(configs)
        total = sum(len(group.places) for group in groups)
        flights: dict[int, FlightResult] = {}
        for group in groups:
            size = batch_size(len(group.places), len(workers), together)
            for first in range(0, len(group.places), size):
                part = group._replace(
                    leaves=group.leaves[first : first + size],
                    states=group.states[first : first + size],
                    places=group.places[first : first + size],
                )
                flights.update(zip(part.places, _fly_together(part, size, full_log, workers), strict=True))
                if progress is not None:
                    progress(len(flights), total)
    return [flights[place] for place in range(total)]


def group_flights(configs: Iterable[ScenarioConfig | Mapping[str, Any]]) -> list[Group]:
    """Prepare flights and group them by structure, robot and networks; within a group they keep their order."""
    found: dict[Any, Group] = {}
    for place, (scenario, state) in enumerate(_prepare_flights(list(_read_configs(configs)))):
        leaves, structure = jax.tree.flatten(scenario)
        is_shared = tuple(jax.tree.leaves(_mark_shared(scenario)))
        common = tuple(leaf.tobytes() for leaf, shared in zip(leaves, is_shared, strict=True) if shared)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        n_ticks = int(scenario.n_ticks)
        key = structure, shapes, jax.tree.structure(state), n_ticks, hash(common)
        group = found.setdefault(key, Group(structure, is_shared, [], [], n_ticks, []))
        group.leaves.append(tuple(leaves))
        group.states.append(state)
        group.places.append(place)
    return list(found.values())


def batch_size(flights: int, devices: int, most: int) -> int:
    """Return how many flights are computed at once: batches of similar size, with at most `most` per device."""
    parts = -(-flights // (devices * most))
    each = -(-flights // (devices * parts))
    filled = 1 << (each - 1).bit_length() if each <= SIZE_STEP else -(-each // SIZE_STEP) * SIZE_STEP
    return devices * min(filled, most)


def _read_configs(configs: Iterable[ScenarioConfig | Mapping[str, Any]]) -> Iterator[ScenarioConfig]:
    for index, config in enumerate(configs):
        with _name_flight(index):
            yield read_config(config)


def _prepare_flights(configs: Iterable[ScenarioConfig]) -> Iterator[tuple[Scenario, FlightState]]:
    read_robot = cache(load_robot)
    networks: dict[tuple[str, str], Network] = {}

    def read_network(card: Any, robot: RobotModel) -> Network:
        key = str(card), robot.source
        return networks.get(key) or networks.setdefault(key, load_network(card, robot))

    for index, config in enumerate(configs):
        with _name_flight(index):
            ready = prepare(config, read_robot(config.robot), read_network=read_network)
        yield jax.device_get(ready)


@contextmanager
def _name_flight(index: int) -> Iterator[None]:
    try:
        yield
    except ValueError as reason:
        raise ValueError(f"flight {index} of the batch: {reason}") from None


def _mark_shared(scenario: Scenario) -> Any:
    """Return a tree of booleans that marks the leaves shared by a group's flights: the robot's and the networks'."""

    def mark(path: Any, node: Any) -> Any:
        is_shared = isinstance(node, Network) or jax.tree_util.keystr(path).startswith(".plant.robot")
        return jax.tree.map(lambda _: is_shared, node)

    return jax.tree_util.tree_map_with_path(mark, scenario, is_leaf=lambda node: isinstance(node, Network))


def _fly_together(group: Group, size: int, full_log: bool, devices: tuple[jax.Device, ...]) -> list[FlightResult]:
    # Always `size` flights, padded with copies of the last.
    rows = [min(row, len(group.places) - 1) for row in range(size)]
    stacked, state = group.stack(rows)
    # Numbers are transferred to the devices once, not with every chunk.
    mesh = Mesh(np.array(devices), ("flights",))
    split, whole = (NamedSharding(mesh, PartitionSpec(*axes)) for axes in (("flights",), ()))  # type: ignore[no-untyped-call]
    leaves = tuple(
        jax.device_put(leaf, whole if is_shared else split)
        for leaf, is_shared in zip(stacked, group.is_shared, strict=True)
    )
    state = jax.device_put(state, split)
    fly = _compile_chunk(group.structure, group.axes, full_log, mesh)
    kept: list[dict[str, Any]] = []
    for first in range(0, group.n_ticks + 1, CHUNK):
        state, chunk = fly(leaves, state, jnp.array(first, jnp.int32))
        kept.append(jax.device_get(chunk))
        if not np.any(np.asarray(state.loss) == FLYING):
            break
    losses, sizes, ticks, postures = jax.device_get((state.loss, state.loss_size, state.loss_tick, state.posture))
    signals = {name: np.concatenate([chunk[name] for chunk in kept], axis=1, dtype=np.float64) for name in kept[0]}
    flights = []
    for row in range(len(group.places)):
        own = {name: signal[row] for name, signal in signals.items()}
        ending = Ending(int(losses[row]), float(sizes[row]), int(ticks[row]))
        posture = postures[row].astype(np.float64)
        flights.append(make_result(own, posture, ending, group.n_ticks, is_whole_log=full_log))
    return flights


@lru_cache(maxsize=64)
def _compile_chunk(
    structure: Any, axes: tuple[int | None, ...], full_log: bool, mesh: Mesh
) -> Callable[..., tuple[FlightState, dict[str, Array]]]:
    """Return the compiled function that flies a chunk of ticks for flights of one structure."""

    def fly_ticks(leaves: tuple[Array, ...], state: FlightState, first: Array) -> tuple[FlightState, dict[str, Array]]:
        scenario = jax.tree.unflatten(structure, leaves)

        def fly_tick(state: FlightState, tick: Array) -> tuple[FlightState, dict[str, Array]]:
            state, row = step(scenario, state, tick)
            return state, row if full_log else condense(row, state.posture)

        return jax.lax.scan(fly_tick, state, first + jnp.arange(CHUNK, dtype=jnp.int32))

    together = jax.vmap(fly_ticks, in_axes=(axes, 0, None))
    if mesh.size > 1:
        split, whole = PartitionSpec("flights"), PartitionSpec()  # type: ignore[no-untyped-call]
        together = jax.shard_map(
            together,
            mesh=mesh,
            in_specs=(tuple(whole if axis is None else split for axis in axes), split, whole),
            out_specs=split,
            check_vma=False,
        )
    compiled: Callable[..., Any] = jax.jit(together, compiler_options=COMPILER_OPTIONS)
    return compiled
