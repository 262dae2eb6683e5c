"""Units and meanings of the columns of a sweep's tables: in the files' metadata, and on one page of the site."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import pyarrow as pa

from experiments.sweep import table
from jax_aero import rust

PAGE = "reference/columns.md"
Columns = Mapping[str, tuple[str, str]]
"""Unit, "1" for numbers without, and meaning, by name."""

FLIGHTS: Columns = {
    "row": ("1", "number of the flight"),
    "cell": ("1", "number of its cell"),
    "repeat": ("1", "number of its draws, which are the same in every cell"),
    "member": ("", "network that was drawn from the ensemble"),
    "config_hash": ("", "digest of its configuration"),
    "outcome": ("", "how it ended"),
    "lost_time": ("s", "when it was lost"),
    "lost_reason": ("", "criterion of the loss"),
    "error": ("", "why it could not be flown"),
} | {
    column: (rust.figures()[name].unit if column == name else "deg", rust.figures()[name].meaning)
    for column, name in table.SUMMARY.items()
}

SHARES = {
    "completed": "completed",
    "upright": "completed or landed",
    "on_course": "completed on course",
    "degraded": "were degraded for a time",
}
ENDS = {"p10": "10 % quantile", "median": "median", "p90": "90 % quantile", "worst": "greatest"}


def _of_cells() -> Iterator[tuple[str, tuple[str, str]]]:
    yield "cell", ("1", "number of the cell")
    yield "flights", ("1", "flights that could be flown")
    yield "errors", ("1", "flights that could not be flown")
    for outcome in table.OUTCOMES:
        yield outcome, ("1", f"flights with the outcome {outcome}")
    for name, text in SHARES.items():
        yield name, ("1", f"flights that {text}")
        yield from (
            (f"{name}_{end}", ("1", f"{end} end of the Wilson 95 % interval of their share")) for end in ("low", "high")
        )
    yield "unwarned", ("1", f"lost flights that were degraded for less than {table.LEAST_WARNING:g} s before")
    for name, column in table.QUANTITIES.items():
        unit, meaning = FLIGHTS[column]
        for end, text in ENDS.items():
            yield f"{name}_{end}", (unit, f"{text} of: {meaning}")


CELLS: Columns = dict(_of_cells())


def describe(found: pa.Table, columns: Columns) -> pa.Table:
    """Return a table whose columns have `unit` and `meaning` in their metadata; axes are described by sweep.json."""
    fields = [
        field.with_metadata(dict(zip(("unit", "meaning"), columns[field.name], strict=True)))
        if field.name in columns
        else field
        for field in found.schema
    ]
    return found.cast(pa.schema(fields))


def page() -> str:
    """Return the page with the columns of both tables."""
    lines = ["# Columns of a sweep's tables", "", "Axes are columns too; their units are in `sweep.json`."]
    for file, columns in (("table.parquet", FLIGHTS), ("cells.parquet", CELLS)):
        lines += ["", f"## {file}", "", "| column | unit | meaning |", "|---|---|---|"]
        lines += [f"| `{name}` | {unit} | {meaning} |" for name, (unit, meaning) in columns.items()]
    return "\n".join([*lines, ""])
