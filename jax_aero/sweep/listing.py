"""Printed tables of a sweep: its cells, or differences between levels of an axis, with their intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import pandas as pd

from jax_aero.results.table import Rows
from jax_aero.sweep.columns import OUTCOMES
from jax_aero.sweep.intervals import SHARE, share
from jax_aero.sweep.paired import COLUMNS, COUNTS, OF_UPRIGHT
from jax_aero.sweep.populations import OF_ALL, quantile

ERRORS = {
    "max rotation error [deg], median of all, 10 to 90 %": ("max_rotation_error_deg", 1.0),
    "max CoM error [cm], median of all, 10 to 90 %": ("max_com_error", 100.0),
}
"""Errors, and factors, by heading; those of lost flights are the greatest, `lost`."""

Labels = Mapping[str, str]
"""Headings of the axes, by name."""


def of_cells(cells: pd.DataFrame, labels: Labels) -> Rows:
    """Return levels, outcomes, share and errors of the cells."""
    shares = [share(*numbers) for numbers in zip(cells["upright"], cells["flights"], strict=True)]
    columns = [(label, _levels(cells[name])) for name, label in labels.items()]
    columns += [("flights", _levels(cells["flights"]))]
    columns += [(name.replace("_", " "), _levels(cells[name])) for name in OUTCOMES if cells[name].any()]
    columns += [(SHARE, _intervals(shares, ".0f"))]
    for heading, (error, factor) in ERRORS.items():
        names = [quantile(error, end, OF_ALL) for end in ("median", "p10", "p90")]
        values = factor * cells[names].astype(float)
        columns += [(heading, _intervals(values.to_numpy(), ".2f"))]
    return _rows(columns)


def of_pairs(differences: pd.DataFrame, labels: Labels) -> Rows:
    """Return the differences of `paired.differences`, each column of them after the number of pairs that it is of."""
    columns = [(labels[name], _levels(differences[name])) for name in differences if name in labels]
    columns += [(heading, _levels(differences[name])) for name, heading in COUNTS.items()]
    for name, heading in COLUMNS.items():
        values = differences[[name, f"{name}_low", f"{name}_high"]].to_numpy()
        if name in OF_UPRIGHT:
            columns += [("of pairs", _levels(differences[f"{name}_pairs"]))]
        columns += [(heading, _intervals(values, "+.1f" if name == "share" else "+.2f"))]
    return _rows(columns)


def _rows(columns: Sequence[tuple[str, list[str]]]) -> Rows:
    """Return columns as rows, headings first, without those that are empty."""
    return list(zip(*([heading, *cells] for heading, cells in columns if any(cells)), strict=True))


def _levels(values: Iterable[object]) -> list[str]:
    return [f"{value:g}" if isinstance(value, float) else str(value) for value in values]


def _intervals(values: Iterable[Sequence[float]], form: str) -> list[str]:
    shown = ([_number(end, form) for end in value] for value in values)
    return ["" if middle in ("nan", "+nan") else f"{middle} ({low} to {high})" for middle, low, high in shown]


def _number(value: float, form: str) -> str:
    """Return a number; infinite are an error that is lost, and a difference by which a loss comes or goes."""
    if abs(value) == math.inf:
        return f"{'' if '+' not in form else '+' if value > 0.0 else '−'}lost"
    return format(value, form)
