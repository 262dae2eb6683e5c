"""Measure the symbolic implementation: `python -m experiments.bench_symbolic`.

It prints a Markdown table for `docs/benchmarks.md`.

Measures wall time and processor time of import, construction and evaluation of expressions, and a trim. Optimal
trajectories take a minute or more; their times are in the manifests of `results/trajectory/`.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from experiments import trim
from jax_aero import places
from jax_aero.files import read_json
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.aero import load_aero


class Time(NamedTuple):
    """Wall time and processor time: medians over repetitions [s]."""

    wall: float
    processor: float


def main() -> int:
    """Measure and print."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    print("| what | wall time | processor time |\n|---|---|---|")
    for what, spent in _rows():
        print(f"| {what} | {_format_time(spent.wall)} | {_format_time(spent.processor)} |")
    return 0


def _rows() -> Iterator[tuple[str, Time]]:
    code = "import time; a = time.perf_counter(), time.process_time(); import {}; print(time.perf_counter() - a[0], "
    code += "time.process_time() - a[1])"
    for module in ("casadi", "jax_aero.symbolic"):
        yield f"import {module}", _time_import(code.format(module))

    robot = load_robot(places.CONFIGS / "robot/ironcub_mk1.toml")
    aero = load_aero(places.CONFIGS / "aero/axisymmetric_corrected.toml")
    yield "build all expressions of iRonCub-Mk1", _median(lambda: MomentumModel(robot, aero), 3)
    rng = np.random.default_rng(0)
    state = (rng.normal(size=3), np.eye(3), rng.normal(size=23), rng.normal(size=29), np.full(4, 100.0), np.ones(3))
    yield "… and the function of all terms", _median(lambda: MomentumModel(robot, aero).terms(*state), 3)
    model = MomentumModel(robot, aero)
    model.terms(*state)
    yield "all terms of one state", _median(lambda: model.terms(*state), 50)

    for name in ("hover_posture", "free_joints"):
        started = time.perf_counter(), time.process_time()
        config = trim.MAP.read(name)[1]
        problem = trim.build(config)
        yield (
            f"build the problem: {config.title.lower()}",
            Time(time.perf_counter() - started[0], time.process_time() - started[1]),
        )
        for wind, words in (((0.0, 0.0, 0.0), "still air"), ((0.0, -10.0, 0.0), "10 m/s side wind")):
            yield f"solve it, {words}", _median(lambda: problem.solve(wind, objective="max_margin"), 5)  # noqa: B023 used at once
    for path in sorted((places.RESULTS / "trajectory").glob("*/manifest.json")):
        document = read_json(path)
        for step in ("build", "solve"):
            wall = document["timings_s"][step]
            yield f"{step} the trajectory, {document['title'].lower()} (manifest)", Time(wall, float("nan"))


def _time_import(code: str) -> Time:
    runs = []
    for _ in range(5):
        said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
        runs.append((float(said[0]), float(said[1])))
    return Time(statistics.median(run[0] for run in runs), statistics.median(run[1] for run in runs))


def _median(work: Callable[[], object], times: int) -> Time:
    walls, processors = [], []
    for _ in range(times):
        wall, processor = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return Time(statistics.median(walls), statistics.median(processors))


def _format_time(seconds: float) -> str:
    if np.isnan(seconds):
        return "–"
    return f"{seconds:.2f} s" if seconds >= 1.0 else f"{1000 * seconds:.3g} ms"


if __name__ == "__main__":
    sys.exit(main())
