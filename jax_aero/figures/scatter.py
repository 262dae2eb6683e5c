"""Effect of many variables at once: rank correlations with an error, and completed flights along each variable."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure, FigureBase

from jax_aero.base.result import LOST
from jax_aero.figures import style
from jax_aero.figures.ablation import SERIES
from jax_aero.figures.sweeps import axis_label, require, shown_figure
from jax_aero.sweep.result import SweepResult


def draw(sweep: SweepResult) -> Figure:
    """Draw a sampled sweep: rank correlations, then one scatter plot per axis."""
    require(sweep, bool(sweep.axes) and all(map(sweep.is_numeric, sweep.axes)), "axes of numbers beside the panels")
    flights = sweep.flights[sweep.flights["outcome"] != "error"]
    error = shown_figure(sweep.of[0], flights)
    axes_of = sweep.axes
    columns = 3
    rows = -(-len(axes_of) // columns)
    figure = style.figure(2.3 + 1.75 * rows)
    top, bottom = figure.subfigures(2, 1, height_ratios=(2.1, 1.75 * rows), squeeze=False)[:, 0]
    _correlations(top, sweep, flights)
    grid = bottom.subplots(rows, columns, sharey=True, squeeze=False)
    lost = flights["outcome"].isin(LOST)
    for axes, axis in zip(grid.flat, axes_of, strict=False):
        x = flights[axis["name"]]
        axes.plot(
            x[~lost], error.values[~lost], "o", color=style.BLUE, markersize=1.8, alpha=0.6, label="completed or landed"
        )
        axes.plot(x[lost], error.values[lost], "x", color=style.VERMILION, markersize=4, label="lost")
        axes.set_xlabel(axis_label(axis), fontsize=7)
        axes.set_ylim(0.0, 95.0 if sweep.of[0] == "max_rotation_error_deg" else None)
    for axes in grid.flat[len(axes_of) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel(error.text, fontsize=7)
    bottom.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    style.title(figure, sweep.title)
    return figure


def correlations(sweep: SweepResult, flights: pd.DataFrame, error: pd.Series) -> dict[str, float]:
    """Return Spearman's rank correlation of an error with the distance of every input from its middle.

    A bias has effects of either sign, so inputs with a nominal middle count by their distance from it. Flights without
    the error, since they were lost before, are left out.
    """
    by_axis = {}
    known = error.notna()
    for axis in sweep.axes:
        x = flights[axis["name"]]
        middle = (x.max() + x.min()) / 2.0
        size = x if axis["name"] in ("speed", "lag") else (x - middle).abs()
        by_axis[axis["name"]] = float(size[known].rank().corr(error[known].rank()))
    return by_axis


def _correlations(figure: FigureBase, sweep: SweepResult, flights: pd.DataFrame) -> None:
    axes = figure.subplots()
    labels = [axis["label"] for axis in sweep.axes]
    place = np.arange(len(labels))
    for number, (of, (colour, *_)) in enumerate(zip(sweep.of, SERIES, strict=False)):
        seen, width = shown_figure(of, flights), 0.72 / len(sweep.of)
        values = list(correlations(sweep, flights, seen.values).values())
        offset = (number - (len(sweep.of) - 1) / 2.0) * width
        axes.barh(place + offset, values, 0.95 * width, color=colour, label=seen.label.removeprefix("max "))
    axes.set_yticks(place, labels)
    axes.invert_yaxis()
    axes.axvline(0.0, color=style.BLACK, linewidth=0.6)
    axes.set_xlabel("rank correlation with the size of the departure (wind speed and lag: with the value)")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
