"""Greatest moment per angle that the robot holds against the gain of the observer, predicted and flown."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.entry import Entry

COLOURS = {"roll": style.VERMILION, "yaw": style.BLUE}


def draw(study: xr.Dataset) -> Figure:
    """Draw a line for the linearised loop and dots for flights, for each axis."""
    figure = style.figure(2.8, width=0.6 * style.FULL_WIDTH)
    axes = figure.subplots()
    for axis in study["axis"].values:
        colour = COLOURS[str(axis)]
        of_axis = study.sel(axis=axis)
        axes.plot(study["gain"], of_axis["predicted"], color=colour, label=f"{axis}, linearised loop")
        axes.plot(study["gain"], of_axis["flown"], "o", color=colour, markersize=4, label=f"{axis}, flown")
    axes.set_yscale("log")
    axes.set_xlabel("gain of the observer [1/s]")
    axes.set_ylabel("greatest dM/dθ [N m/rad]")
    axes.legend()
    return figure


FIGURES = {
    "observer_limit": Entry(draw, "the greatest dM/dθ against the observer's gain", "observer_limit", ("hover",)),
}
