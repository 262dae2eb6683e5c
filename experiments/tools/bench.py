"""Measure the crate, Pinocchio, DAQP and Clarabel in one run: `python -m experiments.tools.bench`.

All use the same states and problems, which the crate's benchmark `side_by_side` writes to `target/side_by_side`.
They are separate compiled programs, which run in turns: Pinocchio is the library of the `pin` wheel, DAQP is compiled
from its source package; both need a C++ compiler.
Prints the Markdown tables of `docs/embedding.md`. A tick is compared with Pinocchio and two DAQP solutions together:
the status is 1 if that ratio is more than 5 % above the stored one (`bench.json`), which `--store` replaces.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jax_aero.base import files, places
from jax_aero.base.arguments import count
from jax_aero.base.terminal import Refused
from jax_aero.results import manifest

STORED, SLACK = Path(__file__).with_suffix(".json"), 1.05
RATIO = "whole tick, p50 / (Pinocchio + DAQP + DAQP)"
DYNAMICS = ("dynamics, without Jacobians", "dynamics, with 17 frame Jacobians")
Times = dict[str, float]
"""Processor times by name [ns]: the median over rounds of the fastest run.

A virtual machine may alternate between two speeds that differ by a factor of 1.5. With few runs, medians over runs may
be of different speeds; the fastest runs are most likely of the same one."""

FOLDER = places.HOME / "target" / "side_by_side"
SOURCES = places.HOME / "rust" / "sim" / "benches" / "native"
URDF = places.CONFIGS / "robot" / "ironcub_mk1.urdf"
QPS_OF_TICK = tuple(f"{name} QP, {case}" for name in ("momentum", "torque") for case in ("calm", "saturated"))
CASES_OF_PLANS = ("calm", "turbulence", "engine lost")
QPS = (*QPS_OF_TICK, *(f"plan QP, {case}" for case in CASES_OF_PLANS))
PLANS = tuple(f"plan, {case}" for case in CASES_OF_PLANS)
"""Whole problems of plans: with soft rows, of which a plan QP contains those that are exceeded."""
PIP_LIMIT = 300.0  # s for which pip may fetch a package
EIGEN = "cmeel-eigen==3.4.1"  # headers that Pinocchio was compiled with, not in its wheel
# Definitions required by Pinocchio's configuration.
PINOCCHIO_DEFINES = (
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.tools.bench", description=__doc__)
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
        times = tick_times(tick, f"tick that plans, {case}")[:2]
        for what, value, target in zip(("p50", "p99.9"), times, most, strict=True):
            print(f"| tick that plans, {case}, {what} | {value:.0f} µs | {target} µs | {_yes_or_no(value <= target)} |")
    network = ours["shipped network, links placed"] / 1e3
    print(f"| shipped network, links placed | {network:.1f} µs | 6 µs | {_yes_or_no(network <= 6)} |")
    flight = ours["flight of 50 s"] / 1e9
    print(f"| flight of 50 s, one core | {flight:.3f} s | 0.25 s | {_yes_or_no(flight <= 0.25)} |")
    return of_tick


def _yes_or_no(yes: bool) -> str:
    return "yes" if yes else "**no**"


# --- compilation, and runs in turns ---------------------------------------------------------------------------------


@dataclass
class Programs:
    """Command lines of the native programs, and reasons for missing ones; `tick` prints a table."""

    ours: list[str]
    tick: list[str]
    others: dict[str, list[str]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)


def cargo(*, native: bool) -> list[str]:
    """Return the command that benchmarks start with; `native` compiles for this processor only."""
    flags = ["env", "RUSTFLAGS=-C target-cpu=native", "CARGO_TARGET_DIR=target/native"] if native else []
    return [*flags, "cargo", "bench", "--locked", "--quiet"]


def build(*, native: bool) -> Programs:
    """Write states and problems, and compile the programs that can be compiled on this machine."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    ours = [*cargo(native=native), "--bench", "side_by_side"]
    run([*ours, "--", "--dump", str(FOLDER)])
    programs = Programs(ours, [*cargo(native=native), "--bench", "tick"])
    for name, compile_it in (("Pinocchio", _compile_pinocchio), ("DAQP", _compile_daqp)):
        try:
            programs.others[name] = compile_it(native=native)
        except (Refused, OSError, ImportError) as reason:
            programs.missing.append(f"{name} is not measured natively: {reason}")
    return programs


def _compile_pinocchio(*, native: bool) -> list[str]:
    pin: Any = importlib.import_module("pinocchio")
    model = pin.buildModelFromUrdf(str(URDF), pin.JointModelFreeFlyer())
    model.saveToBinary(str(FOLDER / "model.bin"))
    prefix = Path(pin.__file__).resolve().parents[4]
    eigen = _fetch(EIGEN, "*.whl") / "cmeel.prefix" / "include" / "eigen3"
    # By default the algorithms are those of the wheel's library; with `native` they are compiled here.
    flags = ["-march=native"] if native else ["-DPINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION"]
    libraries = [f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}", "-lboost_serialization"]
    libraries += [] if native else ["-lpinocchio_default"]
    include = ["-isystem", str(eigen), "-isystem", str(prefix / "include"), f"-I{SOURCES}"]
    program = FOLDER / ("pinocchio-native" if native else "pinocchio")
    command = ["g++", "-std=c++17", "-O3", "-DNDEBUG", *PINOCCHIO_DEFINES, *flags, *include]
    run([*command, str(SOURCES / "pinocchio.cpp"), *libraries, "-o", str(program)])
    return [str(program), str(FOLDER)]


def _compile_daqp(*, native: bool) -> list[str]:
    version = importlib.metadata.version("daqp")
    source = _fetch(f"daqp=={version}", "*.tar.gz", "--no-binary=daqp") / f"daqp-{version}" / "csrc"
    # Flags of DAQP's own package, without its timer.
    flags = ["-O3", "-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"]
    flags += ["-march=native"] if native else []
    program = FOLDER / ("daqp-native" if native else "daqp")
    objects = FOLDER / "objects"
    objects.mkdir(exist_ok=True)
    files = sorted(source.glob("src/*.c"))
    for file in files:
        run(["gcc", *flags, f"-I{source / 'include'}", "-c", str(file), "-o", str(objects / f"{file.stem}.o")])
    links = [str(objects / f"{file.stem}.o") for file in files]
    include = [f"-I{source / 'include'}", f"-I{SOURCES}"]
    run(["g++", "-std=c++17", *flags, *include, str(SOURCES / "daqp.cpp"), *links, "-lm", "-o", str(program)])
    return [str(program), str(FOLDER), *QPS, *PLANS]


def _fetch(requirement: str, pattern: str, *options: str) -> Path:
    """Download and unpack a package once; return its folder."""
    folder = FOLDER / requirement.replace("==", "-")
    if not folder.is_dir():
        download = FOLDER / "download"
        shutil.rmtree(download, ignore_errors=True)
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", *options]
        run([*pip, "--dest", str(download), requirement], limit=PIP_LIMIT)
        archive = next(download.glob(pattern))
        unpacked = download / "unpacked"
        if archive.suffix == ".whl":
            shutil.unpack_archive(archive, unpacked, "zip")
        else:
            shutil.unpack_archive(archive, unpacked, filter="data")
        unpacked.rename(folder)
    return folder


def run(command: Sequence[str], *, limit: float | None = None) -> str:
    """Run a program for at most `limit` [s] and return its output, or refuse with its error message."""
    try:
        done = subprocess.run(command, cwd=places.HOME, capture_output=True, text=True, check=True, timeout=limit)
    except FileNotFoundError:
        raise Refused(f"`{command[0]}` is not installed") from None
    except subprocess.TimeoutExpired:
        raise Refused(f"`{' '.join(command)}` did not end within {limit:g} s") from None
    except subprocess.CalledProcessError as error:
        last = [line for line in error.stderr.splitlines() if line.strip()][-3:]
        raise Refused(f"`{Path(command[0]).name}` failed: {' / '.join(last)}") from None
    return done.stdout


def take_turns(programs: Programs, turns: int) -> tuple[Times, Times, str]:
    """Run all programs in turns; return our times, those of others, and the table of ticks."""
    ours: Times = {}
    others: Times = {}
    ticks: list[str] = []
    for _ in range(turns):
        ticks.append(run(programs.tick))
        for command, times in ((programs.ours, ours), *((command, others) for command in programs.others.values())):
            for what, median in _parse(run(command)):
                times[what] = min(median, times.get(what, median))
    return ours, others, min(ticks, key=lambda table: tick_times(table)[0])


def tick_times(table: str, title: str = "tick, TEST2") -> tuple[float, float, float]:
    """Return p50, p99.9 and the p99.9 of the medians of the ticks with a title [µs]."""
    cells = next(line.split("|") for line in table.splitlines() if line.startswith(f"| {title} |"))
    p50, p999, own = (float(cells[column].split()[0]) for column in (3, 5, 7))
    return p50, p999, own


def _parse(output: str) -> Iterator[tuple[str, float]]:
    for line in output.splitlines():
        if line.count("\t") == 2:
            what, median, _ = line.split("\t")
            yield what, float(median)


if __name__ == "__main__":
    sys.exit(main())
