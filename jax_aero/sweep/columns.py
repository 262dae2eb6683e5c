"""Columns of a sweep's tables: type, unit and meaning, in the files' metadata and on one page of the site."""

from __future__ import annotations

import itertools
import typing
from collections.abc import Iterator, Mapping
from typing import NamedTuple, TypeAlias

import pyarrow as pa

from jax_aero.base import quantities
from jax_aero.base.result import Outcome
from jax_aero.sweep.populations import POPULATIONS, QUANTILES, QUANTITIES, populations, quantile

PAGE = "reference/columns.md"

OUTCOMES: tuple[str, ...] = typing.get_args(Outcome)

LEAST_WARNING = 0.3
"""Time before the loss from which on a flight has to be degraded, so that it is not lost unwarned [s]."""

SHARES = {
    "completed": "completed",
    "upright": "completed or landed",
    "on_course": "completed on course",
    "degraded": "were degraded for a time",
}
"""Counts of flights that have an interval."""


class Column(NamedTuple):
    """A column of a table."""

    type: pa.DataType
    unit: str
    """"1" for numbers without."""
    meaning: str


Columns: TypeAlias = Mapping[str, Column]

COUNT, NUMBER, TEXT = pa.int64(), pa.float64(), pa.string()

PLACE: Columns = {
    "row": Column(COUNT, "1", "number of the flight"),
    "cell": Column(COUNT, "1", "number of its cell"),
    "repeat": Column(COUNT, "1", "number of its draws, which are the same in every cell"),
}
DRAWN: Columns = {"member": Column(TEXT, "", "network that was drawn from the ensemble")}
FLIGHT: Columns = {
    "config_hash": Column(TEXT, "", "digest of its configuration"),
    "outcome": Column(TEXT, "", "how it ended"),
    "lost_time": Column(NUMBER, "s", "when it was lost"),
    "lost_reason": Column(TEXT, "", "criterion of the loss"),
    "error": Column(TEXT, "", "why it could not be flown"),
} | {column: Column(NUMBER, figure.unit, figure.meaning) for column, figure in quantities.COLUMNS.items()}
FLIGHTS: Columns = {**PLACE, **DRAWN, **FLIGHT}
"""The table of flights; the axes stand between their place and what was flown."""


def _of_cells() -> Iterator[tuple[str, Column]]:
    yield "cell", Column(COUNT, "1", "number of the cell")
    yield "flights", Column(COUNT, "1", "flights that could be flown")
    yield "errors", Column(COUNT, "1", "flights that could not be flown")
    for name, text in SHARES.items():
        yield name, Column(COUNT, "1", f"flights that {text}")
        for end in ("low", "high"):
            yield f"{name}_{end}", Column(NUMBER, "1", f"{end} end of the Wilson 95 % interval of their share")
    for outcome in OUTCOMES:
        if outcome not in SHARES:
            yield outcome, Column(COUNT, "1", f"flights with the outcome {outcome}")
    yield "lost", Column(COUNT, "1", "flights that neither completed nor landed")
    unwarned = f"lost flights that were degraded for less than {LEAST_WARNING:g} s before, or never if flown to the end"
    yield "unwarned", Column(COUNT, "1", unwarned)
    for column in QUANTITIES:
        _, unit, meaning = FLIGHTS[column]
        for population, (end, share) in itertools.product(populations(column), QUANTILES.items()):
            text = {"median": "median", "worst": "greatest"}.get(end, f"{100.0 * share:g} % quantile")
            said = f"{text}, over {POPULATIONS[population]}, of: {meaning}"
            yield quantile(column, end, population), Column(NUMBER, unit, said)


CELLS: Columns = dict(_of_cells())


def fields(columns: Columns) -> list[pa.Field]:
    """Return the fields of a table, with `unit` and `meaning` in their metadata; `sweep.json` describes the axes."""
    return [pa.field(name, of.type, metadata={"unit": of.unit, "meaning": of.meaning}) for name, of in columns.items()]


def page() -> str:
    """Return the page with the columns of both tables."""
    lines = ["# Columns of a sweep's tables", "", "Axes are columns too; their units are in `sweep.json`."]
    for file, columns in (("table.parquet", FLIGHTS), ("cells.parquet", CELLS)):
        lines += ["", f"## {file}", "", "| column | unit | meaning |", "|---|---|---|"]
        lines += [f"| `{name}` | {of.unit} | {of.meaning} |" for name, of in columns.items()]
    return "\n".join([*lines, ""])
