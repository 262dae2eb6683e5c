"""Compute what flights take on a GPU, without one: `python -m experiments.tools.bench_gpu`.

XLA compiles for an NVIDIA H200 that a text describes, for which it needs JAX's CUDA packages and no device. Of each
program the kernels, library calls and bytes of one pass of a tick are counted; the least time is 2.5 µs for each kernel
and call, and that in which its bytes are moved at 4.8 TB/s. A device takes longer: a call that factorises a batch
counts like any other, and what the host reads to end a loop not at all. It has no caches, and how many passes a QP
needs is counted here, in flights of many robots in turbulence. Prints all of it. The status is 1 if a program takes
more than a twentieth more than in `docs/results/bench_gpu.json`, which `--store` replaces. Where JAX sees a GPU, ticks
a second are measured on it, too.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import topologies

from jax_aero import air, rust, sim
from jax_aero.base.arguments import count
from jax_aero.env import FlightEnv, Task
from jax_aero.results.study import listing
from jax_aero.sim.outcome import FLYING
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.sim.wind import _waves
from jax_aero.stored import keep, kept
from jax_aero.types import replace_values

untyped: Any = jax
"""JAX, for the parts of it that have no types."""

NAME, TITLE = "bench_gpu", "What flights take on an H200, computed without one"
PLUGINS = ("jax_cuda12_plugin", "jax_cuda13_plugin")
KERNEL_TIME = 2.5e-6
"""Time of a kernel or library call, however little it does [s]."""
BANDWIDTH = 4.8e12
"""Of the memory of an H200, by its data sheet [B/s]."""
H200 = """
gpu_device_info {
  cuda_compute_capability { major: 9 }
  core_count: 132 fpus_per_core: 128 clock_rate_ghz: 1.98
  threads_per_warp: 32 threads_per_block_limit: 1024 threads_per_core_limit: 2048
  block_dim_limit_x: 2147483647 block_dim_limit_y: 65535 block_dim_limit_z: 65535
  registers_per_block_limit: 65536 registers_per_core_limit: 65536
  shared_memory_per_block: 49152 shared_memory_per_block_optin: 232448 shared_memory_per_core: 233472
  l2_cache_size: 52428800 memory_bandwidth: 4800000000000 device_memory_size: 151397597184
}
platform_name: "CUDA"
dnn_version_info { major: 9 minor: 10 }
device_description_str: "NVIDIA H200"
"""
"""The device as XLA describes one, by NVIDIA's data sheet and its table of compute capability 9.0."""

TICKS = 100
"""Ticks of a compiled program."""
BATCH, OF_GRADIENT, MEASURED = 4096, 1024, (4096, 32768)
SLACK = 1.05
COMPARED = ("kernels", "library calls", "kB a robot", "at least [ms]")
TURBULENCE = {
    "simulator.duration": 4.0,
    "wind": {
        "profile": "turbulent",
        "velocity": [0.0, -15.0, 0.0],
        "ramp_start": 0.0,
        "ramp_end": 2.0,
        "std": [3.0, 3.0, 1.5],
        "time_scale": 2.0,
    },
}
"""TEST2 in a side wind with turbulence of one fifth of it."""
IN_WIND, TOGETHER = 200, 64
"""First tick at which passes are counted, and flights computed together."""

Figures = dict[str, dict[str, float]]
Program = tuple[Callable[..., Any], Callable[[], tuple[Any, ...]]]
"""A function of `TICKS` ticks of a batch, and what makes its arguments."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.tools.bench_gpu", description=__doc__)
    parser.add_argument("--robots", type=count, default=BATCH, help=f"flights for counting passes (default {BATCH})")
    parser.add_argument("--store", action="store_true", help="store what is computed")
    given = parser.parse_args(arguments)
    if not any(map(importlib.util.find_spec, PLUGINS)):
        print(f"No flight is compiled for a GPU: JAX's CUDA packages ({PLUGINS[0]}) are not installed.")
        return 0
    untyped.config.update("jax_enable_compilation_cache", False)  # of a program for another device nothing is kept
    os.environ.setdefault("JAX_SKIP_CUDA_CONSTRAINTS_CHECK", "1")  # its versions of libraries are those of a driver
    figures = compute(given.robots)
    print(listing(figures))
    if jax.default_backend() == "gpu":
        print(listing({f"{name}, {size} robots": measure(name, size) for size in MEASURED for name in RATES}))
    more = [] if given.store else above(figures)
    if given.store:
        about = f"XLA's program for an H200, not measured; jax {jax.__version__}; passes of {given.robots} robots"
        keep.benchmark(NAME, TITLE, about, "python -m experiments.tools.bench_gpu --store", figures)
    print("\n".join(f"{name}: a twentieth more than what is stored" for name in more))
    return int(bool(more))


# --- programs -------------------------------------------------------------------------------------------------------


def _tick(batch: int) -> Program:
    scenario, start = sim.prepare(rust.load_config("test2", {"simulator.duration": 1.0}), dtype=np.float32)

    def run(scenario: Any, states: Any) -> Any:
        def tick(states: Any, number: Any) -> Any:
            states, row = jax.vmap(lambda state: sim.step(scenario, state, number))(states)
            return states, row["rotation_error"]

        return jax.lax.scan(tick, states, jnp.arange(TICKS))

    return run, lambda: (scenario, _repeat(start, batch))


def _environment(batch: int) -> Program:
    environment = FlightEnv(Task(wind_max=15.0))
    actions = jnp.zeros((batch, environment.action_size), jnp.float32)

    def run(states: Any) -> Any:
        def tick(states: Any, _: Any) -> Any:
            states = jax.vmap(environment.step)(states, actions)
            return states, states.reward

        return jax.lax.scan(tick, states, None, TICKS)

    return run, lambda: (jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), batch)),)


def _mjx(batch: int) -> Program:
    cpu, model = jax.devices("cpu")[0], air.mujoco_model()
    put, data = air.mjx.put_model(model, impl="jax", device=cpu), air.mjx.make_data(model, impl="jax", device=cpu)

    def run(model: Any, states: Any) -> Any:
        def tick(states: Any, _: Any) -> Any:
            states = jax.vmap(partial(air.mjx.step, model))(states)
            return states, states.qpos[:, 0]

        return jax.lax.scan(tick, states, None, TICKS)

    return run, lambda: (put, _repeat(data, batch))


def _gradient(batch: int) -> Program:
    """Return the first page's gradient, for a batch of winds."""
    make = _tick(batch)[1]

    def run(scenario: Any, states: Any, winds: Any) -> Any:
        def cost(wind: Any, state: Any) -> Any:
            flown = replace_values(scenario, {"wind.velocity": wind})
            return jnp.sum(sim.rollout(flown, state, TICKS, lambda row: row["rotation_error"] ** 2)[1])

        return jax.vmap(jax.grad(cost))(winds, states)

    return run, lambda: (*make(), jnp.zeros((batch, 3), jnp.float32))


def _repeat(tree: Any, batch: int) -> Any:
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (batch, *jnp.shape(x))), tree)


TICK, ENVIRONMENT, MJX, GRADIENT = "closed-loop tick, TEST2", "FlightEnv.step", "mjx.step", f"gradient of {TICKS} ticks"
RATES = {TICK: _tick, ENVIRONMENT: _environment, MJX: _mjx}
OWN, SLOWEST = "passes in a tick", "of the slowest robot"
QPS = "the momentum QP", "the torque QP"
"""In the order in which a tick solves them."""


# --- counting -------------------------------------------------------------------------------------------------------

INSTRUCTION = re.compile(r"^\s*(?:ROOT )?%(\S+) = (.*?) ([a-z][a-z-]*)\((.*?)\)(?:, (.*))?$")
ARRAY = re.compile(r"\b(pred|[a-z]+\d+)\[([\d,]*)\]")
NOTHING_RUNS = {"parameter", "get-tuple-element", "tuple", "bitcast", "constant", "after-all"}


class Loop(NamedTuple):
    """A computation, the entry of a program or the body of a loop, without its inner loops."""

    passes: int | None
    """Number of passes, if that is fixed."""
    shapes: str
    """Of all that it carries."""
    kernels: int
    calls: int
    moved: float
    """Bytes read and written in a pass."""
    inner: tuple[Loop, ...]

    @property
    def least(self) -> float:
        """Return the least time of a pass [s]."""
        return (self.kernels + self.calls) * KERNEL_TIME + self.moved / BANDWIDTH


def read(text: str) -> Loop:
    """Return what the program does whose optimised instructions, as XLA prints them, are `text`.

    An array with an entry for each pass of a loop counts in it with one entry.

    Raises
    ------
    ValueError
        For instructions that are not understood.
    """
    computations: dict[str, list[re.Match[str]]] = {}
    name = entry = ""
    for line in text.splitlines():
        if head := re.match(r"^(ENTRY )?%(\S+) \(.*\{$", line):
            name = head[2]
            computations[name], entry = [], name if head[1] else entry
        elif name and (match := INSTRUCTION.match(line)):
            computations[name].append(match)
    if not entry:
        raise ValueError("the program has no entry")
    return _loop(computations, entry, 1, "")


def _loop(computations: Mapping[str, list[re.Match[str]]], name: str, passes: int | None, shapes: str) -> Loop:
    sizes: dict[str, int] = {}
    kernels, calls, moved, inner = 0, 0, 0, []
    for instruction in computations[name]:
        result, shape, what, inputs, rest = instruction.groups(default="")
        sizes[result] = sum(_bytes(kind, dims, passes) for kind, dims in ARRAY.findall(shape))
        if what == "while":
            trips = re.search(r'"known_trip_count":\{"n":"(\d+)"', rest)
            body = re.search(r"body=%([^\s,]+)", rest)
            if body is None:
                raise ValueError(f"{result} has no body")
            inner.append(_loop(computations, body[1], int(trips[1]) if trips else None, shape))
        elif what in ("call", "conditional"):
            raise ValueError(f"{result} is a {what}, in which nothing is counted")
        elif what not in NOTHING_RUNS:
            calls += what == "custom-call"
            kernels += what != "custom-call"
            moved += sizes[result] + sum(sizes.get(one, 0) for one in re.findall(r"%([^\s,]+)", inputs))
    return Loop(passes, shapes, kernels, calls, float(moved), tuple(inner))


def _bytes(kind: str, dims: str, passes: int | None) -> int:
    numbers = [int(dim) for dim in dims.split(",") if dim]
    if len(numbers) > 1 and numbers[0] == passes:
        del numbers[0]
    bits = int(re.sub(r"\D", "", kind) or 8)
    return -(-bits * int(np.prod(numbers)) // 8)


def compile_for_h200(run: Callable[..., Any], arguments: Any) -> Any:
    """Return a program compiled for an H200, of arguments of these shapes, as XLA's defaults do."""
    topology = topologies.get_topology_desc(platform="cuda", topology_name="h200", target_config=H200, topology="1x1x1")
    mesh = jax.sharding.Mesh(np.array(topology.devices), ("flights",))
    place = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())  # type: ignore[no-untyped-call]
    lowered = jax.jit(run, in_shardings=place, out_shardings=place).lower(*arguments)
    options: dict[str, Any] = {"xla_backend_optimization_level": 0}  # of what is in a kernel, which nobody runs
    return lowered.compile(compiler_options=options)


def passes_of(robots: int) -> Figures:
    """Return the passes of each QP in a tick: the mean of the robots that are not lost, and of the slowest of them."""
    scenario, start = sim.prepare(rust.load_config("test2", TURBULENCE), dtype=np.float32)
    waves = [np.stack(drawn).astype(np.float32) for drawn in zip(*map(_waves, range(robots)), strict=True)]

    def fly(waves: Any) -> Any:
        windy = replace_values(scenario, dict(zip(("wind.places", "wind.phases"), waves, strict=True)))
        end, passes = sim.rollout(windy, start, int(scenario.n_ticks), lambda row: row["qp_iterations"])
        return end.loss, passes[IN_WIND:]

    many = jax.jit(partial(jax.lax.map, fly, batch_size=TOGETHER), compiler_options=COMPILER_OPTIONS)
    loss, passes = jax.device_get(many(waves))
    flown = np.moveaxis(passes[loss == FLYING], -1, 0)
    return {
        name: {OWN: float(own.mean()), SLOWEST: float(own.max(axis=0).mean()), "robots": len(own)}
        for name, own in zip(QPS, flown, strict=True)
    }


def compute(robots: int) -> Figures:
    """Return figures by program: what a tick takes without passes of QPs, a pass of each, and both together."""
    with jax.default_device(jax.devices("cpu")[0]):
        passes = passes_of(robots)
        print(listing(passes), flush=True)
        figures: Figures = {}
        for name, program in (RATES | {GRADIENT: _gradient}).items():
            figures |= _of_program(name, program, passes)
    return figures


def _of_program(name: str, program: Callable[[int], Program], passes: Figures) -> Figures:
    batch = OF_GRADIENT if name == GRADIENT else BATCH
    started = time.perf_counter()
    run, make = program(batch)
    compiled = compile_for_h200(run, jax.eval_shape(make))
    workspace = compiled.memory_analysis().temp_size_in_bytes
    loops = [loop for loop in read(compiled.as_text()).inner if loop.passes == TICKS]
    names = [f"{name}, {way}" for way in ("forward", "backward")] if len(loops) > 1 else [name]
    figures: Figures = {}
    for part, loop in zip(names, loops, strict=True):
        of_qps = sum(passes[qp][SLOWEST] * inner.least for qp, inner in zip(QPS, loop.inner, strict=False))
        figures[part] = _figures(loop, batch) | {"with QPs, at least [ms]": 1e3 * (loop.least + of_qps)}
        if name == TICK:
            figures |= {
                f"a pass of {qp}": _figures(inner, batch) | passes[qp]
                for qp, inner in zip(QPS, loop.inner, strict=True)
            }
    figures[names[0]] |= {
        "robots": batch,
        "workspace of a tick [kB a robot]": workspace / batch / TICKS / 1e3,
    }
    print(f"{name}: compiled in {time.perf_counter() - started:.0f} s", flush=True)
    return figures


def _figures(loop: Loop, batch: int) -> dict[str, float]:
    values = loop.kernels, loop.calls, loop.moved / batch / 1e3, 1e3 * loop.least
    return dict(zip(COMPARED, values, strict=True))


def measure(name: str, batch: int) -> dict[str, float]:
    """Return ticks a second of many robots on JAX's default device."""
    run, make = RATES[name](batch)
    arguments = jax.device_put(make(), jax.devices()[0])
    compiled = jax.jit(run).lower(*arguments).compile()
    times = []
    for _ in range(4):  # the first one does not count
        started = time.perf_counter()
        untyped.block_until_ready(compiled(*arguments))
        times.append(time.perf_counter() - started)
    return {"ticks a second": batch * TICKS / min(times[1:])}


def above(figures: Figures) -> list[str]:
    """Return what takes more than is stored, by program and figure."""
    stored = kept.read(NAME).summary
    return [
        f"{name}, {figure}"
        for name in figures
        for figure in COMPARED
        if figures[name].get(figure, 0.0) > SLACK * stored.get(name, {}).get(figure, 0.0)
    ]


if __name__ == "__main__":
    sys.exit(main())
