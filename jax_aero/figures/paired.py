"""Differences of the levels of an axis to its first one, on the same draws, with their intervals."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.sweeps import level_label
from jax_aero.sweep.paired import COLUMNS, differences
from jax_aero.sweep.result import SweepResult

HEIGHT, WIDTH = 0.3, 22
"""Of a row [inches], and of a panel's label beside long names of levels [characters]."""
PANELS = ("share", "rotation", "com")
"""Those of the columns that are drawn: of all pairs."""
BEYOND = 1.2
"""Where infinite differences are drawn: so many times as far out as the greatest finite one."""


def draw(sweep: SweepResult, axis: str) -> Figure:
    """Draw the differences of share and median errors, a row for each level and combination of the other axes."""
    names = {one["name"]: one for one in sweep.document["axes"]}
    table = differences(sweep.flights, list(names), axis)
    others = [names[name] for name in table if name in names and name != axis]
    labels = [
        ", ".join([*(level_label(one, row[one["name"]]) for one in others), row[axis]]) + f"\n{_losses(row)}"
        for row in table.to_dict("records")
    ]
    figure = style.figure(1.3 + HEIGHT * len(table))
    row = figure.subplots(1, len(PANELS), sharey=True)
    place = np.arange(len(table))
    for axes, name in zip(row, PANELS, strict=True):
        ends = table[[f"{name}_low", name, f"{name}_high"]].to_numpy(dtype=float)
        finite = abs(ends[np.isfinite(ends)])
        edge = BEYOND * finite.max(initial=0.0) or 1.0
        low, middle, high = np.clip(ends, -edge, edge).T
        axes.hlines(place, low, high, color=style.BLUE, linewidth=1.4)
        is_finite = np.isfinite(ends[:, 1])
        axes.plot(middle[is_finite], place[is_finite], "o", color=style.BLUE, markersize=3.8)
        for sign, marker in ((-1.0, "<"), (1.0, ">")):
            is_beyond = (ends == sign * np.inf).any(axis=1)
            axes.plot(
                np.full(is_beyond.sum(), sign * edge), place[is_beyond], marker, color=style.VERMILION, markersize=4.5
            )
        axes.axvline(0.0, color=style.BLACK, linewidth=0.6)
        axes.set_xlabel(textwrap.fill(COLUMNS[name], WIDTH))
    row[0].set_yticks(place, labels)
    row[0].set_ylim(len(table) - 0.5, -0.5)
    style.title(figure, f"{sweep.title}: differences")
    style.footnote(figure, f"pairs of flights on the same draws; arrow: as far as a loss; {sweep.each}")
    return figure


def _losses(row: Mapping[str, Any]) -> str:
    """Return how many pairs there are, and how many flights of each level are lost."""
    before, after = (row[f"lost_{name}"] + row["lost_both"] for name in ("before", "after"))
    return f"{row['pairs']} pairs, lost {after} − {before}"
