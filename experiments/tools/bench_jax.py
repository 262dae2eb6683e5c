"""Measure parts of a JAX flight and their gradients in one run: `python -m experiments.tools.bench_jax`.

Times are of the processor, per sample of a batch, in double precision, on JAX's default device, the least of turns in
which all that is measured runs once: so ratios hold beside other programs. Compilation is cold or from JAX's
persistent cache; its memory are the temporaries of a program, per sample of the greatest batch. States are those of
TEST2, and of `robot`, hovering in the full wind; episodes out of step plan at different ticks. `mjx.step` steps TEST2's
robot from the same states without forces: without constraints, and with joint stops, which our tick has too. Prints a
Markdown table, and stores with `--store` what the greatest batch takes (`docs/results/bench_jax.json`).
"""

from __future__ import annotations

import argparse
import copy
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco  # type: ignore[import-untyped]
import numpy as np

from jax_aero import air, rust, sim
from jax_aero.base.arguments import count
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.kinematics import kinematics
from jax_aero.body.mujoco_model import to_mujoco
from jax_aero.body.robot import RobotModel
from jax_aero.results import manifest
from jax_aero.sim.rollout import fly_chunk
from jax_aero.stored import keep
from jax_aero.types import State
from jax_aero.verify import UNOPTIMISED

untyped: Any = jax
"""JAX, for the parts of it that have no types."""

Times = dict[str, dict[int, float]]

NAME, TITLE = "bench_jax", "What ticks take in JAX"
UNIT, RATIO, COMPILE = "[µs]", "of TEST2's tick", "compile [s]"
HOVER = 1000
"""Tick of TEST2 at which the states are taken: hovering in the full wind."""
TICKS = 20
"""Ticks per measured rollout."""
GRADIENT_TICKS = 100
"""Ticks of a gradient of `robot`."""
TURNS = 7
"""Least number of turns."""
AT_LEAST = 0.2
"""Processor time of a case in a turn, in which it runs again [s]."""


class Case(NamedTuple):
    """A function of one sample, with samples."""

    name: str
    function: Callable[..., Any]
    shared: Any
    """First argument, shared by the whole batch."""
    samples: tuple[Any, ...]
    """Second argument of every sample, in turns; the State in it varies over the batch."""
    divide_by: int = 1
    """Number of units in a sample, such as the ticks of a rollout."""
    options: Mapping[str, Any] = sim.COMPILER_OPTIONS
    """Of its compilation."""


class Measured(NamedTuple):
    """A case, compiled for batches of some sizes."""

    case: Case
    compiled: dict[int, Any]
    batches: dict[int, Any]
    cold: float
    """Greatest time of compilation [s]."""
    cached: float
    """That of the greatest batch from the cache [s]."""

    def run(self, size: int) -> float:
        """Return the processor time of a sample and unit [s]."""
        started = time.process_time()
        untyped.block_until_ready(self.compiled[size](self.case.shared, self.batches[size]))
        return (time.process_time() - started) / size / self.case.divide_by

    def memory(self, size: int) -> float:
        """Return the temporaries of a sample [kB]."""
        return float(self.compiled[size].memory_analysis().temp_size_in_bytes) / size / 1e3


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.tools.bench_jax", description=__doc__)
    parser.add_argument("--batch", type=count, nargs="+", default=[1, 64], help="batch sizes (default 1 64)")
    parser.add_argument("--only", default="", metavar="WORDS", help="only what has these words in its name")
    parser.add_argument("--turns", type=count, default=TURNS, help=f"number of runs of everything (default {TURNS})")
    parser.add_argument("--store", action="store_true", help="store what the greatest batch takes")
    options = parser.parse_args(arguments)
    sizes = options.batch
    untyped.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as cache:
        untyped.config.update("jax_compilation_cache_dir", cache)
        untyped.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        print(_machine(), flush=True)
        measured = [_prepare(case, sizes) for case in _all_cases() if options.only in case.name]
    times = _take_turns(measured, sizes, options.turns)
    base = next((times[each.case.name] for each in measured if each.case.name == _title("TEST2")), None)
    heads = "".join(f" batch {size} | {RATIO} |" for size in sizes)
    print(f"| what |{heads} memory | compile, cold | cached |\n|---|{'---|' * (2 * len(sizes) + 3)}")
    for each in measured:
        print(_row(each, sizes, times[each.case.name], base))
    if options.store:
        _store(measured, max(sizes), times, base, sys.argv[1:] if arguments is None else arguments)
    return 0


def _store(
    measured: list[Measured], size: int, times: Times, base: dict[int, float] | None, words: Sequence[str]
) -> None:
    found = {}
    for each in measured:
        taken = times[each.case.name][size]
        found[each.case.name] = {UNIT: 1e6 * taken, "temporaries [kB]": each.memory(size), COMPILE: each.cold}
        found[each.case.name] |= {} if base is None else {RATIO: taken / base[size]}
    about = f"{manifest.device()['cpu']}; batch of {size}; double precision; jax {jax.__version__}"
    keep.benchmark(NAME, TITLE, about, " ".join(["python -m experiments.tools.bench_jax", *words]), found)


def _machine() -> str:
    device = jax.devices()[0]
    versions = manifest.versions("jax")
    facts = f"{device.device_kind} ({device.platform}), {manifest.processors()} cores; jax {jax.__version__}, "
    text = f"Device: {facts}numpy {versions.get('numpy', '?')}; load {os.getloadavg()[0]:.1f}\n"
    if os.getloadavg()[0] > 0.5 * manifest.processors():
        text += "The machine is busy: ratios are more reliable than times.\n"
    return text


def _prepare(case: Case, sizes: Sequence[int]) -> Measured:
    batches = {size: _spread(case.samples, size) for size in sizes}
    compiled, colds = {}, []
    for size in sizes:
        compiled[size], cold = _compile(case, batches[size])
        colds.append(cold)
    untyped.clear_caches()
    return Measured(case, compiled, batches, max(colds), _compile(case, batches[max(sizes)])[1])


def _take_turns(measured: Sequence[Measured], sizes: Sequence[int], turns: int) -> Times:
    """Return the least processor time of a sample and unit [s], by case and batch size.

    A short case runs several times in a turn: its first run may pay for memory that a large case before it leaves.
    """
    times: Times = {each.case.name: dict.fromkeys(sizes, float("inf")) for each in measured}
    for turn in range(turns + 1):
        for each in measured:
            for size in sizes:
                started = time.process_time()
                while True:
                    taken = each.run(size)
                    if turn:  # the first one warms up
                        times[each.case.name][size] = min(times[each.case.name][size], taken)
                    if time.process_time() - started > AT_LEAST:
                        break
    return times


def _row(each: Measured, sizes: Sequence[int], times: dict[int, float], base: dict[int, float] | None) -> str:
    figures = "".join(
        f" {1e6 * times[size]:.1f} µs | {'' if base is None else f'{times[size] / base[size]:.1f}'} |" for size in sizes
    )
    return f"| {each.case.name} |{figures} {each.memory(max(sizes)):.0f} kB | {each.cold:.1f} s | {each.cached:.1f} s |"


def _compile(case: Case, sample: Any) -> tuple[Any, float]:
    started = time.process_time()
    batched: Any = jax.vmap(case.function, in_axes=(None, 0))
    compiled = jax.jit(batched, compiler_options=dict(case.options)).lower(case.shared, sample).compile()
    return compiled, time.process_time() - started


def _spread(samples: Sequence[Any], size: int) -> Any:
    """Return a batch of the samples in turns, with small differences in every State they contain."""
    rng = np.random.default_rng(0)
    which = np.arange(size) % len(samples)

    def vary(*leaves: Any) -> Any:
        if not isinstance(leaves[0], State):
            return jnp.stack([jnp.asarray(leaf) for leaf in leaves])[which]
        repeated = jax.tree.map(lambda *parts: jnp.stack(parts)[which], *leaves)
        noise = jnp.asarray(0.02 * rng.normal(size=repeated.velocity.shape), repeated.velocity.dtype)
        return repeated._replace(velocity=repeated.velocity + noise)

    return jax.tree.map(vary, *samples, is_leaf=lambda x: isinstance(x, State))


# --- cases ----------------------------------------------------------------------------------------------------------


def _hovering(name: str) -> tuple[Any, Any]:
    """Return the scenario of an experiment and its state while hovering in the full wind."""
    config = scenario_config(rust.load_config(name))
    scenario, start = sim.prepare(config)
    return scenario, fly_chunk(scenario, start, jnp.array(0, jnp.int32), HOVER)[0]


def _all_cases() -> Iterator[Case]:
    scenario, hover = _hovering("test2")
    yield from cases(scenario, hover)
    yield from cases_of_mjx(scenario.plant.robot, hover.plant.robot)
    yield from cases_of_robot(*_hovering("robot"))


def cases(scenario: Any, hover: Any) -> Iterator[Case]:
    """Yield all cases to measure of TEST2."""
    robot, state = scenario.plant.robot, hover.plant.robot
    yield Case("forward dynamics (tree)", _forward("tree"), robot, (state,))
    for backend in ("tree", "mjx"):
        yield Case(f"gradient of forward dynamics ({backend})", _forward_gradient(backend), robot, (state,))
    begun = hover, jnp.asarray(HOVER, jnp.int32)
    yield Case(_title("TEST2"), _rollout, scenario, (begun,), TICKS)
    yield Case(f"gradient of TEST2 by the aerodynamic areas, of {TICKS} ticks", _gradient, scenario, (begun,), TICKS)


def cases_of_mjx(robot: RobotModel, state: State) -> Iterator[Case]:
    """Yield MJX's step of the robot: without constraints, and with the joints' stops."""
    free = air.mujoco_model()
    stopped = copy.copy(free)
    stopped.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    solver = mujoco.mjtSolver(stopped.opt.solver).name.removeprefix("mjSOL_").capitalize()
    iterations = f"{solver}'s method, at most {stopped.opt.iterations} iterations"
    for what, model in {"without joint stops": free, f"with joint stops ({iterations})": stopped}.items():
        shared = robot, air.mjx.put_model(model, impl="jax"), air.mjx.make_data(model, impl="jax")
        yield Case(f"mjx.step {what}, of a rollout of {TICKS}", _steps_of_mjx, shared, (state,), TICKS)


def cases_of_robot(scenario: Any, hover: Any) -> Iterator[Case]:
    """Yield all cases to measure of `robot`."""
    later = fly_chunk(scenario, hover, jnp.asarray(HOVER, jnp.int32), 1)[0]
    begun = [(state, jnp.asarray(HOVER + tick, jnp.int32)) for tick, state in enumerate((hover, later))]
    yield Case(_title("robot"), _rollout, scenario, (begun[0],), TICKS)
    yield Case(f"{_title('robot')}, episodes out of step", _rollout, scenario, tuple(begun), TICKS)
    # Optimised, it compiles for more than ten minutes.
    name = f"gradient of robot by a gain, of {GRADIENT_TICKS} ticks, not optimised"
    yield Case(name, _gradient_of_gain, scenario, (begun[0],), GRADIENT_TICKS, UNOPTIMISED)


def _title(name: str) -> str:
    return f"closed-loop tick of {name}, of a rollout of {TICKS}"


def _forward(backend: Any) -> Callable[[RobotModel, State], Any]:
    def accelerate(robot: RobotModel, state: State) -> Any:
        terms = dynamics(robot, state, kinematics(robot, state), backend)
        return forward_dynamics(terms, jnp.ones_like(state.velocity))

    return accelerate


def _forward_gradient(backend: Any) -> Callable[[RobotModel, State], Any]:
    def size(state: State, robot: RobotModel) -> Any:
        return jnp.sum(_forward(backend)(robot, state) ** 2)

    return lambda robot, state: jax.grad(size)(state, robot)


def _rollout(scenario: Any, begun: tuple[Any, Any], ticks: int = TICKS) -> Any:
    return sim.rollout(scenario, begun[0], ticks, lambda row: row["com_position"], begun[1])[1]


def _steps_of_mjx(shared: tuple[RobotModel, Any, Any], state: State) -> Any:
    robot, model, data = shared
    position, velocity = to_mujoco(robot, state)
    begun = data.replace(qpos=position, qvel=velocity)

    def step(data: Any, _: None) -> tuple[Any, Any]:
        data = air.mjx.step(model, data)
        return data, data.qpos[:3]

    return jax.lax.scan(step, begun, None, TICKS)[1]


def _gradient(scenario: Any, begun: tuple[Any, Any]) -> Any:
    def cost(areas: Any) -> Any:
        aero = replace(scenario.plant.aero, areas=areas)
        perturbed = replace(scenario, plant=replace(scenario.plant, aero=aero))
        return jnp.sum(_rollout(perturbed, begun) ** 2)

    return jax.grad(cost)(scenario.plant.aero.areas)


def _gradient_of_gain(scenario: Any, begun: tuple[Any, Any]) -> Any:
    controller = scenario.controller

    def cost(gain: Any) -> Any:
        changed = replace(controller, torque=replace(controller.torque, kp=gain))
        return jnp.sum(_rollout(replace(scenario, controller=changed), begun, GRADIENT_TICKS) ** 2)

    return jax.grad(cost)(controller.torque.kp)


if __name__ == "__main__":
    sys.exit(main())
