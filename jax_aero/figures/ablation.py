"""Effect of one variable on the share of flights that complete or land, the rotation error and the position error.

Named levels are drawn as dots in rows, numbers as lines. A panel's level (world, controller) has the same colour and
marker everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.sweeps import axis_label, level_label, require, shown_figure
from jax_aero.sweep.intervals import SHARE
from jax_aero.sweep.result import SweepResult

SERIES = (
    (style.BLUE, "o", "-"),
    (style.VERMILION, "s", "--"),
    (style.GREEN, "^", "-."),
    (style.ORANGE, "D", ":"),
    (style.PURPLE, "v", "-"),
    (style.BLACK, "P", "--"),
    (style.SKY, "X", "-."),
    (style.GREY, "o", ":"),
    (style.BLUE, "s", "--"),
    (style.VERMILION, "^", "-."),
    (style.GREEN, "D", ":"),
    (style.ORANGE, "v", "-"),
    (style.PURPLE, "P", "--"),
)
"""Colour, marker and dash of each series; the shipped controllers of a challenge are seven."""
CHARACTERS = 125
"""Width of the legend."""
UPRIGHT = SHARE.replace(", ", ",\n")
"""What the first panel shows; the others show figures of merit."""
SPREAD, FROM_MEDIAN = "median, 10 to 90 %", "median to 90 %"
"""Centre and ends of these; of results that were kept without their 10 % quantile."""


def draw(sweep: SweepResult) -> Figure:
    """Draw a sweep with one axis beside its panels."""
    require(sweep, bool(sweep.axes), "an axis beside the panels")
    axis = sweep.axes[-1]
    split = [sweep.panel_axis, *sweep.axes[:-1]]
    groups = _groups(sweep.cells, [part for part in split if part is not None])
    require(sweep, len(groups) <= len(SERIES), f"at most {len(SERIES)} combinations of all axes but the last")
    figure = _curves(sweep, axis, groups) if sweep.is_numeric(axis) else _levels(sweep, axis, groups)
    style.footnote(figure, sweep.each)
    return figure


def _groups(cells: pd.DataFrame, axes: Sequence[dict[str, Any]]) -> list[tuple[str, pd.DataFrame]]:
    """Return the cells of every combination of levels of these axes, with its label, in the order of the file."""
    if not axes:
        return [("", cells)]
    names = [axis["name"] for axis in axes]
    groups = []
    for labels in cells[names].drop_duplicates().itertuples(index=False):
        mine = np.logical_and.reduce([cells[name] == label for name, label in zip(names, labels, strict=True)])
        groups.append((", ".join(map(level_label, axes, labels)), cells[mine]))
    return groups


def spread(cells: pd.DataFrame, figure: str | None) -> tuple[str, Any, Any, Any]:
    """Return label, centre, lower and upper end of a figure of merit for each cell; without one, of the share.

    A figure of merit is that of upright flights, whose share is beside it.
    """
    if figure is None:
        share = 100.0 * cells["upright"] / cells["flights"].clip(lower=1)
        return UPRIGHT, share, 100.0 * cells["upright_low"], 100.0 * cells["upright_high"]
    centre, low, high = (shown_figure(figure, cells, end) for end in ("median", "p10", "p90"))
    known, said = (low.values, SPREAD) if low.values.notna().any() else (centre.values, FROM_MEDIAN)
    return f"{centre.text} of those,\n{said}", centre.values, known, high.values


def _levels(sweep: SweepResult, axis: dict[str, Any], groups: list[tuple[str, pd.DataFrame]]) -> Figure:
    labels = list(dict.fromkeys(sweep.cells[axis["name"]]))
    height = 1.3 + (0.13 + 0.11 * len(groups)) * len(labels)
    figure = style.figure(height)
    row = figure.subplots(1, 1 + len(sweep.of), sharey=True)
    offsets = (np.arange(len(groups)) - (len(groups) - 1) / 2.0) * (0.66 / max(len(groups), 1))
    for axes, of in zip(row, (None, *sweep.of), strict=True):
        for (label, cells), offset, (colour, marker, _) in zip(groups, offsets, SERIES[: len(groups)], strict=True):
            title, centre, low, high = spread(cells, of)
            place = np.array([labels.index(name) for name in cells[axis["name"]]]) + offset
            axes.hlines(place, low, high, color=colour, linewidth=1.4)
            axes.plot(centre, place, marker, color=colour, markersize=3.8, label=label)
        axes.set_xlabel(title)
        axes.set_xlim(left=0.0)
        axes.grid(visible=False, axis="y")
        for line in range(1, len(labels)):
            axes.axhline(line - 0.5, color=style.LIGHT, linewidth=0.5)
    row[0].set_xlim(-2.0, 102.0)
    row[0].set_yticks(range(len(labels)), labels)
    row[0].set_ylim(len(labels) - 0.5, -0.5)
    legend(figure, row[0], sweep.title, len(groups))
    return figure


def _curves(sweep: SweepResult, axis: dict[str, Any], groups: list[tuple[str, pd.DataFrame]]) -> Figure:
    figure = style.figure(2.9)
    row = figure.subplots(1, 1 + len(sweep.of))
    values = sweep.cells[axis["name"]]
    steps = _is_geometric(values)
    for axes, of in zip(row, (None, *sweep.of), strict=True):
        for (label, cells), (colour, marker, dash) in zip(groups, SERIES[: len(groups)], strict=True):
            title, centre, low, high = spread(cells, of)
            axes.fill_between(cells[axis["name"]], low, high, color=colour, alpha=0.16, linewidth=0)
            axes.plot(cells[axis["name"]], centre, dash, marker=marker, color=colour, markersize=3.5, label=label)
        axes.set_ylabel(title)
        axes.set_ylim(bottom=0.0)
        if steps:
            least, most = float(values[values > 0.0].min()), float(values.max())
            axes.set_xscale("symlog", linthresh=least, linscale=0.6)
            axes.set_xlim(-0.3 * least, 1.3 * most)
            axes.set_xticks(sorted(set(values)), [f"{value:g}" for value in sorted(set(values))])
            axes.minorticks_off()
    row[0].set_ylim(-2.0, 102.0)
    row[1].set_xlabel(axis_label(axis))
    legend(figure, row[0], sweep.title, len(groups))
    return figure


def _is_geometric(values: pd.Series) -> bool:
    """Return whether positive values span too wide a range for a linear axis."""
    places = np.unique(values)
    steps, positive = np.diff(places), places[places > 0.0]
    even = bool(np.allclose(steps, steps[0])) if len(steps) else True
    return not even and bool((places >= 0.0).all() and positive.max() >= 10.0 * positive.min())


def legend(figure: Figure, axes: Axes, title: str, count: int) -> None:
    """Draw the title above the panels and, below it, the meaning of the colours."""
    handles, labels = axes.get_legend_handles_labels() if count > 1 else ([], [])
    fit = CHARACTERS // (5 + max(map(len, labels), default=1))
    columns = max(1, min(2 if count > 3 else count, fit))
    drawn = figure.legend(handles, labels, loc="outside upper left", ncols=columns, fontsize=7, title=title)
    drawn.set_alignment("left")
    drawn.get_title().set(fontsize=9.5, fontweight="bold")
