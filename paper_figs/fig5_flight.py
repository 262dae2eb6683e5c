"""Fig. 5, panels b to i: one mission flown twice.

b  smoothed CoM reference    c  wind
d, g  joint errors by group    e, h  total aerodynamic force    f, i  thrusts

Panel a of the paper is a picture of a viewer; `fig5a` draws it.
"""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import panels, style
from jax_aero.figures.entry import Entry


def draw(first: xr.Dataset, second: xr.Dataset) -> Figure:
    """Draw the figure from two runs: the first in panels d to f, the second in g to i."""
    figure = style.figure(7.4)
    top, upper, lower = figure.subfigures(3, 1, height_ratios=(1.0, 1.15, 1.22), squeeze=False)[:, 0]

    b, c = top.subplots(1, 2)
    panels.components(b, first["com_setpoint"])
    panels.components(c, first["wind"])
    style.letters((b, c), "bc")
    for axes in (b, c):
        axes.set_xlabel("time [s]")
        style.legend_above(axes, columns=3)

    panels.row(upper, first, "def")
    panels.row(lower, second, "ghi", control=True)
    end = max(float(run["time"][-1]) for run in (first, second))
    for axes in figure.axes:
        axes.set_xlim(0.0, end)
    return figure


FIGURES = {
    "fig5": Entry(draw, "Fig. 5 b-i: one mission flown twice", "flight", ("test2", "test1")),
    "fig5_robustness": Entry(
        draw, "Fig. 5 b-i as the paper fills it: TEST4, robustness", "flight", ("test4", "robustness")
    ),
}
