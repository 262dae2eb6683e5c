"""Convert the log of a turbine on a test bench into a dataset: `jax-aero data import-bench SOURCE`.

SOURCE is a table (CSV) with `time_s` and any of `throttle_percent`, `speed_wanted_rpm`, `speed_rpm` and `thrust_n`, at
any rate; empty cells are missing readings, and rows with `clipped` = 1 have no thrust. Or it is a local clone of
https://github.com/N8Hawes75/JetCat_Comms, which states no licence and is not shipped here: the speeds that the control
unit of the turbine logged are then read from its history (its thrusts are TDMS files). Writes `bench_NAME.nc`, with the
digest of what was read.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from experiments import Refused
from experiments.data.import_cfd import OUT, git_show, read_table
from jax_aero.aero.dataset import Floats
from jax_aero.base.files import write_netcdf
from jax_aero.base.netcdf import open_dataset
from jax_aero.base.terminal import exit_status
from jax_aero.cli import Parser

COLUMNS = ("throttle_percent", "speed_wanted_rpm", "speed_rpm", "thrust_n")
UNITS = {"throttle": "%", "speed_wanted": "rpm", "speed": "rpm", "thrust": "N"}
COMMIT = "5414e58~1"
"""Commit of the clone before its logs were deleted."""
LOG = "decoded_data/2022-12-14/2022-12-14_23:47:19_decoded_data.csv"
UNIT_COLUMNS = {"RPM (setpoint)": "speed_wanted_rpm", "RPM (actual)": "speed_rpm"}
UNIT_RATE = 8.55
"""Rows per second of the control unit's log, which has no stamps: with them its speeds fit the thrusts best."""


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
    parser.add_argument("source", type=Path, metavar="SOURCE", help="a table, or a clone of JetCat_Comms")
    parser.add_argument("--log", default=LOG, metavar="PATH", help="log of the clone, in its history")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the dataset (default results/datasets/bench_NAME.nc)")
    given = parser.parse_args(arguments)

    def work() -> None:
        source: Path = given.source
        text = from_clone(source, given.log) if source.is_dir() else read_table(source)
        bench = read_bench(text, source.name)
        out = given.out or OUT / f"bench_{source.stem}.nc"
        digest = hashlib.sha256(text.encode()).hexdigest()
        variables = {name: (("row",), getattr(bench, name), {"units": UNITS.get(name, "s")}) for name in SIGNALS}
        write_netcdf(out, xr.Dataset(variables, attrs={"source": source.name, "sha256": digest}))
        print(f"{out}: {len(bench.time)} rows, {', '.join(measured(bench))}; sha256 of the log {digest}")

    return exit_status(work)


def from_clone(clone: Path, log: str) -> str:
    """Return the control unit's log from the history of a clone, as a table; rows of a wrong checksum are left out."""
    rows = csv.DictReader(git_show(clone, COMMIT, log, "JetCat_Comms").splitlines())
    lines = [f"time_s,{','.join(UNIT_COLUMNS.values())}"]
    for number, row in enumerate(rows):
        if row.get("CRC16_Given") is not None and row["CRC16_Given"] == row.get("CRC16_Calculated"):
            lines.append(",".join([repr(number / UNIT_RATE), *(row[name] for name in UNIT_COLUMNS)]))
    return "\n".join(lines)


def read_bench(text: str, name: str) -> Bench:
    """Return the log of a table; `name` is that of the file.

    Raises
    ------
    Refused
        For no known column, a cell that is no number, and times that do not ascend; the message names the line.
    """
    rows = csv.DictReader(text.splitlines())
    known = [column for column in COLUMNS if column in (rows.fieldnames or ())]
    if "time_s" not in (rows.fieldnames or ()) or not known:
        raise Refused(f"{name} has the columns {rows.fieldnames}; expected time_s and any of {', '.join(COLUMNS)}")
    values: list[list[float]] = []
    for number, row in enumerate(rows, start=2):
        cells = {key: _number(row.get(key), f"{name}, line {number}, column `{key}`") for key in ("time_s", *known)}
        if not cells["time_s"] > (values[-1][0] if values else -np.inf):
            raise Refused(f"{name}, line {number}, column `time_s`: {row['time_s']!r}; expected ascending times")
        if row.get("clipped", "0") not in ("0", ""):
            cells["thrust_n"] = np.nan
        values.append([cells["time_s"], *(cells.get(column, np.nan) for column in COLUMNS)])
    if len(values) < 2:
        raise Refused(f"{name} has {len(values)} rows; expected 2 or more")
    return Bench(*np.array(values).T)


def _number(text: str | None, place: str) -> float:
    """Return the number of a cell, NaN of an empty one."""
    if text is None or not text.strip():
        return np.nan
    try:
        if np.isfinite(number := float(text)):
            return number
    except ValueError:
        pass
    raise Refused(f"{place}: {text!r}; expected a finite number, or nothing")


def measured(bench: Bench) -> list[str]:
    """Return the names of the signals that a log has."""
    return [name for name in UNITS if np.isfinite(getattr(bench, name)).any()]


def load_bench(path: Path) -> Bench:
    """Return the log of a dataset of this module."""
    with open_dataset(path) as data:
        if missing := [name for name in SIGNALS if name not in data]:
            raise Refused(f"{path} has no {', '.join(missing)}; expected a dataset of `jax-aero data import-bench`")
        signals = {name: np.asarray(data[name].values, dtype=np.float64) for name in SIGNALS}
        return Bench(**signals, sha256=str(data.attrs.get("sha256", "")))
