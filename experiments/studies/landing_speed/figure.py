"""Fastest sink from which an engine's loss is landed, over height, with the speed of a landing."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry
from jax_aero.figures.panels import readable_name

COLOURS = (style.BLUE, style.VERMILION)
LINES = {"optimum": ("--", "optimal control"), "flown": ("o-", "all of the robots land")}


def draw(study: xr.Dataset) -> Figure:
    """Draw both curves of each engine; where no speed is landed from there is no point."""
    figure = style.figure(2.8)
    axes = figure.subplots()
    for engine, colour in zip(study["engine"].values, COLOURS, strict=False):
        for of, (line, label) in LINES.items():
            one = study["speed"].sel(engine=engine, of=of)
            axes.plot(one["height"], one, line, color=colour, label=f"{readable_name(engine)}, {label}")
    axes.plot(study["landing_height"], study["landing_speed"], color=style.BLACK, label="a landing")
    axes.axhline(0.0, color=style.BLACK, linewidth=0.5)
    axes.set_xlabel("height at the loss [m]")
    axes.set_ylabel("speed downwards [m/s]")
    style.legend_above(axes, 2)
    return figure


FIGURES = {
    "landing_speed": Entry(draw, "the fastest sink from which an engine's loss is landed", "landing_speed", ("robot",))
}
