"""Greatest wind speed and force at which the standing robot does not tip, against the direction of the wind."""

from __future__ import annotations

from itertools import cycle

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.entry import Entry

LOOKS = ((style.BLUE, "o"), (style.VERMILION, "s"))
DASHES = ("-", "--", ":", "-.")


def draw(study: xr.Dataset) -> Figure:
    """Draw speeds on the left and horizontal forces on the right."""
    figure = style.figure(2.9)
    speeds, forces = figure.subplots(1, 2, sharex=True)
    direction = study["direction"]
    for feedback, (colour, marker) in zip(study["feedback"].values.tolist(), LOOKS, strict=True):
        for friction, dash in zip(study["friction"].values.tolist(), cycle(DASHES), strict=False):
            cell = study.sel(feedback=feedback, friction=friction)
            label = feedback + (f", sole friction {friction:g}" if study["friction"].size > 1 else "")
            size = np.hypot(cell["force"].sel(xyz="x"), cell["force"].sel(xyz="y"))
            # A hollow marker: beyond, the robot slips rather than tips.
            slips = cell["slips"].values.astype(bool)
            for axes, values in ((speeds, cell["speed"]), (forces, size)):
                axes.plot(direction, values, dash, color=colour, label=label)
                axes.plot(direction[~slips], values[~slips], marker, color=colour, markersize=4)
                axes.plot(direction[slips], values[slips], marker, color=colour, markersize=4, markerfacecolor="white")
    speeds.set_ylabel("greatest wind withstood [m/s]")
    forces.set_ylabel("its horizontal force [N]")
    style.letters((speeds, forces))
    for axes in (speeds, forces):
        axes.set_xlabel("wind from [deg]: 0 ahead, 90 left, 180 behind")
        axes.set_xticks(direction)
        axes.set_ylim(bottom=0.0)
    style.legend_above(speeds, columns=1)
    return figure


FIGURES = {
    "tip_over": Entry(draw, "what wind tips the standing robot over", "tip_over", ("ground",)),
}
