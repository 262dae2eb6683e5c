"""Measure what sweeps cost beside the ticks of their flights: `python -m experiments.tools.bench_sweep`.

Every case is the command `jax-aero sweep`, from its start to the finished tables, of perturbed flights in two cells. A
flight of one tick has all costs but those of its ticks: these are the difference to longer flights of the same sweep.
Times are processor times, in which other programs do not count; wall times have the load of the machine at their start
beside them. Prints all of it; `--store` keeps it. Takes a quarter of an hour; `--part` divides the numbers of flights.
`--ray` measures in their place flights of one tick on a Ray cluster of two processes, by wall time.
"""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jax_aero.base import places
from jax_aero.base.arguments import count
from jax_aero.base.terminal import Refused
from jax_aero.results import manifest
from jax_aero.results.study import listing
from jax_aero.stored import keep

NAME, TITLE = "bench_sweep", "What sweeps cost"
OF_RAY, TITLE_OF_RAY = "bench_ray", "What a flight takes on a Ray cluster"
TICK = 0.01
"""Duration of a flight of one tick [s]."""
COSTS = (
    ("test2", 4.0, 200),
    ("test2", 4.0, 2000),
    ("test2", 4.0, 20_000),
    ("test2", 50.0, 100),
    ("robot", 4.0, 200),
    ("robot", 50.0, 40),
)
"""Experiments, durations [s], and numbers of flights."""
OVERHEAD = (1000, 10_000, 100_000)
"""Numbers of flights of one tick."""
ON_RAY = (200, 2000, 20_000)
"""Numbers of flights of one tick on a Ray cluster of two processes; between neighbours is the time of one more."""
LOOK = 0.02
"""Time between two looks at a command [s]."""
SWEEP = """title = "measured"
base = "{base}"
set = {{ "simulator.duration" = {duration} }}
repeats = {repeats}
perturbation = {{ file = "{perturbation}" }}

[[axis]]
name = "scale"
key = "disturbances.aero_estimate.scale"
values = [0.5, 1.0]
"""


@dataclass(frozen=True)
class Cost:
    """What the command took."""

    flights: int
    processor: float
    """Processor time [s]; of Ray that of this process alone."""
    wall: float
    """[s]"""
    memory: int
    """Greatest resident memory [bytes]."""
    disk: int
    """Size of the result [bytes]."""
    load: float
    """Mean number of running processes of the machine in the minute before."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.tools.bench_sweep", description=__doc__)
    parser.add_argument("--part", type=count, default=1, metavar="N", help="fly one of N flights (default all)")
    parser.add_argument("--ray", action="store_true", help="measure a Ray cluster")
    parser.add_argument("--store", action="store_true", help="store what is measured")
    given = parser.parse_args(arguments)
    costs = (measure_ray if given.ray else measure)(given.part)
    print(listing(costs))
    if given.store:
        name, title = (OF_RAY, TITLE_OF_RAY) if given.ray else (NAME, TITLE)
        options = " --ray" * given.ray + (f" --part {given.part}" if given.part > 1 else "")
        about = f"{manifest.device()['cpu']}; perturbed flights in two cells; one core unless two are named"
        keep.benchmark(name, title, about, f"python -m experiments.tools.bench_sweep --store{options}", costs)
    return 0


def measure(part: int = 1) -> dict[str, dict[str, float]]:
    """Return the costs of sweeps by case."""
    costs: dict[str, dict[str, float]] = {}
    for base, duration, flights in COSTS:
        whole, bare = (fly(base, seconds, flights // part) for seconds in (duration, TICK))
        both = fly(base, duration, flights // part, cores=2)
        costs[f"{whole.flights} flights of {base}, {duration:g} s"] = of_flights(whole, bare) | of_cores(whole, both)
    for flights in OVERHEAD:
        bare = fly("test2", TICK, flights // part)
        costs[f"{bare.flights} flights of a tick"] = of_overhead(bare)
    return costs


def measure_ray(part: int = 1) -> dict[str, dict[str, float]]:
    """Return the time of one more flight of one tick on a Ray cluster, by numbers of flights."""
    costs = [fly("test2", TICK, flights // part, cores=2, ray=True) for flights in ON_RAY]
    return {
        f"{fewer.flights} to {more.flights} flights": of_more(fewer, more) for fewer, more in itertools.pairwise(costs)
    }


def of_flights(whole: Cost, bare: Cost) -> dict[str, float]:
    """Return the costs of a flight, and its share of ticks by the same flights of one tick."""
    assert whole.flights == bare.flights
    ticks = whole.processor - bare.processor
    return {
        "a second and core": whole.flights / whole.processor,
        "a flight [ms]": 1e3 * whole.processor / whole.flights,
        "beside its ticks [ms]": 1e3 * bare.processor / bare.flights,
        "over its ticks'": whole.processor / ticks,
        "memory [MB]": whole.memory / 1e6,
        "disk [kB]": whole.disk / whole.flights / 1e3,
    }


def of_cores(one: Cost, two: Cost) -> dict[str, float]:
    """Return the wall time on two cores over that on one."""
    return {
        "two cores / one": two.wall / one.wall,
        "two cores / one, processor": two.processor / one.processor,
        "load": max(one.load, two.load),
    }


def of_overhead(bare: Cost) -> dict[str, float]:
    """Return the costs of a flight of one tick."""
    return {
        "a flight [ms]": 1e3 * bare.processor / bare.flights,
        "memory [MB]": bare.memory / 1e6,
        "disk [kB]": bare.disk / bare.flights / 1e3,
    }


def of_more(fewer: Cost, more: Cost) -> dict[str, float]:
    """Return the wall time of one more flight."""
    flights = more.flights - fewer.flights
    return {"one more [ms]": 1e3 * (more.wall - fewer.wall) / flights, "load": max(fewer.load, more.load)}


def fly(base: str, duration: float, flights: int, cores: int = 1, *, ray: bool = False) -> Cost:
    """Fly a sweep on one core or two, into a folder that is removed, and return its cost.

    Raises
    ------
    Refused
        If the command fails.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        file, repeats = folder / "measured.toml", max(1, flights // 2)
        perturbation = places.CONFIGS / "perturbation" / "flight.toml"
        file.write_text(SWEEP.format(base=base, duration=duration, repeats=repeats, perturbation=perturbation))
        command = [sys.executable, "-m", "jax_aero", "sweep", str(file), "--out", str(folder), "--workers", str(cores)]
        command += ["--cluster", "ray"] * ray
        load, started = os.getloadavg()[0], time.perf_counter()
        with (folder / "messages").open("wb") as messages:
            process = subprocess.Popen(command, cwd=places.HOME, stdout=messages, stderr=messages)
        os.sched_setaffinity(process.pid, sorted(os.sched_getaffinity(0))[:cores])
        memory = 0
        while not (ended := os.wait4(process.pid, os.WNOHANG))[0]:
            memory = max(memory, _memory(process.pid))
            time.sleep(LOOK)
        wall, (_, status, used) = time.perf_counter() - started, ended
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise Refused(f"`{' '.join(command)}` failed: {(folder / 'messages').read_text()}")
        disk = sum(path.stat().st_size for path in (folder / "measured").rglob("*") if path.is_file())
        return Cost(2 * repeats, used.ru_utime + used.ru_stime, wall, memory, disk, load)


def _memory(process: int) -> int:
    """Return the greatest resident memory of a process so far [bytes]; 0 after its end.

    `getrusage` would count that of the process that started it.
    """
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "VmHWM":
            return 1024 * int(value.split()[0])
    return 0


if __name__ == "__main__":
    sys.exit(main())
