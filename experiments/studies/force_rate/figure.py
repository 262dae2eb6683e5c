"""Rate of the aerodynamic forces along a flight, which the paper's controller neglects, beside the terms it models."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.entry import Entry

NEGLECTED = (
    ("attitude", "links turn", style.ORANGE),
    ("acceleration", "links accelerate", style.SKY),
    ("wind", "wind changes", style.GREEN),
)


def draw(study: xr.Dataset) -> Figure:
    """Draw magnitudes of modelled and neglected terms above, the neglected ones by cause below."""
    data = study.sel(time=slice(study.attrs["settling_time"], None))
    figure = style.figure(4.6)
    grid = figure.subplots(2, 2, sharex=True)
    for column, (rows, title, unit) in enumerate(
        ((slice(0, 3), "rate of the force", "N/s"), (slice(3, 6), "rate of the moment", "N m/s"))
    ):
        above, below = grid[:, column]
        neglected = data["attitude"] + data["acceleration"] + data["wind"]
        _size(above, data["thrust_rate"] + data["lambda_t"], rows, r"jets, $A_T\dot{T} + \Lambda_T\nu$", style.GREY)
        if rows.start == 3:
            _size(above, data["lambda_a"], rows, r"$\Lambda_a\nu$", style.BLUE)
        _size(above, neglected, rows, "neglected", style.VERMILION)
        above.set_yscale("log")
        above.set_ylim(1e-4 if rows.start else 1e-2, None)
        above.set_ylabel(f"{title} [{unit}]")
        style.legend_above(above, columns=3)
        for name, text, colour in NEGLECTED:
            _size(below, data[name], rows, text, colour)
        below.set_ylabel(f"neglected [{unit}]")
        below.set_ylim(bottom=0.0)
        below.set_xlabel("time [s]")
    style.legend_above(grid[1, 0], columns=3)
    style.letters(grid.ravel())
    grid[0, 0].set_xlim(0.0, float(data["time"][-1]))
    return figure


def _size(axes: Axes, signal: xr.DataArray, rows: slice, label: str, colour: str) -> None:
    size = np.sqrt((signal.isel(six=rows) ** 2).sum("six"))
    axes.plot(size["time"], size, color=colour, label=label, linewidth=0.9)


FIGURES = {
    "force_rate": Entry(draw, "the aerodynamic force rate that the controller leaves out", "force_rate", ("test2",)),
}
