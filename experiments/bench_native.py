"""The native programs of `experiments.bench`: compilation, and runs in turns.

Pinocchio is the library of the `pin` wheel, DAQP is compiled from its source package; both need a C++ compiler.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from experiments import Refused
from jax_aero.base import places

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
EIGEN = "cmeel-eigen==3.4.1"  # headers that Pinocchio was compiled with, not in its wheel
# Definitions required by Pinocchio's configuration.
PINOCCHIO_DEFINES = (
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
)


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
    source = _fetch(f"daqp=={version}", "*.tar.gz", "--no-binary=:all:") / f"daqp-{version}" / "csrc"
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
        run([*pip, "--dest", str(download), requirement])
        archive = next(download.glob(pattern))
        unpacked = download / "unpacked"
        if archive.suffix == ".whl":
            zipfile.ZipFile(archive).extractall(unpacked)
        else:
            with tarfile.open(archive) as package:
                package.extractall(unpacked, filter="data")
        unpacked.rename(folder)
    return folder


def run(command: Sequence[str]) -> str:
    """Run a program and return its output, or refuse with its error message."""
    try:
        done = subprocess.run(command, cwd=places.HOME, capture_output=True, text=True, check=True)
    except FileNotFoundError:
        raise Refused(f"`{command[0]}` is not installed") from None
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
