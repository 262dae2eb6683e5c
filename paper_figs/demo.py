"""The use of aerodynamic feedback: three controllers, with corrected and with published lever arms."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.base import flights
from paper_figs import panels, style

COLUMNS = ("corrected lever arms", "published lever arms")
CONTROLLERS: Sequence[tuple[str, str, str]] = (
    ("baseline", style.VERMILION, "-"),
    ("aerodynamic-aware", style.BLUE, "--"),
    ("observer, no model", style.GREEN, ":"),
)
WIDTH = 4.0
"""Narrow, so that the text is legible on a telephone [inches]."""

ROWS = tuple(
    (of, shown) for of in (flights.rotation_error, flights.com_error) for shown in (slice(0, 1), slice(1, None))
)
"""What each row shows of which controllers: those whose errors are small have axes of their own."""


def draw(*runs: xr.Dataset) -> Figure:
    """Draw six runs: baseline, aware and observer with corrected arms, then the same with published arms."""
    figure = style.figure(6.0, WIDTH)
    grid = figure.subplots(len(ROWS) + 1, 2, sharex=True, sharey="row", height_ratios=(1.2, 1, 1.2, 1, 0.8))
    for column, title in enumerate(COLUMNS):
        same_arms = runs[len(CONTROLLERS) * column :][: len(CONTROLLERS)]
        grid[0, column].set_title(title, weight="bold")
        for axes, (of, shown) in zip(grid[:, column], ROWS, strict=False):
            for run, (controller, colour, dash) in zip(same_arms[shown], CONTROLLERS[shown], strict=True):
                panels.line(axes, of(flights.until_loss(run)), dash, color=colour, label=controller)
                panels.mark_loss(axes, run, labelled=of is flights.rotation_error)
        panels.components(grid[-1, column], max(same_arms, key=lambda run: run.sizes["time"])["wind"])
        grid[-1, column].set_xlabel("time [s]")
    for left, right in grid:
        left.set_ylabel(left.get_ylabel().replace(" ", "\n", 1))
        right.set_ylabel("")
    for row, columns in ((0, 1), (1, 1), (-1, 3)):
        style.legend(grid[row, 0], ncols=columns, columnspacing=1.0, framealpha=0.0)
    for axes in grid[: len(ROWS), 0]:
        axes.set_ylim(bottom=0.0)  # last, since it disables autoscaling, for the whole row
    grid[0, 0].set_xlim(0.0, max(float(run["time"][-1]) for run in runs))
    return figure
