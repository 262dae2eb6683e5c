"""Intervals that hold the true value with 95 %: of shares, and of differences between flights on the same draws."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Interval: TypeAlias = tuple[float, float, float]
"""A value and the ends of its interval; NaN without flights."""

UNKNOWN: Interval = (math.nan, math.nan, math.nan)

RESAMPLES = 2000
"""Resamples of the bootstrap, which are the same in every call."""


@cache
def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % score interval of a share; (0, 1) without trials."""
    from scipy.stats import binomtest

    if trials == 0:
        return 0.0, 1.0
    interval = binomtest(int(successes), int(trials)).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


SHARE = "completed or landed [%], Wilson 95 %"


def share(successes: int, trials: int) -> Interval:
    """Return a share, and its interval [%]."""
    low, high = wilson(successes, trials)
    return (100.0 * successes / trials if trials else math.nan), 100.0 * low, 100.0 * high


def newcombe(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> Interval:
    """Return the difference of two shares of paired trials, and its interval.

    Source: Newcombe, Improved confidence intervals for the difference between binomial proportions based on paired
    data, 1998, method 10: Wilson's limits of each share, and the correlation φ of the pairs.
    """
    n = len(first)
    if n == 0:
        return UNKNOWN
    p, q = float(first.mean()), float(second.mean())
    (p_low, p_high), (q_low, q_high) = (wilson(int(x.sum()), n) for x in (first, second))
    a, d, b, c = (int(x.sum()) for x in (first & second, ~first & ~second, first & ~second, ~first & second))
    product = a * d - b * c
    root = math.sqrt((a + b) * (c + d) * (a + c) * (b + d))
    phi = 0.0 if root == 0.0 else (max(product - n / 2.0, 0.0) if product > 0 else product) / root

    def reach(x: float, y: float) -> float:
        return math.sqrt(max(x * x - 2.0 * phi * x * y + y * y, 0.0))

    return p - q, p - q - reach(p - p_low, q_high - q), p - q + reach(p_high - p, q - q_low)


BEYOND = 1e300
"""What stands for infinity in a quantile: NumPy makes NaN between two infinities."""


def quantiles(values: NDArray[np.float64], shares: Sequence[float], axis: int | None = None) -> NDArray[np.float64]:
    """Return quantiles of values, some of which may be infinite; what is between one of them and a number is too.

    >>> quantiles(np.array([1.0, 2.0, 3.0, np.inf]), [0.5, 0.9])
    array([2.5, inf])
    """
    clipped = np.quantile(np.clip(values, -BEYOND, BEYOND), shares, axis=axis)
    # A share of the way from a number to `BEYOND` is greater than any number of a flight.
    return np.where(abs(clipped) > 1e-9 * BEYOND, np.copysign(np.inf, clipped), clipped)


def bootstrap(values: NDArray[np.float64]) -> Interval:
    """Return the median of values, and the percentile interval of its bootstrap; values may be infinite."""
    if len(values) == 0:
        return UNKNOWN
    chosen = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    (median,) = quantiles(values, [0.5])
    low, high = quantiles(quantiles(values[chosen], [0.5], axis=1)[0], [0.025, 0.975])
    return float(median), float(low), float(high)
