"""What the recommended controller does after failures that no sweep can fly: pauses, scaled thrusts, on the ground.

`jax-aero study failures [PART]` flies one part of the question, or all: `thrust_scaled` (all thrusts are measured
wrong by one factor), `descent` (an engine stops, and the flight goes on to the ground), `pauses` (the controller does
not tick), `late_torques` and `late_thrusts` (commands act late), `take_off_base`, `take_off_engines` and
`take_off_scaled` (on the ground). `--set every=10` flies only every tenth flight. The result goes to
`results/failures/PART/`.
"""

from __future__ import annotations

import pandas as pd
import xarray as xr

from experiments import Refused
from experiments.studies.failures import flights, ground, latency
from experiments.study import Findings, Study
from jax_aero import rust
from jax_aero.base import places, tables

PARTS = {**flights.PARTS, **latency.PARTS, **ground.PARTS}

MEANING = {
    "case": ("", "what fails, and in which flight"),
    "completed": ("1", "whether the flight completes"),
    "lean": ("deg", "greatest rotation error after the failure"),
    "found": ("s", "time from the failure to the first tick that detects one"),
    "sink": ("m s-1", "speed of sinking at the end, or at the height of the start"),
    "down": ("s", "time from the failure until the height of the start is reached"),
    "distance": ("m", "greatest distance of the centre of mass from its set-point"),
    "torque_error": ("ms", "median error of the measured latency of torques"),
    "torque_worst": ("ms", "its greatest error"),
    "torque_known": ("s", "time from which it is known"),
    "thrust_error": ("ms", "median error of the measured latency of thrust rates"),
    "thrust_worst": ("ms", "its greatest error"),
    "thrust_known": ("s", "time from which it is known"),
    "late": ("s", "time from which commands count as late"),
    "feet": ("1", "whether the foot sensors are taken for wrong"),
}


class Failures(tables.Table, frozen=True):
    """Flights of a part."""

    every: tables.Count = 1
    """One flight of so many is flown."""


def compute(part: str, asked: Failures) -> Findings:
    """Fly a part of the failures."""
    if part not in PARTS:
        raise Refused(f"there is no part `{part}`{places.did_you_mean(part, PARTS)}")
    table = pd.DataFrame(PARTS[part](asked.every)).rename_axis("flight")
    data = xr.Dataset.from_dataframe(table)
    for name in table:
        unit, text = MEANING[str(name)]
        data[name].attrs.update({"units": unit, "long_name": text})
    rows = {str(case): _summary(cell.drop(columns="case")) for case, cell in table.groupby("case", sort=False)}
    bases = {name: rust.load_config(name) for name in ("test2_observer", "test2_sensors", "take_off")}
    return Findings(f"Failures: {part}", data, rows, flights=bases)


STUDY = Study("failures", __doc__, Failures, compute, tuple(PARTS), backend="rust")
main = STUDY.main


def _summary(cell: pd.DataFrame) -> str:
    """Return how many flights of a case complete, and the ranges of their figures."""
    done = cell[cell["completed"]]
    parts = [f"{len(done)} of {len(cell)} complete"]
    for name in done.columns.drop("completed"):
        if done[name].dtype == bool:
            parts.append(f"{name} in {cell[name].sum()}")
        elif done[name].notna().any():
            parts.append(f"{name} {done[name].min():.2f} to {done[name].max():.2f} {MEANING[name][0]}")
    return ", ".join(parts)
