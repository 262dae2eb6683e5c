"""Fig. 4 a-c: drag area of the head over the local angle of attack, as computed, as predicted, and the error.

The upper row predicts randomly held-out rows, as in the paper; the lower row whole postures without a training row.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

LINK = "head"
SPLITS = (("random", "random rows held out"), ("grouped", "whole postures held out"))
LIMIT = 0.01
"""Limit of the errors shown [m²]; larger ones are drawn at the edge."""

Values = npt.NDArray[np.float64]


def draw(study: xr.Dataset) -> Figure:
    """Draw data, predictions and errors, both splits below each other."""
    here = study.sel(link=LINK)
    figure = style.figure(4.4)
    grid = figure.subplots(2, 3, sharex=True)
    data, model = _drag(here, "area"), _drag(here, "area_axisymmetric")
    for row, (split, title) in enumerate(SPLITS):
        predicted = _drag(here, f"area_{split}")
        shown = np.isfinite(predicted)
        angle = here["attack"].values[shown]
        left, middle, right = grid[row]
        _cloud(left, angle, data[shown], style.GREY, "CFD")
        _cloud(middle, angle, predicted[shown], style.BLUE, "network")
        order = np.argsort(angle)
        middle.plot(angle[order], 1e3 * model[shown][order], color=style.VERMILION, label="axisymmetric")
        for values, colour, label in ((model, style.VERMILION, "axisym."), (predicted, style.BLUE, "network")):
            error = values[shown] - data[shown]
            text = f"{label}: rms {1e3 * np.sqrt(np.mean(error**2)):.2f}"
            _cloud(right, angle, np.clip(error, -LIMIT, LIMIT), colour, text)
        left.set_ylabel(f"{title}\n$C_D A$ [$10^{{-3}}$ m$^2$]")
        right.set_ylim(-1e3 * LIMIT * 1.05, 1e3 * LIMIT * 1.05)
        middle.sharey(left)
        for axes in (middle, right):
            style.legend_above(axes, columns=2)
            for handle in axes.get_legend().legend_handles:  # the dots of the data are too small for a legend
                handle.set(alpha=1.0, markersize=5.0)
    for axes, title in zip(grid[0], ("data", "prediction", "error [$10^{-3}$ m$^2$]"), strict=True):
        axes.set_title(title, pad=16)
    for axes in grid[1]:
        axes.set_xlabel("angle of attack of the head [deg]")
    style.letters(grid.ravel())
    grid[0, 0].set_xlim(0.0, 180.0)
    return figure


def _drag(study: xr.Dataset, name: str) -> Values:
    """Return the component along the wind [m²]."""
    return np.asarray((study[name] * study["wind"]).sum("xyz", skipna=False), dtype=np.float64)


def _cloud(axes: Axes, angle: Values, area: Values, colour: str, label: str) -> None:
    axes.plot(
        angle,
        1e3 * area,
        ".",
        color=colour,
        markersize=1.4,
        markeredgewidth=0.0,
        alpha=0.5,
        label=label,
        rasterized=True,
    )


FIGURES = {
    "fig4_network": Entry(draw, "Fig. 4 a-c: the network's drag of the head, two splits", "training", ("compact",)),
}
