"""The use of aerodynamic feedback: three controllers, with lever arms corrected and as published."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.base import flights
from jax_aero.base.controllers import CONTROLLERS
from jax_aero.figures import panels, style

COLUMNS = ("lever arms corrected", "lever arms as published")
LINES: Sequence[tuple[str, str, str]] = (
    ("baseline", style.VERMILION, "-"),
    ("aero_aware", style.BLUE, "--"),
    ("observer_without_model", style.GREEN, ":"),
)
"""Controllers, with colours and dashes."""
WIDTH = 4.0
"""Narrow, so that the text is legible on a telephone [inches]."""


def draw(*runs: xr.Dataset) -> Figure:
    """Draw six runs: those of `LINES` with lever arms corrected, then the same as published."""
    figure = style.figure(4.6, WIDTH)
    grid = figure.subplots(3, 2, sharex=True, sharey="row", height_ratios=(1.3, 1.3, 0.8))
    for column, title in enumerate(COLUMNS):
        same_arms = runs[len(LINES) * column :][: len(LINES)]
        grid[0, column].set_title(title, weight="bold")
        for axes, of in zip(grid[:, column], (flights.rotation_error, flights.com_error), strict=False):
            for run, (controller, colour, dash) in zip(same_arms, LINES, strict=True):
                panels.line(axes, of(flights.until_loss(run)), dash, color=colour, label=CONTROLLERS[controller].label)
                panels.mark_loss(axes, run, labelled=of is flights.rotation_error)
        longest = max(same_arms, key=lambda run: run.sizes["time"])
        panels.line(grid[-1, column], longest["wind"].sel(xyz="y"), color=style.BLACK)
        grid[-1, column].set_xlabel("time [s]")
    for left, right in grid:
        left.set_ylabel(left.get_ylabel().replace(" ", "\n", 1))
        right.set_ylabel("")
    grid[-1, 0].set_ylabel("side wind\n[m/s]")
    style.legend(grid[0, 0], framealpha=0.0)
    for axes in grid[:2, 0]:
        axes.set_ylim(bottom=0.0)  # last, since it disables autoscaling, for the whole row
    grid[0, 0].set_xlim(0.0, max(float(run["time"][-1]) for run in runs))
    return figure
