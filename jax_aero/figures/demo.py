"""The use of aerodynamic feedback: four controllers in a wind in which the baseline is lost."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.base import flights
from jax_aero.base.controllers import CONTROLLERS
from jax_aero.figures import panels, style

LINES: Sequence[tuple[str, str, str]] = (
    ("baseline", style.VERMILION, "-"),
    ("aero_aware", style.BLUE, "--"),
    ("observer_without_model", style.GREEN, ":"),
    ("robot", style.BLACK, "-."),
)
"""Controllers, with colours and dashes."""
WIDTH = 4.0
"""Narrow, so that the text is legible on a telephone [inches]."""


def draw(*runs: xr.Dataset) -> Figure:
    """Draw four runs in the same wind, of the controllers of `LINES`."""
    figure = style.figure(4.6, WIDTH)
    rotation, position, wind = figure.subplots(3, 1, sharex=True, height_ratios=(1.3, 1.3, 0.8))
    for axes, of in ((rotation, flights.rotation_error), (position, flights.com_error)):
        for run, (controller, colour, dash) in zip(runs, LINES, strict=True):
            panels.line(axes, of(flights.until_loss(run)), dash, color=colour, label=CONTROLLERS[controller].label)
            panels.mark_loss(axes, run, labelled=axes is rotation)
        axes.set_ylim(bottom=0.0)
    longest = max(runs, key=lambda run: run.sizes["time"])
    panels.line(wind, -longest["wind"].sel(xyz="x"), color=style.BLACK)  # of the air, which moves backwards
    wind.set_ylabel("head wind\n[m/s]")
    wind.set_xlabel("time [s]")
    for axes in (rotation, position):
        axes.set_ylabel(axes.get_ylabel().replace(" ", "\n", 1))
    style.legend(position, framealpha=0.0, loc="center right")
    wind.set_xlim(0.0, float(longest["time"][-1]))
    return figure
