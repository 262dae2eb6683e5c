"""Shares of robots that land, by speed and height, with the ways of missions through them."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.entry import Entry
from paper_figs.panels import readable_name

LEANS = ("leaning forwards", "upright", "leaning backwards")
COLOURS = (style.BLACK, style.BLUE, style.VERMILION, style.PURPLE)


def draw(study: xr.Dataset) -> Figure:
    """Draw a map for each engine and lean; a mission is drawn where its lean is nearest."""
    figure = style.figure(4.2)
    grid = figure.subplots(study["engine"].size, study["lean"].size, sharex=True, sharey=True)
    leans = study["lean"]
    nearest = abs(study["mission_lean"] - leans).fillna(360.0).argmin("lean")
    for row, engine in zip(grid, study["engine"].values, strict=True):
        for place, (axes, title) in enumerate(zip(row, LEANS, strict=True)):
            share = study["share"].sel(engine=engine).isel(lean=place).transpose("height", "speed")
            levels = axes.contourf(share["speed"], share["height"], 100.0 * share, range(0, 101, 10), cmap="YlGn")
            for mission, colour in zip(study["mission"].values, COLOURS, strict=False):
                one = study.sel(mission=mission)
                here = nearest.sel(mission=mission) == place
                way = {"color": colour, "label": mission, "markersize": 1.5}
                axes.plot(one["mission_speed"].where(here), one["mission_height"].where(here), ".", **way)
            axes.set_title(f"{readable_name(engine)}, {title}", loc="center")
    for axes in grid[-1]:
        axes.set_xlabel("speed [m/s]")
    for axes in grid[:, 0]:
        axes.set_ylabel("height [m]")
    style.legend_above(grid[0, 0], len(COLOURS))
    figure.colorbar(levels, ax=grid.ravel().tolist(), label="robots that land [%]")
    return figure


FIGURES = {
    "landing_map": Entry(draw, "where an engine's loss can be landed, and missions there", "landing_map", ("robot",))
}
