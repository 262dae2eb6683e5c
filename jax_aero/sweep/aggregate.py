"""Figures of several flights of a sweep: counts with their intervals, quantiles, what fault detection found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from jax_aero.base.result import LOST, UPRIGHT
from jax_aero.rust import MODES
from jax_aero.sweep import columns, intervals, populations
from jax_aero.sweep.intervals import wilson

ON_COURSE_ROTATION = 15.0
ON_COURSE_COM = 0.25
"""Greatest errors [deg, m] of a completed flight that counts as on course, which is stricter than completed.

A flight that ends within its start-up has no position error and does not count.
"""

KEPT_ERRORS = ("max_rotation_error_deg", "max_com_error")
"""Errors, by columns of the table of flights, that are kept in the documentation."""

KEPT: tuple[str, ...] = (
    *("flights", "completed", "landed", "landing", "on_course", "off_course"),
    *("lost", "crashed", "unwarned", "degraded"),
    *(
        populations.quantile(column, end, population)
        for column in KEPT_ERRORS
        for population in populations.populations(column)
        for end in populations.QUANTILES
    ),
    *("found_s", "announced_s", "lost_s", "modes"),
)
"""Figures that are kept in the documentation."""

COUNTS = KEPT[:10]
"""Those of them that are numbers of flights."""


def figures(flights: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of flights, by the columns of the tables of cells (`columns.CELLS`) and of `KEPT`.

    `flights` are columns of the table of flights, and `onset`, when the first failure begins [s], if it is known. Of
    the warnings, quantiles are those of flights that a loss ends. An error of a lost flight is infinite among those of
    all flights.
    """
    flown = np.asarray(flights["outcome"]) != "error"
    flights = {name: np.asarray(values)[flown] for name, values in flights.items()}
    flights["warning_time"] = np.where(np.isnan(flights["lost_time"]), np.nan, flights["warning_time"])
    row: dict[str, Any] = {"flights": int(flown.sum()), "errors": int((~flown).sum()), **counts(flights)}
    for name in columns.SHARES:
        row[f"{name}_low"], row[f"{name}_high"] = wilson(row[name], row["flights"])
    if row["flights"] and np.isnan(flights["degraded_time"]).all():
        row |= dict.fromkeys(("degraded", "degraded_low", "degraded_high", "unwarned"))
    upright, lost = (np.isin(flights["outcome"], ends) for ends in (UPRIGHT, LOST))
    for column in populations.QUANTITIES:
        values = flights[column].astype(float)
        of = {
            populations.OF_ALL: np.where(lost, np.inf, values),
            populations.OF_UPRIGHT: values[upright],
            populations.OF_LOST: values[lost],
        }
        for population in populations.populations(column):
            ends = quantiles(of[population], populations.QUANTILES.values())
            names = [populations.quantile(column, end, population) for end in populations.QUANTILES]
            row |= dict(zip(names, ends, strict=True))
    if "onset" in flights:
        degraded = flights["degraded_time"] > 0.0
        (row["found_s"],) = quantiles((flights["nominal_until"] - flights["onset"])[degraded], [0.5])
    (row["announced_s"],), (row["lost_s"],) = (
        quantiles(flights[name][lost], [0.5]) for name in ("warning_time", "lost_time")
    )
    bits = np.nan_to_num(flights["all_modes"].astype(float)).astype(int)
    row["modes"] = sum(bit for bit in MODES.values() if len(bits) and np.mean((bits & bit) > 0) >= 0.5)
    return row


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


def quantiles(values: Any, shares: Iterable[float]) -> list[float | None]:
    """Return quantiles of the values that are numbers, of which some may be infinite; `None` without any."""
    values, shares = values.astype(float), list(shares)
    known = values[~np.isnan(values)]
    ends: list[float | None] = intervals.quantiles(known, shares).tolist() if len(known) else [None] * len(shares)
    return ends


def with_intervals(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of the table of cells that follow from the counts of a row."""
    cell: dict[str, Any] = {"upright": row["completed"] + row["landed"]}
    for share, count in (("completed", row["completed"]), ("upright", cell["upright"])):
        cell[f"{share}_low"], cell[f"{share}_high"] = wilson(count, row["flights"])
    return cell


def pool(rows: Iterable[Mapping[str, Any]], times: int = 1) -> dict[str, Any]:
    """Return the kept figures of all flights of some rows, each of which is in so many of these.

    Numbers of flights add up, and the greatest error is that of a row; other quantiles of several rows are unknown.
    """
    rows = list(rows)
    if len(rows) == 1:
        return {name: rows[0][name] for name in KEPT}
    pooled: dict[str, Any] = dict.fromkeys(KEPT) | {name: sum(row[name] for row in rows) // times for name in COUNTS}
    for name in (name for name in KEPT if "_worst_" in name):
        pooled[name] = max((row[name] for row in rows if row[name] is not None), default=None)
    return pooled
