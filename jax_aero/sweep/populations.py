"""Names of the quantiles in a table of cells, which say of which flights they are."""

from __future__ import annotations

from jax_aero.base import quantities

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
