"""Shares of robots that land, by speed and height, with the ways of missions through them."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry
from jax_aero.figures.panels import readable_name

LEANS = ("leaning forwards", "upright", "leaning backwards")
COLOURS = (style.BLACK, style.BLUE, style.VERMILION, style.PURPLE)


def draw(study: xr.Dataset) -> Figure:
    """Draw a map for each engine and lean; a mission is drawn where its lean is nearest."""
    figure = style.figure(4.2)
    grid = figure.subplots(study["engine"].size, study["lean"].size, sharex=True, sharey=True)
    leans = study["lean"]
    nearest = abs(study["mission_lean"] - leans).fillna(360.0).argmin("lean")
    for row, engine in zip(grid, study["engine"].values, strict=True):
        row[0].set_ylabel(f"{readable_name(engine)}: height [m]")
        for place, axes in enumerate(row):
            share = study["share"].sel(engine=engine).isel(lean=place).transpose("height", "speed")
            levels = axes.contourf(share["speed"], share["height"], 100.0 * share, range(0, 101, 10), cmap="YlGn")
            for mission, colour in zip(study["mission"].values, COLOURS, strict=False):
                one = study.sel(mission=mission)
                here = nearest.sel(mission=mission) == place
                way = {"color": colour, "label": mission, "markersize": 1.5}
                axes.plot(one["mission_speed"].where(here), one["mission_height"].where(here), ".", **way)
    for top, bottom, title in zip(grid[0], grid[-1], LEANS, strict=True):
        top.set_title(title, loc="center")
        bottom.set_xlabel("speed [m/s]")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=len(COLOURS), fontsize=7)
    figure.colorbar(levels, ax=grid.ravel().tolist(), label="robots that land [%]")
    return figure


FIGURES = {
    "landing_map": Entry(draw, "where an engine's loss can be landed, and missions there", "landing_map", ("robot",))
}
