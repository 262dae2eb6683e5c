"""Shares of robots that are lost, over the size of what they differ by from what their controllers know."""

from __future__ import annotations

import textwrap

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

COLUMNS = 3
COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.BLACK)
MARKS = "os^v"
WIDTH = 26
"""Characters of a line above a panel."""


def draw(*studies: xr.Dataset) -> Figure:
    """Draw a panel for each error, with a line for each flight."""
    errors = studies[0]["error"].values
    rows = -(-len(errors) // COLUMNS)
    figure = style.figure(1.5 * rows + 0.4, 6.2)
    panels = figure.subplots(rows, COLUMNS, sharey=True).ravel()
    lines = [(study, label) for study in studies for label in study["flown"].values]
    for axes, error in zip(panels, errors, strict=False):
        for (study, label), colour, mark in zip(lines, COLOURS, MARKS, strict=False):
            one = study.sel(flown=label, error=error)
            sizes = np.append(float(one["none"]), one["size"].values)
            lost = np.append(float(one["lost_without"]), one["lost"].values)
            order = np.argsort(sizes)  # sizes that were not flown last
            axes.plot(sizes[order], 100.0 * lost[order], "-", marker=mark, markersize=3, color=colour, label=label)
        axes.axhline(50.0, color=style.GREY, linewidth=0.8, linestyle=":")
        axes.set_title("\n".join(textwrap.wrap(str(error), WIDTH)), fontsize=8)
        axes.set_xlabel(str(studies[0]["unit"].sel(error=error).values))
    for axes in panels[len(errors) :]:
        axes.set_axis_off()
    for axes in panels[::COLUMNS]:
        axes.set_ylabel("lost [%]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, fontsize=7)
    return figure


FIGURES = {
    "margins": Entry(
        draw, "robots that are lost, over the size of what they differ by", "margins", ("flight", "take_off")
    )
}
