"""Least height lost after an engine stops, by the time and the thrust of the others; fastest descent that is landed."""

from __future__ import annotations

from itertools import cycle

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry
from jax_aero.figures.panels import readable_name

COLOURS = (style.VERMILION, style.BLUE, style.GREEN, style.BLACK)
LINES = {"optimum": ("--", "optimal control"), "flown": ("o-", "all robots land")}
LABELS = {
    "spool_up": "time that the engines take, relative to theirs",
    "thrust": "thrust of the engines, relative to theirs",
}


def draw(study: xr.Dataset) -> Figure:
    """Draw both dependences, and the heights that flights lose as dotted lines."""
    figure = style.figure(2.8)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (axis, label), other in zip(panels, LABELS.items(), reversed(LABELS), strict=True):
        cells = [(robot, engine) for robot in study["robot"].values for engine in study["engine"].values]
        for (robot, engine), colour in zip(cells, cycle(COLOURS), strict=False):
            one = study.sel(robot=robot, engine=engine)
            one = one.isel(others=one[other].values == 1.0).sortby(axis)
            axes.plot(one[axis], one["height"], "o-", color=colour, label=f"{robot}, {readable_name(engine)}")
            axes.axhline(float(one["flown_height"]), color=colour, linestyle=":")
        axes.set_xlabel(label)
    panels[0].set_ylim(bottom=0.0)
    panels[0].set_ylabel("height lost [m]")
    style.legend_above(panels[0], 4)
    return figure


def draw_sink(study: xr.Dataset) -> Figure:
    """Draw the fastest descent from which a loss is landed over its height, and that of a landing."""
    figure = style.figure(2.8)
    axes = figure.subplots()
    for engine, colour in zip(study["engine"].values, COLOURS, strict=False):
        for of, (line, label) in LINES.items():
            one = study["speed"].sel(engine=engine, of=of)
            axes.plot(one["height"], one, line, color=colour, label=f"{readable_name(engine)}, {label}")
    axes.plot(study["landing_height"], study["landing_speed"], color=style.BLACK, label="a landing (mission.land)")
    axes.axhline(0.0, color=style.BLACK, linewidth=0.5)
    axes.set_xlim(0.0, float(study["height"].max()) + 0.2)
    axes.set_xlabel("height at the loss [m]")
    axes.set_ylabel("speed downwards [m/s]")
    style.legend_above(axes, 2)
    return figure


FIGURES = {
    "height_lost": Entry(draw, "the least height lost after an engine stops", "height_lost", ("hover",)),
    "height_lost_sink": Entry(
        draw_sink, "the fastest descent from which an engine's loss is landed", "height_lost", ("sink",)
    ),
}
