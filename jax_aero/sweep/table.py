"""Tables of a sweep: one row per flight and one row per cell, both in Parquet.

The tables do not depend on when, where or in which order the flights were flown.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa

from jax_aero import rust
from jax_aero.backends import Failure
from jax_aero.base import quantities
from jax_aero.base.keys import get, replaced
from jax_aero.base.references import file_hash
from jax_aero.base.result import FlightResult
from jax_aero.sweep import aggregate, columns
from jax_aero.sweep.spec import Level, Spec

Cells: TypeAlias = Sequence[tuple[Level, ...]]
"""The levels of all axes, for each cell of a sweep."""

OF_DETECTION = ("degraded_time", "nominal_until", "all_modes", "warning_time")
"""Those of what fault detection finds, which flights of JAX do not have."""


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
    hashes: Sequence[str],
    flights: Sequence[FlightResult | Failure],
) -> pa.Table:
    """Return flights, with the hashes of their configurations, as rows."""
    records = []
    for index, config, config_hash, flown in zip(indices, configs, hashes, flights, strict=True):
        repeat, cell = divmod(index, len(levels))
        labels = [level.label for level in levels[cell]]
        record: dict[str, Any] = {"row": index, "cell": cell, "repeat": repeat}
        record |= {axis.name: label for axis, label in zip(spec.axes, labels, strict=True)}
        if spec.perturbation.ensemble:
            record["member"] = Path(config["simulator"]["aero"]["card"]).stem
        record["config_hash"] = config_hash
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
        figures = aggregate.figures({name: values[cell :: len(levels)] for name, values in flights.items()})
        records.append(record | {name: figures[name] for name in columns.CELLS if name != "cell"})
    first, *others = columns.fields(columns.CELLS)
    return pa.Table.from_pylist(records, pa.schema([first, *_axes(spec, levels), *others]))


def config_hash(
    config: Mapping[str, Any], paths: Sequence[str] | None = None, hash_of: Callable[[Path], str] = file_hash
) -> str:
    """Return a short hash of a configuration, with files instead of their paths; equal on every machine.

    Title and description of the flight that a cell is based on are in no result of a sweep, and do not count. It
    accepts any configuration, whereas `rust.config_digest` refuses invalid ones, which also have a row. `paths` are
    its `rust.path_keys`, if they are known.
    """
    for key in rust.path_keys(config) if paths is None else paths:
        config = replaced(config, key, hash_of(Path(get(config, key))))
    flown = {key: value for key, value in config.items() if key not in ("title", "description")}
    return hashlib.sha256(json.dumps(flown, sort_keys=True).encode()).hexdigest()[:16]
