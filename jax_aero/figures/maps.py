"""Effect of two variables: maps of the share of completed flights and of the largest errors, per panel."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from jax_aero.figures import style
from jax_aero.figures.sweeps import axis_label, level_label, require, shown_figure
from jax_aero.sweep.result import SweepResult

MOST = {"max_rotation_error_deg": 90.0, "max_com_error": 100.0}
"""Greatest values of the colours; those of other figures of merit have none."""


def draw(sweep: SweepResult) -> Figure:
    """Draw a sweep with two axes beside its panels."""
    suits = len(sweep.axes) == 2 and all(map(sweep.is_numeric, sweep.axes))
    require(sweep, suits, "two axes of numbers beside the panels")
    down, across = sweep.axes
    panel = sweep.panel_axis
    levels = [None] if panel is None else list(dict.fromkeys(sweep.cells[panel["name"]]))
    rows = 1 + len(sweep.of)
    figure = style.figure(2.35 * rows + 0.4)
    grid = figure.subplots(rows, len(levels), sharex=True, sharey=True, squeeze=False)
    for row, of in enumerate((None, *sweep.of)):
        title, values, most = "flights completed or landed", sweep.cells["upright"], sweep.cells["flights"].max()
        if of is not None:
            worst = shown_figure(of, sweep.cells, "worst")
            title, values = f"worst {worst.text.removeprefix('max ')},\nof those", worst.values
            most = MOST.get(of, values[np.isfinite(values)].max())
        for column, level in enumerate(levels):
            table = sweep.cells.assign(shown=values)
            cells = table if panel is None or level is None else table[table[panel["name"]] == level]
            axes = grid[row, column]
            image = _map(axes, cells, (down["name"], across["name"]), float(most), is_error=of is not None)
            if row == 0 and panel is not None:
                axes.set_title(level if column else level_label(panel, level))
            if column == 0:
                axes.set_ylabel(axis_label(down))
        figure.colorbar(image, ax=grid[row, :].tolist(), label=title, pad=0.01, ticks=MaxNLocator(integer=True))
    if len(levels) * sweep.cells[across["name"]].nunique() > 24:  # the numbers would touch
        for axes in grid[-1]:
            axes.tick_params(axis="x", rotation=90)
    grid[-1, 0].set_xlabel(axis_label(across), loc="left")  # once: beside each other labels overlap
    style.title(figure, sweep.title)
    n, least = sweep.cells["flights"].max(), _least_share(sweep.cells)
    style.footnote(figure, f"{sweep.each}; a cell of {n} of {n} stands for at least {least:.0f} % (Wilson 95 %)")
    return figure


def _least_share(cells: pd.DataFrame) -> float:
    """Return the low end of the interval of a cell without a flight that is lost or off its course [%]."""
    full = cells[cells["upright"] == cells["flights"]]
    return 100.0 * float(full["upright_low"].min()) if len(full) else 0.0


def _map(axes: Axes, cells: pd.DataFrame, names: tuple[str, str], most: float, *, is_error: bool) -> AxesImage:
    # Not `pivot_table`, which drops a level without numbers and thereby shifts the others.
    values, colours = (
        cells.pivot(index=names[0], columns=names[1], values="shown"),
        "cividis_r" if is_error else "cividis",
    )
    norm = Normalize(0.0, most)
    image = axes.imshow(values, cmap=colours, norm=norm, aspect="auto", origin="lower")
    axes.set_xticks(range(values.shape[1]), [f"{value:g}" for value in values.columns])
    axes.set_yticks(range(values.shape[0]), [f"{value:g}" for value in values.index])
    axes.grid(visible=False)
    for line, count in ((axes.axvline, values.shape[1]), (axes.axhline, values.shape[0])):
        for edge in np.arange(1, count) - 0.5:
            line(edge, color="white", linewidth=0.6)
    for y, x in np.ndindex(values.shape):
        value = float(values.iloc[y, x])
        shade = 1.0 - norm(min(value, most)) if is_error else norm(min(value, most))
        # Values after a fall are not meaningful.
        text = "–" if np.isnan(value) else f">{most:g}" if value > most else f"{value:.0f}"
        axes.text(x, y, text, ha="center", va="center", fontsize=5.8, color="white" if shade < 0.55 else "black")
    return image
