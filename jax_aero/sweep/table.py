"""Tables of a sweep: one row per flight and one row per cell, both in Parquet.

The tables do not depend on when, where or in which order the flights were flown.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa

from jax_aero import rust
from jax_aero.backends import Failure
from jax_aero.base import quantities
from jax_aero.base.keys import get, set_key
from jax_aero.base.named import file_hash
from jax_aero.base.result import LOST, UPRIGHT, FlightResult
from jax_aero.sweep import columns
from jax_aero.sweep.intervals import wilson
from jax_aero.sweep.spec import Level, Spec

Cells: TypeAlias = Sequence[tuple[Level, ...]]
"""The levels of all axes, for each cell of a sweep."""

OF_DETECTION = ("degraded_time", "nominal_until", "all_modes", "warning_time")
"""Those of what fault detection finds, which flights of JAX do not have."""

ON_COURSE_ROTATION = 15.0
ON_COURSE_COM = 0.25
"""Greatest errors [deg, m] of a completed flight that counts as on course, which is stricter than completed.

A flight that ends within its start-up has no position error and does not count.
"""


def schema(spec: Spec, levels: Cells) -> pa.Schema:
    """Return the columns of the table of flights."""
    drawn = columns.DRAWN if spec.perturbation.ensemble else {}
    axes = _axes(spec, levels)
    return pa.schema([*columns.fields(columns.PLACE), *axes, *columns.fields({**drawn, **columns.FLIGHT})])


def _axes(spec: Spec, levels: Cells) -> list[pa.Field]:
    numeric = (all(isinstance(cell[place].label, float) for cell in levels) for place in range(len(spec.axes)))
    return [
        pa.field(axis.name, pa.float64() if of else pa.string()) for axis, of in zip(spec.axes, numeric, strict=True)
    ]


def rows(
    spec: Spec,
    levels: Cells,
    indices: Sequence[int],
    configs: Sequence[Mapping[str, Any]],
    flights: Sequence[FlightResult | Failure],
) -> pa.Table:
    """Return flights as rows."""
    records = []
    for index, config, flown in zip(indices, configs, flights, strict=True):
        repeat, cell = divmod(index, len(levels))
        labels = [level.label for level in levels[cell]]
        record: dict[str, Any] = {"row": index, "cell": cell, "repeat": repeat}
        record |= {axis.name: label for axis, label in zip(spec.axes, labels, strict=True)}
        if spec.perturbation.ensemble:
            record["member"] = Path(config["simulator"]["aero"]["card"]).stem
        record["config_hash"] = config_hash(config)
        if isinstance(flown, Failure):
            record |= {"outcome": "error", "error": flown.reason}
        else:
            record |= {"outcome": flown.outcome, "lost_time": flown.lost_time, "lost_reason": flown.lost_reason}
            unknown = OF_DETECTION if spec.backend == "jax" else ()
            record |= {name: x for name, x in quantities.in_columns(flown.summary).items() if name not in unknown}
        records.append(record)
    return pa.Table.from_pylist(records, schema(spec, levels))


def cells(spec: Spec, levels: Cells, table: pa.Table) -> pa.Table:
    """Return the table of cells: counts with their intervals, and quantiles of the errors."""
    records, flights = [], {name: table[name].to_numpy() for name in table.column_names}
    for cell, chosen in enumerate(levels):
        record: dict[str, Any] = {"cell": cell}
        record |= {axis.name: level.label for axis, level in zip(spec.axes, chosen, strict=True)}
        records.append(record | _cell({name: values[cell :: len(levels)] for name, values in flights.items()}))
    first, *others = columns.fields(columns.CELLS)
    return pa.Table.from_pylist(records, pa.schema([first, *_axes(spec, levels), *others]))


def _cell(flights: Mapping[str, Any]) -> dict[str, Any]:
    """Return counts and quantiles of the flights of one cell; of the warnings, those of flights that a loss ends."""
    flights = {**flights, "warning_time": np.where(np.isnan(flights["lost_time"]), np.nan, flights["warning_time"])}
    errors = int((flights["outcome"] == "error").sum())
    trials, found = len(flights["outcome"]) - errors, counts(flights)
    record: dict[str, Any] = {"flights": trials, "errors": errors}
    for name in columns.SHARES:
        low, high = wilson(found[name], trials)
        record |= {name: found[name], f"{name}_low": low, f"{name}_high": high}
    record |= {name: found[name] for name in (*columns.OUTCOMES, "lost", "unwarned")}
    if trials and np.isnan(flights["degraded_time"]).all():
        record |= dict.fromkeys(("degraded", "degraded_low", "degraded_high", "unwarned"))
    for name, column in columns.QUANTITIES.items():
        values = flights[column].astype(float)
        known, shares = values[np.isfinite(values)], list(columns.QUANTILES.values())
        ends = np.quantile(known, shares).tolist() if len(known) else [None] * len(shares)
        record |= {f"{name}_{end}": value for end, value in zip(columns.QUANTILES, ends, strict=True)}
    return record


def counts(flights: Mapping[str, Any]) -> dict[str, int]:
    """Return how many flights ended how, upright, on course, lost, lost unwarned, and were degraded for a time."""
    outcome = flights["outcome"]
    near = (flights["max_rotation_error_deg"] <= ON_COURSE_ROTATION) & (flights["max_com_error"] <= ON_COURSE_COM)
    lost, is_to_the_end = np.isin(outcome, LOST), np.isnan(flights["lost_time"])
    late = np.where(is_to_the_end, flights["degraded_time"] <= 0.0, flights["warning_time"] < columns.LEAST_WARNING)
    which = {
        **{name: outcome == name for name in columns.OUTCOMES},
        "upright": np.isin(outcome, UPRIGHT),
        "on_course": (outcome == "completed") & near,
        "lost": lost,
        "unwarned": lost & late,
        "degraded": flights["degraded_time"] > 0.0,
    }
    return {name: int(rows.sum()) for name, rows in which.items()}


def quantile(values: Any, share: float) -> float | None:
    """Return a quantile of the values that are finite; `None` without any."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if len(known) else None


def config_hash(config: Mapping[str, Any]) -> str:
    """Return a short hash of a configuration, with files instead of their paths; equal on every machine.

    It accepts any configuration, whereas `rust.config_digest` refuses invalid ones, which also have a row.
    """
    hashed = copy.deepcopy(dict(config))
    for key in rust.path_keys(hashed):
        set_key(hashed, key, file_hash(Path(get(hashed, key))))
    return hashlib.sha256(json.dumps(hashed, sort_keys=True).encode()).hexdigest()[:16]
