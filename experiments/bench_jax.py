"""Measure JAX and plain MJX with the same robot in one run: `python -m experiments.bench_jax`.

Times are per sample of a batch, in double precision unless stated, on JAX's default device; compilation is cold or from
JAX's persistent cache. States are those of TEST2 hovering in the full wind. Prints the Markdown tables of
`docs/embedding.md`.
"""

from __future__ import annotations

import argparse
import importlib
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

from experiments import manifest
from jax_aero import rust, sim
from jax_aero.aero import LinkConventions, aero_model, link_forces
from jax_aero.base import places
from jax_aero.base.typed import aero_config, scenario_config
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.kinematics import kinematics
from jax_aero.body.linalg import CHUNK
from jax_aero.body.robot import RobotModel
from jax_aero.cli import count
from jax_aero.control import qp
from jax_aero.control import tick as control
from jax_aero.sim.rollout import fly_chunk
from jax_aero.types import State, with_dtype

untyped: Any = jax
"""JAX, for the parts of it that have no types."""

EXPERIMENTS = places.CONFIGS / "experiments"
HOVER = 1000
"""Tick of TEST2 at which the states are taken: hovering in the full wind."""
TICKS = 20
"""Ticks per measured rollout."""


FLIGHT_TICKS = 5001
"""Ticks of a flight of 50 s, for throughput in flights."""


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
    is_slow: bool = False
    """Whether compilation is slow; left out of a quick run."""
    in_pieces: bool = False
    """Whether a CPU must evaluate few samples at a time, since the function calls LAPACK in a way that can deadlock."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.bench_jax", description=__doc__)
    parser.add_argument("--batch", type=count, nargs="+", help="batch sizes (default 1 64 1024; quick: 1 64)")
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="measure only cases whose names have one of these")
    parser.add_argument("--seconds", type=float, help="approximate time per figure (default 1; quick: 0.3)")
    parser.add_argument("--quick", action="store_true", help="a few minutes: fewer sizes, no slow compilation")
    given = parser.parse_args(arguments)
    sizes = given.batch or ([1, 64] if given.quick else [1, 64, 1024])
    seconds = given.seconds or (0.3 if given.quick else 1.0)
    untyped.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as cache:
        untyped.config.update("jax_compilation_cache_dir", cache)
        untyped.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        print(_machine(), flush=True)
        flight, hover = _hovering_flight()
        heads = "".join(f" batch {size} |" for size in sizes)
        print(f"| what | {heads} compile, cold | cached |\n|---|{'---|' * (len(sizes) + 2)}", flush=True)
        for case in cases(flight, hover):
            wanted = given.only is None or any(text in case.name for text in given.only)
            if wanted and not (given.quick and case.is_slow):
                print(_row(case, sizes, seconds), flush=True)
        if given.only is None or "throughput" in given.only:
            print("\n| throughput: batch | precision | ticks per second | flights of 50 s per second | compile |")
            print("|---|---|---|---|---|")
            for line in _throughput(flight, hover, seconds, quick=given.quick):
                print(line, flush=True)
    return 0


def _machine() -> str:
    device = jax.devices()[0]
    versions = manifest.versions("jax")
    facts = f"{device.device_kind} ({device.platform}), {manifest.processors()} cores; jax {jax.__version__}, "
    text = f"Device: {facts}numpy {versions.get('numpy', '?')}; load {os.getloadavg()[0]:.1f}\n"
    if os.getloadavg()[0] > 0.5 * manifest.processors():
        text += "The machine is busy: ratios are more reliable than times.\n"
    return text


def _row(case: Case, sizes: Sequence[int], seconds: float) -> str:
    times, compiles = [], (0.0, 0.0)
    for size in sizes:
        sample = _spread(case.sample, size)
        compiled, cold = _compile(case, sample)
        cached = compiles[1]
        if size == sizes[-1]:
            untyped.clear_caches()
            cached = _compile(case, sample)[1]
        compiles = max(compiles[0], cold), cached
        times.append(_median(lambda: untyped.block_until_ready(compiled(case.shared, sample)), seconds))  # noqa: B023
    figures = "".join(f" {1e6 * t / size / case.divide_by:.1f} µs |" for t, size in zip(times, sizes, strict=True))
    return f"| {case.name} |{figures} {compiles[0]:.1f} s | {compiles[1]:.1f} s |"


def _compile(case: Case, sample: Any) -> tuple[Any, float]:
    started = time.perf_counter()
    batched: Any = jax.vmap(case.function, in_axes=(None, 0))
    if case.in_pieces and jax.devices()[0].platform == "cpu":
        batched = _map_in_pieces(case.function)
    compiled = jax.jit(batched).lower(case.shared, sample).compile()
    return compiled, time.perf_counter() - started


def _map_in_pieces(function: Callable[..., Any]) -> Callable[..., Any]:
    def map_samples(shared: Any, samples: Any) -> Any:
        return jax.lax.map(lambda sample: function(shared, sample), samples, batch_size=CHUNK)

    return map_samples


def _throughput(scenario: Any, hover: Any, seconds: float, *, quick: bool) -> Iterator[str]:
    """Fly batches of fourfold growing size, until the throughput rises by less than a tenth."""
    start = 16 if jax.devices()[0].platform == "cpu" else 256
    for name, dtype in (("float64", jnp.float64), ("float32", jnp.float32))[: 1 if quick else 2]:
        best, size = 0.0, start
        flying, hovering = sim.convert_precision(scenario, hover, dtype)
        while size <= (64 if quick else 65536):
            case = Case("", _rollout, flying, _spread(hovering, size))
            compiled, cold = _compile(case, case.sample)
            took = _median(lambda: untyped.block_until_ready(compiled(case.shared, case.sample)), seconds)  # noqa: B023
            rate = size * TICKS / took
            yield f"| {size} | {name} | {rate:.0f} | {rate / FLIGHT_TICKS:.2f} | {cold:.1f} s |"
            if rate < 1.1 * best:
                break
            best, size = rate, 4 * size


def _median(call: Callable[[], Any], seconds: float) -> float:
    """Return the median time of a call [s], after one warm-up call."""
    call()
    times: list[float] = []
    while sum(times) < seconds or len(times) < 3:
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


def _hovering_flight() -> tuple[Any, Any]:
    """Return the scenario TEST2 and its state while hovering in the full wind."""
    config = scenario_config(rust.load_config(EXPERIMENTS / "test2.toml"))
    scenario, start = sim.prepare(config)
    return scenario, fly_chunk(scenario, start, jnp.array(0, jnp.int32), HOVER)[0]


def cases(scenario: Any, hover: Any) -> Iterator[Case]:
    """Yield all cases to measure, our own first."""
    robot, state = scenario.plant.robot, hover.plant.robot
    wind = jnp.array([0.0, -10.0, 0.0])
    yield from _dynamics_cases(robot, state)
    yield from _aero_cases(robot, state, wind)
    yield from _control_cases(scenario, hover, wind)
    for name, dtype in (("", jnp.float64), (", float32", jnp.float32)):
        flying, hovering = sim.convert_precision(scenario, hover, dtype)
        yield Case(f"closed-loop tick, of a rollout of {TICKS}{name}", _rollout, flying, hovering, TICKS)
    yield Case(f"its gradient by the aerodynamic areas, of {TICKS}", _gradient, scenario, hover, TICKS, is_slow=True)
    yield from _mjx_cases(robot, state)


def _rollout(scenario: Any, state: Any) -> Any:
    return sim.rollout(scenario, state, TICKS, lambda row: row["com_position"], HOVER)[1]


def _gradient(scenario: Any, state: Any) -> Any:
    def cost(areas: Any) -> Any:
        aero = replace(scenario.plant.aero, areas=areas)
        perturbed = replace(scenario, plant=replace(scenario.plant, aero=aero))
        return jnp.sum(_rollout(perturbed, state) ** 2)

    return jax.grad(cost)(scenario.plant.aero.areas)


def _dynamics_cases(robot: RobotModel, state: State) -> Iterator[Case]:
    def bundle(backend: Any) -> Callable[[RobotModel, State], Any]:
        return lambda robot, state: dynamics(robot, state, kinematics(robot, state), backend)

    def forward(backend: Any) -> Callable[[RobotModel, State], Any]:
        def accelerate(robot: RobotModel, state: State) -> Any:
            return forward_dynamics(bundle(backend)(robot, state), jnp.ones_like(state.velocity))

        return accelerate

    def gradient(backend: Any) -> Callable[[RobotModel, State], Any]:
        def size(state: State, robot: RobotModel) -> Any:
            return jnp.sum(forward(backend)(robot, state) ** 2)

        return lambda robot, state: jax.grad(size)(state, robot)

    yield Case("kinematics, M, h, A_G (tree)", bundle("tree"), robot, state)
    yield Case("kinematics, M, h, A_G (tree), float32", bundle("tree"), *with_dtype((robot, state), jnp.float32))
    yield Case("kinematics, M, h, A_G (mjx)", bundle("mjx"), robot, state)
    yield Case("forward dynamics (tree)", forward("tree"), robot, state)
    yield Case("forward dynamics (mjx)", forward("mjx"), robot, state)
    yield Case("gradient of forward dynamics (tree)", gradient("tree"), robot, state, is_slow=True)
    yield Case("gradient of forward dynamics (mjx)", gradient("mjx"), robot, state, is_slow=True)


def _aero_cases(robot: RobotModel, state: State, wind: Any) -> Iterator[Case]:
    table = rust.load_config(EXPERIMENTS / "robustness_axisymmetric_vs_sphere_cylinder.toml")
    for name, part in (("axisymmetric", "simulator"), ("sphere and cylinder", "controller")):
        model = aero_model(aero_config(table[part]["aero"]), robot)
        kin = jax.jit(kinematics)(robot, state)

        def forces(shared: Any, kin: Any) -> Any:
            model, robot, wind = shared
            return link_forces(model, robot, kin, LinkConventions(), wind)

        yield Case(f"forces on 13 links ({name})", forces, (model, robot, wind), kin)


def _control_cases(scenario: Any, hover: Any, wind: Any) -> Iterator[Case]:
    time_now = jnp.array(HOVER * 0.01)

    def tick(shared: Any, sample: Any) -> Any:
        params, robot, wind, now = shared
        memory, state, thrust = sample
        return control.tick(params, robot, memory, now, state, thrust, wind)

    shared = (scenario.controller, scenario.plant.robot, wind, time_now)
    sample = (hover.controller, hover.plant.robot, hover.plant.jets.thrust)
    _, _, terms = jax.jit(tick)(shared, sample)

    def solve(start: Any, problem: Any) -> Any:
        return qp.solve(problem, start)

    yield Case("momentum QP, warm", solve, hover.controller.momentum_start, terms.momentum_qp.problem)
    yield Case("torque QP, warm", solve, hover.controller.torque_start, terms.torque_qp.problem)
    yield Case("controller tick", lambda shared, sample: tick(shared, sample)[:2], shared, sample)


def _mjx_cases(robot: RobotModel, state: State) -> Iterator[Case]:
    """Yield the cases of plain MJX on the same URDF: unchanged, with its joint limits, and without constraints."""
    from jax_aero.mujoco.model import mujoco_spec, to_mujoco

    mjx: Any = importlib.import_module("mujoco.mjx")

    for name, flags in (("", 0), (", constraints disabled", None)):
        spec = mujoco_spec(robot.source)
        if flags is not None:
            spec.option.disableflags = flags
        model = spec.compile()
        mjx_model, data = mjx.put_model(model), mjx.make_data(model)

        def load(state: State, data: Any = data) -> Any:
            qpos, qvel = to_mujoco(robot, state)
            return data.replace(qpos=qpos, qvel=qvel)

        for function in (mjx.forward, mjx.step):

            def run(model: Any, state: State, function: Any = function, load: Any = load) -> Any:
                after = function(model, load(state))
                return after.qpos, after.qacc

            # MJX factorises matrices with jaxlib's batched kernels; see `jax_aero.body.linalg`.
            yield Case(f"mjx.{function.__name__}{name}", run, mjx_model, state, in_pieces=True)


if __name__ == "__main__":
    sys.exit(main())
