"""Measure the crate, Pinocchio, DAQP and Clarabel in one run: `python -m experiments.bench`.

All use the same states and problems, which the crate's benchmark `side_by_side` writes to `target/side_by_side`.
They are separate compiled programs, which run in turns.
Prints the Markdown tables of `docs/embedding.md`. A tick is compared with Pinocchio and two DAQP solutions together:
the status is 1 if that ratio is more than 5 % above the stored one (`bench.json`), which `--store` replaces.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

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

STORED, SLACK = Path(__file__).with_suffix(".json"), 1.05
RATIO = "whole tick, p50 / (Pinocchio + DAQP + DAQP)"
DYNAMICS = ("dynamics, without Jacobians", "dynamics, with 17 frame Jacobians")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.bench", description=__doc__)
    parser.add_argument("--turns", type=count, default=5, help="number of runs of every native program (default 5)")
    parser.add_argument("--native", action="store_true", help="compile for this processor, not any x86-64")
    parser.add_argument("--store", action="store_true", help=f"store the ratio of a tick in {STORED.name}")
    given = parser.parse_args(arguments)
    try:
        with files.lock_work(FOLDER):  # two benchmarks at once would measure each other
            _print_machine(native=given.native)
            programs = build(native=given.native)
            ours, others, tick = take_turns(programs, given.turns)
            _print_native(ours, others, programs.missing)
            print("\n## Whole tick\n")
            print(tick.strip())
            ratio = _print_targets(ours, others, tick)
    except Refused as reason:
        print(f"error: {reason}", file=sys.stderr)
        return 2
    if given.store and ratio is not None:
        commit = (manifest.git_state() or {}).get("commit", "")
        files.write_json(STORED, {RATIO: round(ratio, 3), "commit": commit[:8]})
    return int(ratio is not None and ratio > SLACK * stored())


def stored() -> float:
    """Return the stored ratio of a tick."""
    return float(files.read_json(STORED)[RATIO])


# --- tables --------------------------------------------------------------------------------------------------------


def _print_machine(*, native: bool) -> None:
    machine = manifest.device()
    load = os.getloadavg()[0]
    packages = ", ".join(
        f"{name} {manifest.version_of(name).get(name, 'absent')}" for name in ("pin", "daqp", "clarabel", "numpy")
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


def _microseconds(ns: float) -> str:
    if ns < 1e6:
        return f"{ns / 1e3:.2f} µs"
    return f"{ns / 1e6:.2f} ms" if ns < 1e8 else f"{ns / 1e9:.3f} s"


def _best_time(times: Times, names: Sequence[str]) -> float | None:
    """Return the sum of the shortest times of these operations, or `None` if one has no time."""
    ways = [[ns for way, ns in times.items() if way.startswith(name)] for name in names]
    return sum(map(min, ways)) if all(ways) else None


def _print_targets(ours: Times, others: Times, tick: str) -> float | None:
    """Print the targets and whether they are met, relative to the shortest times of the other libraries.

    Return the ratio of a tick, if it was measured.
    """
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
    of_tick = None
    if (other := _best_time(others, [DYNAMICS[1], *by_case["calm"]])) is not None:
        of_tick, allowed = 1e3 * p50 / other, SLACK * stored()
        print(f"| {RATIO} | {of_tick:.2f} | {allowed:.2f}, as stored | {_yes_or_no(of_tick <= allowed)} |")
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
    return of_tick


def _yes_or_no(yes: bool) -> str:
    return "yes" if yes else "**no**"


if __name__ == "__main__":
    sys.exit(main())
