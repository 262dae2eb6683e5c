"""Measure the crate, Pinocchio, DAQP, PIQP, OSQP and Clarabel in one run: `python -m experiments.bench`.

All use the same states and problems, which the crate's benchmark `side_by_side` writes to `target/side_by_side`.
Ours, Pinocchio, DAQP and Clarabel are separate compiled programs, which run in turns; the others are called from
Python.
Prints the Markdown tables of `docs/benchmarks.md`.
"""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments import Refused, manifest
from experiments.bench_native import (
    CASES_OF_PLANS,
    FOLDER,
    PLANS,
    QPS,
    QPS_OF_TICK,
    Times,
    build,
    run,
    take_turns,
    tick_times,
)
from jax_aero.base import files
from jax_aero.cli import count
from jax_aero.rust import QpProblem

Array = NDArray[np.float64]
Rows = Iterator[tuple[str, str, float]]
"""Operation, library, time [ns]."""

DYNAMICS = ("dynamics, without Jacobians", "dynamics, with 17 frame Jacobians")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.bench", description=__doc__)
    parser.add_argument("--turns", type=count, default=5, help="number of runs of every native program (default 5)")
    parser.add_argument("--native", action="store_true", help="compile for this processor, not any x86-64")
    given = parser.parse_args(arguments)
    try:
        with files.lock_work(FOLDER):  # two benchmarks at once would measure each other
            _print_machine(native=given.native)
            programs = build(native=given.native)
            ours, others, tick = take_turns(programs, given.turns)
            _print_native(ours, others, programs.missing)
            _print_python(_from_python())
            print("\n## Whole tick\n")
            print(tick.strip())
            _print_targets(ours, others, tick)
    except Refused as reason:
        print(f"error: {reason}", file=sys.stderr)
        return 2
    return 0


# --- from Python ---------------------------------------------------------------------------------------------------


def _from_python() -> Rows:
    for name in (*(name for name in QPS if name not in QPS_OF_TICK), *PLANS):
        recorded = _read_problems(name)
        for others in (_piqp_rows, _osqp_rows):
            yield from ((name, by, ns) for by, ns in others(recorded))


def _piqp_rows(problems: Sequence[Recorded]) -> Iterator[tuple[str, float]]:
    """Time PIQP as it comes; every soft row has a slack, with which its sparse solver is the faster one."""
    try:
        piqp: Any = importlib.import_module("piqp")
    except ImportError:
        return
    extended = [problem.with_slacks() for problem in problems]
    prepared: list[dict[str, Any]] = [{"c": g, "x_l": lower, "x_u": upper} for _, g, _, lower, upper in extended]
    h = [h for h, *_ in extended]
    if len(problems[0].rows):
        solver = piqp.SparseSolver()
        matrices = zip(_to_sparse(h), _to_sparse([rows for _, _, rows, *_ in extended]), strict=True)
        for data, problem, (p, rows) in zip(prepared, problems, matrices, strict=True):
            data |= {"P": p, "G": rows, "h_l": problem.least, "h_u": problem.greatest}
    else:
        solver = piqp.DenseSolver()
        for data, p in zip(prepared, h, strict=True):
            data["P"] = np.asfortranarray(p)
    solver.setup(**prepared[0])

    def solve(data: dict[str, Any]) -> Array:
        solver.update(**data)
        solver.solve()
        x: Array = np.array(solver.result.x)  # not a view, which the next answer changes
        return x

    time_taken = _per_item(solve, prepared)
    yield f"PIQP, {_error(problems, [solve(data) for data in prepared])}", time_taken


def _osqp_rows(problems: Sequence[Recorded]) -> Iterator[tuple[str, float]]:
    """Time OSQP, warm, in which every soft row has a slack: as it comes, and with tolerances of 1e-8."""
    try:
        osqp: Any = importlib.import_module("osqp")
    except ImportError:
        return
    extended = [problem.with_slacks() for problem in problems]
    h = _to_sparse([np.triu(h) for h, *_ in extended])
    a = _to_sparse([np.vstack([np.eye(len(g)), rows]) for _, g, rows, *_ in extended])
    limits = [
        {"q": g, "l": np.r_[lower, problem.least], "u": np.r_[upper, problem.greatest]}
        for problem, (_, g, _, lower, upper) in zip(problems, extended, strict=True)
    ]
    prepared = [{"Px": h.data, "Ax": a.data, **limit} for h, a, limit in zip(h, a, limits, strict=True)]
    for how, settings in (("as it comes", {}), ("at 1e-8", {"eps_abs": 1e-8, "eps_rel": 1e-8})):
        solver = osqp.OSQP()
        solver.setup(P=h[0], A=a[0], **limits[0], verbose=False, **settings)

        def solve(data: dict[str, Array], solver: Any = solver) -> Array:
            solver.update(**data)
            x: Array = solver.solve().x
            return x

        time_taken = _per_item(solve, prepared)
        yield f"OSQP, {how}, {_error(problems, [solve(data) for data in prepared])}", time_taken


def _to_sparse(matrices: Sequence[Array]) -> list[Any]:
    """Return matrices by columns with one pattern, which an update requires."""
    sparse: Any = importlib.import_module("scipy.sparse")
    pattern = np.logical_or.reduce([matrix != 0.0 for matrix in matrices])
    found = [sparse.csc_matrix(pattern.astype(float)) for _ in matrices]
    for of_pattern, matrix in zip(found, matrices, strict=True):
        of_pattern.data[:] = matrix.T[pattern.T]
    return found


def _error(problems: Sequence[Recorded], answers: Sequence[Array]) -> str:
    """Describe the greatest difference of answers from ours, in ranges of the bounds."""
    pairs = zip(problems, answers, strict=True)
    return f"error {max(problem.error(answer) for problem, answer in pairs):.0e}"


def _per_item(work: Callable[[Any], Any], items: Sequence[Any], seconds: float = 0.4) -> float:
    """Return the median over rounds of the mean processor time per item [ns], after one warm-up round."""
    for item in items:
        work(item)
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < 3 or time.perf_counter() < end:
        begin = time.process_time_ns()
        for item in items:
            work(item)
        times.append((time.process_time_ns() - begin) / len(items))
    return statistics.median(times)


@dataclass(frozen=True)
class Recorded:
    """A problem with our answer (n), and its soft rows (m, n): the cost of an excess e is `weight e² / 2`."""

    box: QpProblem
    x: Array
    rows: Array
    least: Array
    greatest: Array
    weight: Array

    def with_slacks(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return H, g, rows and bounds in the unknowns and a slack for every row."""
        m = len(self.weight)
        h = np.zeros((len(self.x) + m,) * 2)
        h[: len(self.x), : len(self.x)] = self.box.h
        h[len(self.x) :, len(self.x) :] = np.diag(self.weight)
        unbounded = np.full(m, np.inf)
        lower, upper = np.r_[self.box.lower, -unbounded], np.r_[self.box.upper, unbounded]
        return h, np.r_[self.box.g, np.zeros(m)], np.hstack([self.rows, -np.eye(m)]), lower, upper

    def error(self, x: Array) -> float:
        """Return the greatest difference from our answer, in ranges of the bounds; a slack has none."""
        span = self.box.upper - self.box.lower
        return float(np.max(np.abs(x[: len(span)] - self.x)[span > 0.0] / span[span > 0.0]))


def _read_problems(name: str) -> list[Recorded]:
    data = np.fromfile(FOLDER / f"{name}.f64", "<f8")
    count, n, m = (int(size) for size in data[:3])
    found = []
    for row in data[3:].reshape(count, n * (n + 4) + m * (n + 3)):
        ends = np.cumsum([n * n, n, n, n, n, m * n, m, m])
        h, g, lower, upper, x, rows, least, greatest, weight = (part.copy() for part in np.split(row, ends))
        found.append(
            Recorded(QpProblem(h.reshape(n, n), g, lower, upper), x, rows.reshape(m, n), least, greatest, weight)
        )
    return found


# --- tables --------------------------------------------------------------------------------------------------------


def _print_machine(*, native: bool) -> None:
    machine = manifest.device()
    load = os.getloadavg()[0]
    packages = ", ".join(
        f"{name} {manifest.version_of(name).get(name, 'absent')}"
        for name in ("pin", "daqp", "piqp", "osqp", "clarabel", "numpy")
    )
    target = "this processor" if native else "any x86-64 (the default)"
    print(f"Machine: {machine['cpu']}, {machine['cores']} cores, {machine['system']}. Built for {target}.")
    print(f"Compilers: {_first_line(['rustc', '--version'])}; {_first_line(['g++', '--version'])}.")
    print(f"Python {platform.python_version()}: {packages}. Load at the start: {load:.1f}", end="")
    print(" (BUSY: trust ratios, not times)." if load > 0.7 else ".", flush=True)


def _first_line(command: Sequence[str]) -> str:
    try:
        return run(command).splitlines()[0]
    except Refused:
        return f"no {command[0]}"


def _print_native(ours: Times, others: Times, missing: Iterable[str]) -> None:
    print("\n## Natively\n\n| | ours | other | ratio | the other |\n|---|---|---|---|---|")
    for what in DYNAMICS:
        for whole, theirs in sorted(others.items(), key=lambda item: item[1]):
            if whole.startswith(what):
                _print_row(what, ours[what], theirs, f"Pinocchio{whole.removeprefix(what)}")
    for name in (*QPS, *PLANS):
        for start in ("warm", "cold"):
            what = f"{name}, {start}"
            for whole, theirs in sorted(others.items(), key=lambda item: item[1]):
                if whole.startswith(what):
                    _print_row(what, ours[what], theirs, f"DAQP{whole.removeprefix(what)}")
        for other in () if name in PLANS else ("Clarabel as it comes", "Clarabel at 1e-12 and polished"):
            _print_row(f"{name}, warm", ours[f"{name}, warm"], ours[f"{name}, {other}"], other)
    print(f"| flight of 50 s, one core | {ours['flight of 50 s'] / 1e9:.3f} s | | | |")
    for reason in missing:
        print(f"\n{reason}")


def _print_row(what: str, ours: float, theirs: float, other: str) -> None:
    print(f"| {what} | {_microseconds(ours)} | {_microseconds(theirs)} | {ours / theirs:.2f} | {other} |")


def _print_python(rows: Rows) -> None:
    print("\n## From Python\n\n| | by | time |\n|---|---|---|")
    for what, by, ns in rows:
        print(f"| {what} | {by} | {_microseconds(ns)} |")


def _microseconds(ns: float) -> str:
    if ns < 1e6:
        return f"{ns / 1e3:.2f} µs"
    return f"{ns / 1e6:.2f} ms" if ns < 1e8 else f"{ns / 1e9:.3f} s"


def _best_time(times: Times, names: Sequence[str]) -> float | None:
    """Return the sum of the shortest times of these operations, or `None` if one has no time."""
    ways = [[ns for way, ns in times.items() if way.startswith(name)] for name in names]
    return sum(map(min, ways)) if all(ways) else None


def _print_targets(ours: Times, others: Times, tick: str) -> None:
    """Print the targets and whether they are met, relative to the shortest times of the other libraries."""
    print("\n## Targets\n\n| | measured | target | met |\n|---|---|---|---|")
    warm = [f"{name}, warm" for name in (*QPS, *PLANS)]
    by_case = {case: [f"{name}, warm" for name in QPS_OF_TICK if case in name] for case in ("calm", "saturated")}
    targets = [("all dynamics terms / Pinocchio", [DYNAMICS[1]], 0.5)]
    targets += [(f"{name} / DAQP", [name], 1.0) for name in warm]
    targets += [(f"both QPs of a tick, {case} / DAQP", names, 1.0) for case, names in by_case.items()]
    for what, names, target in targets:
        # The others warm or cold: where much changes, a start from scratch may be the faster one.
        if (other := _best_time(others, [name.removesuffix(", warm") for name in names])) is None:
            print(f"| {what} | not measured | {target} | ? |")
        else:
            ratio = sum(ours[name] for name in names) / other
            print(f"| {what} | {ratio:.2f} | {target} | {_yes_or_no(ratio <= target)} |")
    p50, p999, own_p999 = tick_times(tick)
    if (other := _best_time(others, [DYNAMICS[1], *by_case["calm"]])) is not None:
        ratio = 1e3 * p50 / other
        print(f"| whole tick, p50 / (Pinocchio + DAQP + DAQP) | {ratio:.2f} | 0.8 | {_yes_or_no(ratio <= 0.8)} |")
    for what, tail in (("", own_p999), (", interruptions of the program included", p999)):
        print(f"| whole tick, p99.9 / p50{what} | {tail / p50:.2f} | 2.5 | {_yes_or_no(tail <= 2.5 * p50)} |")
    for case in CASES_OF_PLANS:
        most = (3000, 3000) if case == "engine lost" else (500, 1500)
        found = tick_times(tick, f"tick that plans, {case}")[:2]
        for what, value, target in zip(("p50", "p99.9"), found, most, strict=True):
            print(f"| tick that plans, {case}, {what} | {value:.0f} µs | {target} µs | {_yes_or_no(value <= target)} |")
    network = ours["shipped network, links placed"] / 1e3
    print(f"| shipped network, links placed | {network:.1f} µs | 6 µs | {_yes_or_no(network <= 6)} |")
    flight = ours["flight of 50 s"] / 1e9
    print(f"| flight of 50 s, one core | {flight:.3f} s | 0.25 s | {_yes_or_no(flight <= 0.25)} |")


def _yes_or_no(yes: bool) -> str:
    return "yes" if yes else "**no**"


if __name__ == "__main__":
    sys.exit(main())
