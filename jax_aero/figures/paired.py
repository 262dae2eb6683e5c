"""Differences of the levels of an axis to its first one, on the same draws, with their intervals."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.sweeps import level_label
from jax_aero.results.sweep import SweepResult
from jax_aero.sweep.paired import COLUMNS, differences

HEIGHT, WIDTH = 0.16, 22
"""Of a row [inches], and of a panel's label beside long names of levels [characters]."""


def draw(sweep: SweepResult, axis: str) -> Figure:
    """Draw the differences of share and median errors, a row for each level and combination of the other axes."""
    names = {one["name"]: one for one in sweep.document["axes"]}
    found = differences(sweep.flights, list(names), axis)
    others = [names[name] for name in found if name in names and name != axis]
    labels = [
        ", ".join([*(level_label(one, row[one["name"]]) for one in others), row[axis]])
        for row in found.to_dict("records")
    ]
    figure = style.figure(1.3 + HEIGHT * len(found))
    row = figure.subplots(1, len(COLUMNS), sharey=True)
    place = np.arange(len(found))
    for axes, (name, title) in zip(row, COLUMNS.items(), strict=True):
        axes.hlines(place, found[f"{name}_low"], found[f"{name}_high"], color=style.BLUE, linewidth=1.4)
        axes.plot(found[name], place, "o", color=style.BLUE, markersize=3.8)
        axes.axvline(0.0, color=style.BLACK, linewidth=0.6)
        axes.set_xlabel(textwrap.fill(title, WIDTH))
    row[0].set_yticks(place, labels)
    row[0].set_ylim(len(found) - 0.5, -0.5)
    style.title(figure, f"{sweep.title}: differences")
    style.footnote(figure, f"pairs of flights on the same draws; {sweep.each}")
    return figure
