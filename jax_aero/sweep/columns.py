"""Columns of a sweep's tables: type, unit and meaning, in the files' metadata and on one page of the site."""

from __future__ import annotations

import itertools
import typing
from collections.abc import Iterator, Mapping
from typing import NamedTuple, TypeAlias

import pyarrow as pa

from jax_aero.base import quantities
from jax_aero.base.result import Outcome

PAGE = "reference/columns.md"

OUTCOMES: tuple[str, ...] = typing.get_args(Outcome)

QUANTITIES = ("lost_time", *(column for column, figure in quantities.COLUMNS.items() if not figure.codes))
"""Columns of the table of flights whose quantiles that of cells has."""

QUANTILES = {"p10": 0.1, "median": 0.5, "p90": 0.9, "worst": 1.0}

OF_ALL, OF_UPRIGHT, OF_LOST = "of_all", "of_upright", "of_lost"
POPULATIONS = {
    OF_ALL: "all flights, of which lost ones have the greatest, infinity",
    OF_UPRIGHT: "the flights that completed or landed",
    OF_LOST: "the flights that were lost",
}
"""The flights that a quantile is of: the end of its column's name."""


def populations(column: str) -> tuple[str, ...]:
    """Return of which flights the quantiles of a column of the table of flights are.

    Those of an error are of all flights, so that a loss cannot make it smaller, and of those that are upright. Other
    figures of a lost flight are of a shorter one, and are compared with none.
    """
    if column in ("lost_time", "warning_time"):
        return (OF_LOST,)
    return (OF_ALL, OF_UPRIGHT) if quantities.COLUMNS[column].is_error else (OF_UPRIGHT,)


def quantile(column: str, end: str, population: str) -> str:
    """Return the name of a quantile of a column of the table of flights.

    >>> quantile("max_rotation_error_deg", "p90", OF_ALL)
    'rotation_error_deg_p90_of_all'
    """
    return f"{column.removeprefix('max_')}_{end}_{population}"


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
