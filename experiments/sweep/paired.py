"""Differences between levels of an axis of a sweep, flight by flight on the same draws.

A flight has the random numbers of its repeat in every cell, so that flights of two levels are pairs. Of each pair the
other axes are equal too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments import Refused
from experiments.sweep.table import wilson
from jax_aero.base.result import UPRIGHT

RESAMPLES = 2000
"""Resamples of the bootstrap, which are the same in every call."""
COLUMNS = {
    "share": "completed or landed [percentage points], Newcombe 95 %",
    "rotation": "max rotation error, median [deg], bootstrap 95 %",
    "com": "max CoM error, median [cm], bootstrap 95 %",
}
"""Whose differences the columns are; each has two more, for the ends of its interval."""


def differences(flights: pd.DataFrame, axes: list[str], axis: str) -> pd.DataFrame:
    """Return the differences of every level of an axis to its first one, a row for each combination of the others.

    Errors are those of pairs of which both flights complete or land.
    """
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
    yield "pairs", len(pairs)
    yield from _named("share", tuple(100.0 * x for x in newcombe(after, before)))
    for name, figure, factor in (("rotation", "max_rotation_error_deg", 1.0), ("com", "max_com_error", 100.0)):
        change = factor * (pairs[f"{figure}_2"] - pairs[figure]).to_numpy()[before & after]
        yield from _named(name, bootstrap(change[np.isfinite(change)]))


def listing(found: pd.DataFrame, labels: Mapping[str, str]) -> list[list[str]]:
    """Return differences as texts, headings first."""
    heads = [name for name in found if name in labels or name == "pairs"]
    rows = [
        [
            *(f"{row[name]:g}" if isinstance(row[name], float) else str(row[name]) for name in heads),
            *("" if np.isnan(row[name]) else _interval(*(row[f"{name}{end}"] for end in ENDS)) for name in COLUMNS),
        ]
        for row in found.to_dict("records")
    ]
    return [[*(labels.get(name, name) for name in heads), *COLUMNS.values()], *rows]


ENDS = ("", "_low", "_high")


def _interval(value: float, low: float, high: float) -> str:
    return f"{value:+.3g} ({low:+.3g} to {high:+.3g})"


def _named(name: str, ends: tuple[float, ...]) -> Iterator[tuple[str, float]]:
    yield from zip((f"{name}{end}" for end in ENDS), ends, strict=True)


def newcombe(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return the difference of two shares of paired trials, and its 95 % interval.

    Source: Newcombe, Improved confidence intervals for the difference between binomial proportions based on paired
    data, 1998, method 10: Wilson's limits of each share, and the correlation φ of the pairs.
    """
    n = len(first)
    if n == 0:
        return math.nan, math.nan, math.nan
    p, q = float(first.mean()), float(second.mean())
    (p_low, p_high), (q_low, q_high) = (wilson(int(x.sum()), n) for x in (first, second))
    a, d, b, c = (int(x.sum()) for x in (first & second, ~first & ~second, first & ~second, ~first & second))
    product = a * d - b * c
    root = math.sqrt((a + b) * (c + d) * (a + c) * (b + d))
    phi = 0.0 if root == 0.0 else (max(product - n / 2.0, 0.0) if product > 0 else product) / root

    def reach(x: float, y: float) -> float:
        return math.sqrt(max(x * x - 2.0 * phi * x * y + y * y, 0.0))

    return p - q, p - q - reach(p - p_low, q_high - q), p - q + reach(p_high - p, q - q_low)


def bootstrap(values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the median of values, and the 95 % percentile interval of its bootstrap."""
    if len(values) == 0:
        return math.nan, math.nan, math.nan
    chosen = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(np.median(values[chosen], axis=1), [0.025, 0.975])
    return float(np.median(values)), float(low), float(high)
