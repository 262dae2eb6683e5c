"""The use of aerodynamic feedback: three controllers, with corrected and with published lever arms."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.base import flights
from jax_aero.figures import panels, style

COLUMNS = ("corrected lever arms", "published lever arms")
CONTROLLERS: Sequence[tuple[str, str, str]] = (
    ("baseline", style.VERMILION, "-"),
    ("aerodynamic-aware", style.BLUE, "--"),
    ("observer, no model", style.GREEN, ":"),
)
WIDTH = 4.0
"""Narrow, so that the text is legible on a telephone [inches]."""


def draw(*runs: xr.Dataset) -> Figure:
    """Draw six runs: baseline, aware and observer with corrected arms, then the same with published arms."""
    figure = style.figure(4.6, WIDTH)
    grid = figure.subplots(3, 2, sharex=True, sharey="row", height_ratios=(1.3, 1.3, 0.8))
    for column, title in enumerate(COLUMNS):
        same_arms = runs[len(CONTROLLERS) * column :][: len(CONTROLLERS)]
        grid[0, column].set_title(title, weight="bold")
        for axes, of in zip(grid[:, column], (flights.rotation_error, flights.com_error), strict=False):
            for run, (controller, colour, dash) in zip(same_arms, CONTROLLERS, strict=True):
                panels.line(axes, of(flights.until_loss(run)), dash, color=colour, label=controller)
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
