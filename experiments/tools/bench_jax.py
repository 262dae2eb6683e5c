"""Measure parts of a JAX flight and their gradients in one run: `python -m experiments.tools.bench_jax`.

Times are per sample of a batch, in double precision, on JAX's default device; compilation is cold or from JAX's
persistent cache. States are those of TEST2, and of `robot`, hovering in the full wind. Prints a Markdown table.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero import rust, sim
from jax_aero.base.arguments import count
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import RobotModel
from jax_aero.results import manifest
from jax_aero.sim.rollout import fly_chunk
from jax_aero.types import State

untyped: Any = jax
"""JAX, for the parts of it that have no types."""

HOVER = 1000
"""Tick of TEST2 at which the states are taken: hovering in the full wind."""
TICKS = 20
"""Ticks per measured rollout."""
SECONDS = 0.3
"""Approximate time per figure [s]."""


class Case(NamedTuple):
    """A function of one sample, with a sample."""

    name: str
    function: Callable[..., Any]
    shared: Any
    """First argument, shared by the whole batch."""
    sample: Any
    """Second argument; the State in it varies over the batch."""
    divide_by: int = 1
    """Number of units in a sample, such as the ticks of a rollout."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.tools.bench_jax", description=__doc__)
    parser.add_argument("--batch", type=count, nargs="+", default=[1, 64], help="batch sizes (default 1 64)")
    parser.add_argument("--only", default="", metavar="WORDS", help="only what has these words in its name")
    options = parser.parse_args(arguments)
    sizes = options.batch
    untyped.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as cache:
        untyped.config.update("jax_compilation_cache_dir", cache)
        untyped.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        print(_machine(), flush=True)
        heads = "".join(f" batch {size} |" for size in sizes)
        print(f"| what | {heads} compile, cold | cached |\n|---|{'---|' * (len(sizes) + 2)}", flush=True)
        for case in _all_cases():
            if options.only in case.name:
                print(_row(case, sizes), flush=True)
    return 0


def _machine() -> str:
    device = jax.devices()[0]
    versions = manifest.versions("jax")
    facts = f"{device.device_kind} ({device.platform}), {manifest.processors()} cores; jax {jax.__version__}, "
    text = f"Device: {facts}numpy {versions.get('numpy', '?')}; load {os.getloadavg()[0]:.1f}\n"
    if os.getloadavg()[0] > 0.5 * manifest.processors():
        text += "The machine is busy: ratios are more reliable than times.\n"
    return text


def _row(case: Case, sizes: Sequence[int]) -> str:
    times, compiles = [], (0.0, 0.0)
    for size in sizes:
        sample = _spread(case.sample, size)
        compiled, cold = _compile(case, sample)
        cached = compiles[1]
        if size == sizes[-1]:
            untyped.clear_caches()
            cached = _compile(case, sample)[1]
        compiles = max(compiles[0], cold), cached
        times.append(_median(lambda: untyped.block_until_ready(compiled(case.shared, sample))))  # noqa: B023
    figures = "".join(f" {1e6 * t / size / case.divide_by:.1f} µs |" for t, size in zip(times, sizes, strict=True))
    return f"| {case.name} |{figures} {compiles[0]:.1f} s | {compiles[1]:.1f} s |"


def _compile(case: Case, sample: Any) -> tuple[Any, float]:
    started = time.perf_counter()
    batched: Any = jax.vmap(case.function, in_axes=(None, 0))
    compiled = jax.jit(batched).lower(case.shared, sample).compile()
    return compiled, time.perf_counter() - started


def _median(call: Callable[[], Any]) -> float:
    """Return the median time of a call [s], after one warm-up call."""
    call()
    times: list[float] = []
    while sum(times) < SECONDS or len(times) < 3:
        started = time.perf_counter()
        call()
        times.append(time.perf_counter() - started)
    return statistics.median(times)


def _spread(sample: Any, size: int) -> Any:
    """Repeat a sample, with small differences in every State it contains."""
    rng = np.random.default_rng(0)

    def vary(leaf: Any) -> Any:
        if not isinstance(leaf, State):
            return jnp.broadcast_to(leaf, (size, *jnp.shape(leaf)))
        repeated = jax.tree.map(lambda x: jnp.broadcast_to(x, (size, *jnp.shape(x))), leaf)
        noise = jnp.asarray(0.02 * rng.normal(size=repeated.velocity.shape), repeated.velocity.dtype)
        return repeated._replace(velocity=repeated.velocity + noise)

    return jax.tree.map(vary, sample, is_leaf=lambda x: isinstance(x, State))


# --- cases ----------------------------------------------------------------------------------------------------------


def _hovering(name: str) -> tuple[Any, Any]:
    """Return the scenario of an experiment and its state while hovering in the full wind."""
    config = scenario_config(rust.load_config(name))
    scenario, start = sim.prepare(config)
    return scenario, fly_chunk(scenario, start, jnp.array(0, jnp.int32), HOVER)[0]


def _all_cases() -> Iterator[Case]:
    yield from cases(*_hovering("test2"))
    yield _tick("robot", *_hovering("robot"))


def cases(scenario: Any, hover: Any) -> Iterator[Case]:
    """Yield all cases to measure of TEST2."""
    robot, state = scenario.plant.robot, hover.plant.robot
    yield Case("forward dynamics (tree)", _forward("tree"), robot, state)
    for backend in ("tree", "mjx"):
        yield Case(f"gradient of forward dynamics ({backend})", _forward_gradient(backend), robot, state)
    yield _tick("TEST2", scenario, hover)
    yield Case(f"its gradient by the aerodynamic areas, of {TICKS}", _gradient, scenario, hover, TICKS)


def _tick(name: str, scenario: Any, hover: Any) -> Case:
    return Case(f"closed-loop tick of {name}, of a rollout of {TICKS}", _rollout, scenario, hover, TICKS)


def _forward(backend: Any) -> Callable[[RobotModel, State], Any]:
    def accelerate(robot: RobotModel, state: State) -> Any:
        terms = dynamics(robot, state, kinematics(robot, state), backend)
        return forward_dynamics(terms, jnp.ones_like(state.velocity))

    return accelerate


def _forward_gradient(backend: Any) -> Callable[[RobotModel, State], Any]:
    def size(state: State, robot: RobotModel) -> Any:
        return jnp.sum(_forward(backend)(robot, state) ** 2)

    return lambda robot, state: jax.grad(size)(state, robot)


def _rollout(scenario: Any, state: Any) -> Any:
    return sim.rollout(scenario, state, TICKS, lambda row: row["com_position"], HOVER)[1]


def _gradient(scenario: Any, state: Any) -> Any:
    def cost(areas: Any) -> Any:
        aero = replace(scenario.plant.aero, areas=areas)
        perturbed = replace(scenario, plant=replace(scenario.plant, aero=aero))
        return jnp.sum(_rollout(perturbed, state) ** 2)

    return jax.grad(cost)(scenario.plant.aero.areas)


if __name__ == "__main__":
    sys.exit(main())
