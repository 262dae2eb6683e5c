"""Kill processes that write results at random times; see that nothing is lost: `-m tests.tools.kill --trials 100`.

A killed sweep goes on and ends with the bytes of one that was not killed. A killed replacement of a result leaves the
old one or the new one. Processes are forked, so that a trial costs no start of Python.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import os
import random
import signal
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from experiments import record
from experiments.sweep import run, spec
from experiments.sweep.design import Design
from jax_aero.base import places
from jax_aero.base.files import checksums, find_damaged

SWEEP = {
    "title": "killed",
    "description": "short flights, one in a chunk",
    "base": "test2",
    "set": {"simulator.duration": 0.1},
    "axis": [{"name": "speed", "key": "wind.speed", "values": list(range(1, 13))}],
    "chunk": 1,
}


def kill_after(seconds: float, work: Callable[[], object]) -> bool:
    """Run work in a process of its own and kill it; return whether it had not ended by itself."""
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, "it failed"
    return os.WIFSIGNALED(status)


def kill_sweeps(trials: int, folder: Path, chance: random.Random) -> str:
    """Kill a sweep again and again, from its beginning once it is finished."""
    design = Design(spec.from_table("killed", SWEEP))

    def fly(out: Path) -> dict[str, bytes]:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            where = run.run(design, workers=1, out=out)
        assert sorted(path.name for path in where.iterdir()) == ["cells.parquet", "sweep.json", "table.parquet"]
        assert [path.name for path in out.iterdir()] == ["killed"]
        return {name: (where / name).read_bytes() for name in run.TABLES}

    fly(folder / "warm")  # which imports what a child then need not
    started = time.perf_counter()
    whole = fly(folder / "whole")
    duration = time.perf_counter() - started
    killed, finished, out = 0, 0, folder / "0"
    while killed < trials:
        in_time = kill_after(chance.uniform(0.0, 0.6 * duration), functools.partial(fly, out))
        killed += in_time
        if not in_time or killed == trials or chance.random() < 0.2:  # some are killed once, some many times
            assert fly(out) == whole, f"another result after {killed} kills"
            finished += 1
            out = folder / str(finished)
    return f"sweep: {killed} kills, {finished} sweeps of {duration:.2f} s that went on to the same bytes"


def kill_replacements(trials: int, folder: Path, chance: random.Random) -> str:
    """Kill a process that replaces a result all the time."""
    result = folder / "result"

    def write_one(number: int) -> None:
        data = xr.Dataset({"x": ("time", np.full(10_000, float(number)))})
        record.write_run(result, data, {"number": number}, replace=number > 0)

    def write_all(first: int) -> None:
        for number in range(first, first + 1_000):
            write_one(number)

    write_one(0)  # which imports what a child then need not
    started = time.perf_counter()
    write_one(1)
    duration = time.perf_counter() - started
    number = 1
    for _ in range(trials):
        assert kill_after(chance.uniform(0.0, 4.0 * duration), functools.partial(write_all, number + 1))
        with record.complete_folder(folder / "result", replace=True) as draft:  # which puts back what is left over
            manifest = record.read_manifest(result)
            assert manifest is not None, "the result is lost"
            assert find_damaged(result, manifest["files"]) is None, "the result is damaged"
            assert set(checksums(result)) == {places.RUN_FILE, places.MANIFEST_FILE}
            assert number <= manifest["number"]
            number = manifest["number"]
            for path in result.iterdir():
                (draft / path.name).write_bytes(path.read_bytes())
        assert [path.name for path in folder.iterdir()] == ["result"]
    return f"result: {trials} kills during {number} replacements and more, one whole result after each"


def main() -> None:
    """Kill and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100, metavar="N", help="kills of each kind (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the times (default 0)")
    given = parser.parse_args()
    chance = random.Random(given.seed)
    for kill in (kill_sweeps, kill_replacements):
        with tempfile.TemporaryDirectory() as folder:
            print(kill(given.trials, Path(folder), chance), flush=True)


if __name__ == "__main__":
    main()
