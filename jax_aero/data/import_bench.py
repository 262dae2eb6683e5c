"""Convert the log of a turbine on a test bench into a dataset: `jax-aero data import-bench SOURCE`.

SOURCE is a table (CSV) with `time_s` and any of `throttle_percent`, `speed_wanted_rpm`, `speed_rpm` and `thrust_n`, at
any rate; empty cells are missing readings, and rows with `clipped` = 1 have no thrust. Writes `bench_NAME.nc`, with the
digest of what was read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from jax_aero import rust
from jax_aero.aero.dataset import Floats
from jax_aero.base.arguments import Parser
from jax_aero.base.files import write_netcdf
from jax_aero.base.netcdf import open_dataset
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.data.import_cfd import OUT, read_table

COLUMNS = ("throttle_percent", "speed_wanted_rpm", "speed_rpm", "thrust_n")
UNITS = {"throttle": "%", "speed_wanted": "rpm", "speed": "rpm", "thrust": "N"}
SIGNALS = ("time", *UNITS)


class Bench(NamedTuple):
    """Log of a run on a bench, N rows; NaN where nothing valid was read."""

    time: Floats
    """Ascending times [s]."""
    throttle: Floats
    """Throttle [%]."""
    speed_wanted: Floats
    """Speed that the control unit demands of the shaft [rpm]."""
    speed: Floats
    """Speed of the shaft [rpm]."""
    thrust: Floats
    """Reading of the thrust [N]."""
    sha256: str = ""
    """Digest of the log as it was read."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("data import-bench", __doc__)
    parser.add_argument("source", type=Path, metavar="SOURCE", help="a table")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the dataset (default results/datasets/bench_NAME.nc)")
    given = parser.parse_args(arguments)

    def work() -> None:
        source: Path = given.source
        text = read_table(source)
        bench = read_bench(text, source.name)
        out = given.out or OUT / f"bench_{source.stem}.nc"
        digest = hashlib.sha256(text.encode()).hexdigest()
        variables = {name: (("row",), getattr(bench, name), {"units": UNITS.get(name, "s")}) for name in SIGNALS}
        write_netcdf(out, xr.Dataset(variables, attrs={"source": source.name, "sha256": digest}))
        measured = ", ".join(name for name in UNITS if np.isfinite(getattr(bench, name)).any())
        print(f"{out}: {len(bench.time)} rows, {measured}; sha256 of the log {digest}")

    return exit_status(work)


def read_bench(text: str, name: str) -> Bench:
    """Return the log of a table; `name` is that of the file.

    Raises
    ------
    Refused
        For no known column, a cell that is no number, and times that do not ascend; the message names the line.
    """
    table = rust.read_csv(text, name, {"time_s": "number", **dict.fromkeys((*COLUMNS, "clipped"), "reading")})
    nothing = np.full(len(table.lines), np.nan)
    time, *readings = (table.numbers.get(column, nothing) for column in ("time_s", *COLUMNS))
    if not table.numbers.keys() & {*COLUMNS}:
        raise Refused(
            f"{name} has the columns {', '.join(table.header)}; expected time_s and any of {', '.join(COLUMNS)}"
        )
    if (is_late := np.diff(time) <= 0.0).any():
        row = 1 + int(is_late.argmax())
        raise Refused(f"column time_s in line {table.lines[row]} of {name} is {time[row]}; expected ascending times")
    if len(time) < 2:
        raise Refused(f"{name} has {len(time)} rows; expected 2 or more")
    is_clipped = np.nan_to_num(table.numbers.get("clipped", nothing)) != 0.0
    throttle, wanted, speed, thrust = readings
    return Bench(time, throttle, wanted, speed, np.where(is_clipped, np.nan, thrust))


def load_bench(path: Path) -> Bench:
    """Return the log of a dataset of this module."""
    with open_dataset(path) as data:
        if missing := [name for name in SIGNALS if name not in data]:
            raise Refused(f"{path} has no {', '.join(missing)}; expected a dataset of `jax-aero data import-bench`")
        signals = {name: np.asarray(data[name].values, dtype=np.float64) for name in SIGNALS}
        return Bench(**signals, sha256=str(data.attrs.get("sha256", "")))
