"""Differences between levels of an axis of a sweep, flight by flight on the same draws.

A flight has the random numbers of its repeat in every cell, so that flights of two levels are pairs. Of each pair the
other axes are equal too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from jax_aero.base.result import UPRIGHT
from jax_aero.base.terminal import Refused
from jax_aero.sweep.intervals import bootstrap, newcombe

COUNTS = {
    "pairs": "pairs",
    "lost_before": "lost in the first alone",
    "lost_after": "in the other alone",
    "lost_both": "in both",
}
"""Numbers of pairs, all and those of which flights are lost, by column."""

ERRORS = {"rotation": ("max_rotation_error_deg", 1.0), "com": ("max_com_error", 100.0)}
"""Column of the table of flights, and factor, by column."""

COLUMNS = {
    "share": "completed or landed [percentage points], Newcombe 95 %",
    "rotation": "max rotation error, median of all [deg], bootstrap 95 %",
    "com": "max CoM error, median of all [cm], bootstrap 95 %",
    "rotation_of_upright": "max rotation error, median of pairs without a loss [deg]",
    "com_of_upright": "max CoM error, median of pairs without a loss [cm]",
}
"""Whose differences the columns are; each has two more, for the ends of its interval.

A difference is infinite if one flight of the pair is lost, and zero if both are: a loss is worse than any error, and as
bad as another.
"""

OF_UPRIGHT = tuple(f"{name}_of_upright" for name in ERRORS)
"""Those of the pairs of which both flights complete or land, whose number is a further column."""


def differences(flights: pd.DataFrame, axes: list[str], axis: str) -> pd.DataFrame:
    """Return the differences of every level of an axis to its first one, a row for each combination of the others."""
    if axis not in axes or flights[axis].nunique() < 2:
        raise Refused(f"--paired is {axis}; expected an axis with two levels or more, of {', '.join(axes)}")
    flights = flights[flights["outcome"] != "error"]
    others = [name for name in axes if name != axis]
    reference, *levels = flights[axis].unique()
    rows = []
    for labels, mine in flights.groupby(others, sort=False) if others else [((), flights)]:
        by_repeat = mine.set_index("repeat")
        first = by_repeat[by_repeat[axis] == reference]
        for level in levels:
            pairs = first.merge(by_repeat[by_repeat[axis] == level], on="repeat", suffixes=("", "_2"))
            named = dict(zip(others, labels, strict=True)) | {axis: f"{level} − {reference}"}
            rows.append(named | dict(_difference(pairs)))
    return pd.DataFrame(rows)


def _difference(pairs: pd.DataFrame) -> Iterator[tuple[str, Any]]:
    before, after = (pairs[name].isin(UPRIGHT).to_numpy() for name in ("outcome", "outcome_2"))
    intervals = {"share": [100.0 * x for x in newcombe(after, before)]}
    numbers = {"pairs": len(pairs)}
    for name, which in (("before", after & ~before), ("after", before & ~after), ("both", ~before & ~after)):
        numbers[f"lost_{name}"] = int(which.sum())
    for name, (figure, factor) in ERRORS.items():
        change = factor * (pairs[f"{figure}_2"] - pairs[figure]).to_numpy(dtype=float)
        ranked = np.select([before & after, before, after], [change, np.inf, -np.inf], 0.0)
        intervals[name] = list(bootstrap(ranked[~np.isnan(ranked)]))
        of_both = change[before & after & np.isfinite(change)]
        intervals[f"{name}_of_upright"] = list(bootstrap(of_both))
        numbers[f"{name}_of_upright_pairs"] = len(of_both)
    yield from numbers.items()
    for name, interval in intervals.items():
        yield from zip((name, f"{name}_low", f"{name}_high"), interval, strict=True)
