"""Compute the stored flights again that have changed: `python -m tests.golden.make [NAME ...]`.

Other numbers of the same configuration are refused under the stored version of the numbers, by which results are
distinguished: `flight_sim::NUMERICS` of the crate, `jax_aero/base/numerics.py` of what is computed in Python.

A row is stored if last bits do not decide it: flights from initial states 1e-13 apart, and the same flight with other
variants of the mathematical library, agree there to a tenth of the tolerance of the test, in parts of each signal's
range. Flights that round coarsely (`flights.rounds_coarsely`) may differ more, signal by signal.
"""

from __future__ import annotations

import copy
import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.results.identity import VERSIONS
from tests.golden import flights

PLAIN_PROCESSOR = "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX512VL,-AVX512DQ"
"""Makes the C library take its variants of sin, cos, exp without fused multiply-add, which round differently."""


def main(names: list[str]) -> None:
    """Fly, compare and store what has changed of the flights of these names, of all if there is none."""
    known = flights.load_digests() if flights.DIGESTS.is_file() else flights.Digests(VERSIONS, {})
    changed = {}
    for name in names or flights.NAMES:
        config = flights.config_of(name)
        flight = flights.fly(config)
        if what := flights.what_changed(name, config, flight, known):
            if flights.is_unraised(what, config, known):
                sys.exit(f"error: {name} has other numbers under {known.numerics}: raise the version of its engine")
            changed[name] = config, flight
    # Of another file, which may be another title, with the same numbers.
    stored = {name: pair for name, pair in changed.items() if not flights.has_numbers(name, *pair, known)}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flights"
        command = [sys.executable, "-m", "tests.golden.make", "--plain", str(path), *stored]
        subprocess.run(command, check=True, env=os.environ | {"GLIBC_TUNABLES": PLAIN_PROCESSOR})
        plain = pickle.loads(path.read_bytes())
    for name, (config, flight) in stored.items():
        store(name, config, flight, [plain[name], *map(flights.fly, neighbours_of(config))])
    for name, (config, flight) in changed.items():
        known.flights[name] = flights.digest(name, config, flight)
    of_all = ((name, known.flights[name]) for name in flights.NAMES if name in known.flights)
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(digests)}" for name, digests in of_all)
    text = f'{{"numerics": {json.dumps(VERSIONS)}, "flights": {{\n{lines}\n}}}}\n'
    flights.DIGESTS.write_text(text, encoding="utf-8")


def neighbours_of(config: rust.Config) -> Iterator[rust.Config]:
    """Yield the configuration with initial states that differ by 1e-13 of their size."""
    steps = [("joint_position", sign * size) for size in (1e-13, 3e-14, 3e-13) for sign in (1, -1)]
    for key, step in [*steps, ("thrust", 1e-11), ("thrust", -1e-11)]:
        changed = copy.deepcopy(config)
        start = changed["simulator"]["initial"]
        start[key] = [value + step * (1 + index % 3) for index, value in enumerate(start[key])]
        if key != "thrust" or any(config["simulator"]["initial"]["thrust"]):
            yield changed


def store(name: str, config: rust.Config, flight: rust.FlightResult, neighbours: list[rust.FlightResult]) -> None:
    """Store the rows and the parts of the ending in which all flights agree."""
    log = flights.signals(flight)
    length = min(len(each.log["time"]) for each in [flight, *neighbours])
    total = len(flight.log["time"])
    stride = 50 * -(-total // (20 * 50))
    rows = np.array([0, 1, 2, *range(stride, length, stride)])
    others = [flights.signals(each) for each in neighbours]
    allowed = flights.SINGLE if flights.rounds_coarsely(config) else flights.DOUBLE
    while True:
        worst = {
            key: np.max([flights.difference(other[key][rows], value[rows]) for other in others], axis=0)
            for key, value in log.items()
        }
        agree = np.max(list(worst.values()), axis=0) <= allowed / 10
        if agree.all():
            break
        rows = rows[agree]
    coarse = np.array([each > flights.DOUBLE / 10 for each in worst.values()])

    end: dict[str, Any] = {}
    for key in ("outcome", "lost_time"):
        if all(getattr(each, key) == getattr(flight, key) for each in neighbours):
            end[key] = getattr(flight, key)
    found = flights.summary(flight)
    end["summary"] = {
        key: value
        for key, value in found.items()
        if all(
            abs(flights.summary(each)[key] - value) <= allowed / 10 * max(abs(value), flights.SMALL)
            for each in neighbours
        )
    }
    flights.FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(
        flights.FOLDER / f"{name}.npz",
        row=rows,
        coarse=coarse,
        end=np.array(json.dumps(end)),
        **{key: value[rows] for key, value in log.items()},
    )
    left_out = sorted(set(found) - set(end["summary"]))
    share = 1.0 - coarse.mean()
    print(f"{name}: {len(rows)} rows to {rows[-1]} of {total}, {share:.0%} to {flights.DOUBLE}; without {left_out}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--plain"]:
        found = {name: flights.fly(flights.config_of(name)) for name in sys.argv[3:]}
        Path(sys.argv[2]).write_bytes(pickle.dumps(found))
    else:
        main(sys.argv[1:])
