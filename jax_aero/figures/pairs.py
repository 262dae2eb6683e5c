"""Every pair of levels, two panels in one square: how its flights end, and whether a loss was announced."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from jax_aero.figures import style
from jax_aero.figures.sweeps import require
from jax_aero.sweep.result import SweepResult

KINDS = (
    ("completed", style.SKY),
    ("landed", style.GREEN),
    ("lost, announced", style.ORANGE),
    ("lost, less than 0.3 s before", style.BLACK),
)
"""Names and colours of what the worst flight of a pair can be, from the best to the worst."""
COUNTS = ("completed", "landed", "lost", "unwarned")
"""Numbers of such flights in a cell."""


def draw(sweep: SweepResult) -> Figure:
    """Draw a sweep over pairs: the first panel above the diagonal, the second below it."""
    panels = [None] if sweep.panel_axis is None else list(sweep.panel_axis["levels"])
    names = [axis["name"] for axis in sweep.axes]
    suits = len(names) == 2 and names[1] == f"{names[0]}_2" and len(panels) <= 2
    require(sweep, suits, "the axes of pairs beside at most two panels")
    levels = sweep.axes[0]["levels"]
    square = np.full((len(levels), len(levels)), np.nan)
    for place, panel in enumerate(panels):
        own = sweep.cells if panel is None else sweep.cells[sweep.cells[sweep.document["panels"]] == panel]
        kinds = worst(own, names[0], levels)
        square = np.where(np.isnan(square), kinds if place == 0 else kinds.T, square)
    figure = style.figure(7.0)
    axes = figure.subplots()
    axes.imshow(square, cmap=ListedColormap([colour for _, colour in KINDS]), vmin=0, vmax=len(KINDS) - 1)
    places = range(len(levels))
    axes.set_xticks(places, [str(place) for place in places], fontsize=6)
    axes.set_yticks(places, [f"{level}  {place}" for place, level in enumerate(levels)], fontsize=7)
    axes.set_xticks(np.arange(len(levels)) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(levels)) - 0.5, minor=True)
    axes.grid(visible=False)
    axes.grid(which="minor", color="white", linewidth=0.8)
    axes.tick_params(which="both", length=0)
    axes.xaxis.tick_top()
    axes.spines[:].set_visible(False)
    handles = [Patch(color=colour, label=name) for name, colour in KINDS]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=4, fontsize=7, frameon=False)
    named = [
        f"{where}: {panel}" for where, panel in zip(("above the diagonal", "below"), panels, strict=False) if panel
    ]
    style.title(figure, "; ".join([sweep.title, *named]))
    style.footnote(figure, sweep.each)
    return figure


def worst(cells: pd.DataFrame, name: str, levels: list[str]) -> NDArray[np.float64]:
    """Return the index in `KINDS` of the worst flight of every pair, above the diagonal; NaN where there is none."""
    kinds = np.full((len(levels), len(levels)), np.nan)
    by_pair = cells.set_index([name, f"{name}_2"])
    for (row, first), (column, second) in combinations(enumerate(levels), 2):
        if (first, second) in by_pair.index:
            cell = by_pair.loc[(first, second)]
            kinds[row, column] = next(kind for kind in range(len(KINDS))[::-1] if kind == 0 or cell[COUNTS[kind]])
    return kinds
