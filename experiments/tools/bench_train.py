"""Measure what training takes: `taskset -c 0 python -m experiments.tools.bench_train`.

A step of our loop with each network is measured in turns with NumPy's product of two matrices of 2048 × 2048 in single
precision, whose rate is what the machine reaches at the same time, and with the same step of PyTorch on one thread,
where it is installed. Times are processor times of one core, in which other programs do not count, though they empty
its caches: each is the least of some turns. `--dataset`, the public free-stream table by `jax-aero data import-cfd`,
also measures the processor time, with compilation, in which one network of `compact.toml` reaches the paper's error on
the paper's random rows. Prints all of it. The status is 1 if a network reaches a share of NumPy's rate more than a
tenth below that of `docs/results/bench_train.json`, which `--store` replaces.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from msgspec import structs

from jax_aero.aero.dataset import load
from jax_aero.aero.network import Network
from jax_aero.base import places
from jax_aero.base.arguments import count
from jax_aero.results import manifest
from jax_aero.results.study import listing
from jax_aero.stored import keep, kept
from jax_aero.train import config, loop, samples_of
from jax_aero.train.adam import adam_start
from jax_aero.train.parts import parts

untyped: Any = jax
"""JAX, for the parts of it that have no types."""

NAME, TITLE = "bench_train", "What training takes"
SHARE, RATE, TORCH = "share of NumPy's", "GFLOP/s", "PyTorch's share of NumPy's"
SLACK = 0.9
PRODUCT = 2048
"""Rows and columns of NumPy's matrices, and rows of a batch."""
PEER = "PyTorch, "
"""Of the name of a network that PyTorch trains."""
NETWORKS = {"10 × 1024": 10 * (1024,), "4 × 256": 4 * (256,), "4 × 128": 4 * (128,)}
"""Hidden layers by name; inputs and outputs are those of the paper's network, the first, which alone has dropout."""
ROWS = 2 * 4826
"""Rows of the paper's free-stream table, with their mirror images."""
PAPER_ERROR = 3e-6
"""Greatest error on unseen rows that the paper reports [m⁴]; taken as a mean over the components of a row."""
H200 = 67e12
"""Operations a second of an NVIDIA H200 in single precision, by its data sheet."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.tools.bench_train", description=__doc__)
    parser.add_argument("--turns", type=count, default=15, help="number of runs of everything (default 15)")
    parser.add_argument("--dataset", type=Path, metavar="FILE", help="measure the time to the paper's error on it")
    parser.add_argument("--store", action="store_true", help="store what is measured")
    given = parser.parse_args(arguments)
    figures = measure(networks() | peers(), given.turns)
    if given.dataset:
        figures["compact, to the paper's error"] = time_to_error(given.dataset)
    print(listing(figures))
    slower = [] if given.store else below(figures)
    if given.store:
        command = "taskset -c 0 python -m experiments.tools.bench_train --store"
        command += " --dataset results/datasets/freestream.nc" * bool(given.dataset)
        used = {**manifest.versions("jax"), **manifest.version_of("torch")}
        packages = ", ".join(f"{name} {used[name]}" for name in ("numpy", "jax", "torch") if name in used)
        keep.benchmark(
            NAME,
            TITLE,
            f"{manifest.device()['cpu']}; one thread; batches of {PRODUCT} rows; {packages}",
            command,
            figures,
        )
    print("\n".join(f"{name}: more than a tenth below what is stored" for name in slower))
    return int(bool(slower))


def networks() -> dict[str, tuple[float, Callable[[], Any]]]:
    """Return floating-point operations and functions by name: NumPy's product, and steps of our loop."""
    rng = np.random.default_rng(0)
    left, right = rng.normal(size=(2, PRODUCT, PRODUCT)).astype(np.float32)
    cases = {"NumPy": (2.0 * PRODUCT**3, lambda: left @ right)}
    training, _ = config.read(places.CONFIGS / "training" / "paper.toml")
    for name, hidden in NETWORKS.items():
        dropout = training.training.dropout if hidden == training.network.hidden else 0.0
        settings = structs.replace(training.training, batch=PRODUCT, dropout=dropout)
        network = structs.replace(training, network=structs.replace(training.network, hidden=hidden)).start(0)
        cases[name] = 6.0 * PRODUCT * weights(network), step_of(network, settings, rng)
    return cases


def weights(network: Network) -> int:
    """Return the number of weights, of which each takes six operations in a step: two forward, four backward."""
    return sum(layer.weight.size for layer in network.layers)


def step_of(network: Network, settings: loop.Settings, rng: np.random.Generator) -> Callable[[], Any]:
    """Return an epoch of one batch."""
    sizes = network.layers[0].weight.shape[-1], network.scale.size
    x, y = (jnp.asarray(rng.normal(size=(PRODUCT, size)), jnp.float32) for size in sizes)
    state, zero = loop._State(network.layers, adam_start(network.layers)), jnp.uint32(0)
    given = state, (x, y, ()), jnp.zeros(sizes[0]), zero, zero
    return lambda: untyped.block_until_ready(
        loop._epoch(settings, loop.FORCE_AREAS, network.activation, PRODUCT, *given)
    )


def peers() -> dict[str, tuple[float, Callable[[], Any]]]:
    """Return floating-point operations and the same steps of PyTorch by name; nothing where it is not installed."""
    try:
        import torch  # type: ignore[import-not-found,unused-ignore]
    except ModuleNotFoundError:
        return {}
    torch.set_num_threads(1)
    training, _ = config.read(places.CONFIGS / "training" / "paper.toml")
    network = training.start(0)
    inputs, outputs = network.layers[0].weight.shape[-1], network.scale.size
    cases: dict[str, tuple[float, Callable[[], Any]]] = {}
    for name, hidden in NETWORKS.items():
        dropout = training.training.dropout if hidden == training.network.hidden else 0.0
        sizes = (inputs, *hidden, outputs)
        modules = []
        for number, (start, end) in enumerate(pairwise(sizes)):
            modules.append(torch.nn.Linear(start, end))
            if number < len(hidden):
                modules.append(torch.nn.ReLU())
            if dropout and 0 < number < len(hidden):
                modules.append(torch.nn.Dropout(dropout))
        net = torch.nn.Sequential(*modules)
        x, y = torch.randn(PRODUCT, inputs), torch.randn(PRODUCT, outputs)
        step = partial(_torch_step, net, torch.optim.Adam(net.parameters(), lr=training.training.learning_rate), x, y)
        numbers = sum(parameter.numel() for parameter in net.parameters() if parameter.ndim == 2)
        cases[PEER + name] = 6.0 * PRODUCT * numbers, step
    return cases


def _torch_step(net: Any, adam: Any, x: Any, y: Any) -> float:
    adam.zero_grad()
    loss = ((net(x) - y) ** 2).sum(1).mean()
    loss.backward()
    adam.step()
    return float(loss.detach())


def measure(cases: Mapping[str, tuple[float, Callable[[], Any]]], turns: int) -> dict[str, dict[str, float]]:
    """Return figures by case, of the fastest of some runs in turns."""
    best = dict.fromkeys(cases, np.inf)
    for turn in range(turns + 1):
        for name, (_, run) in cases.items():
            started = time.process_time()
            run()
            if turn:  # the first one compiles
                best[name] = min(best[name], time.process_time() - started)
    rates = {name: work / best[name] for name, (work, _) in cases.items()}
    products = [name for name in ("NumPy", *NETWORKS) if name in cases]
    figures = {name: {RATE: rates[name] / 1e9, SHARE: rates[name] / rates["NumPy"]} for name in products}
    for name in products:
        if PEER + name in rates:
            figures[name][TORCH] = rates[PEER + name] / rates["NumPy"]
    paper = next(iter(NETWORKS))
    training, _ = config.read(places.CONFIGS / "training" / "paper.toml")
    operations = 6.0 * weights(training.start(0)) * ROWS * training.training.epochs
    figures["the paper's network, all epochs"] = {
        "operations": operations,
        "on one core here [h]": operations / rates[paper] / 3600.0,
        "on an H200 at its peak [min]": operations / H200 / 60.0,
    }
    return figures


def time_to_error(dataset: Path) -> dict[str, float]:
    """Return when one network of `compact.toml` reaches the paper's error on the paper's random rows, and its least."""
    training, _ = config.read(places.CONFIGS / "training" / "compact.toml")
    rows = load(dataset, training.robot_model).add_mirror_images()
    part = next(part for part in parts(training, rows) if part.split == "random")
    network = training.start(training.seed)
    seen, unseen = (samples_of(network, training.robot_model, rows.take(of)) for of in (part.train, part.held_out))
    settings = structs.replace(training.training, validate_every=1)
    started, curve = time.process_time(), list[tuple[float, float]]()

    def on_epoch(_: int, __: float, error: float | None) -> None:
        assert error is not None
        curve.append((error / unseen.y.shape[1], time.process_time() - started))

    loop.fit(network, seen, unseen, settings, training.seed, on_epoch=on_epoch)
    reached = [number for number, (error, _) in enumerate(curve) if error <= PAPER_ERROR]
    figures = {"least error [m4]": min(error for error, _ in curve), "all epochs [s]": curve[-1][1]}
    if reached:
        figures |= {"epochs": reached[0] + 1, "to the paper's error [s]": curve[reached[0]][1]}
    return figures


def below(figures: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return the networks whose share of NumPy's rate is below what is stored."""
    stored = kept.read(NAME).summary
    return [name for name in NETWORKS if figures[name][SHARE] < SLACK * stored[name][SHARE]]


if __name__ == "__main__":
    sys.exit(main())
