"""Fuel burnt, and clearance of jets from the body, along flights."""

from __future__ import annotations

import itertools
from typing import Any

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

COLOURS = (style.BLUE, style.SKY, style.GREEN, style.PURPLE, style.VERMILION, style.ORANGE, style.BLACK, style.GREY)


def draw(study: xr.Dataset) -> Figure:
    """Draw fuel, and the least clearance of the four jets with corrected arms and as published."""
    figure = style.figure(5.4)
    grid = figure.subplot_mosaic("aa;bc", sharex=True, height_ratios=(1.0, 1.1))
    left, corrected, published = (grid[letter] for letter in "abc")
    published.sharey(corrected)
    flights = study["flight"].values.tolist()
    colours = dict(zip(dict.fromkeys(map(_without_arms, flights)), itertools.cycle(COLOURS), strict=False))
    for flight in flights:
        one = study.sel(flight=flight)
        is_published = flight.endswith("_published")
        look: dict[str, Any] = {"color": colours[_without_arms(flight)], "linestyle": "--" if is_published else "-"}
        right = published if is_published else corrected
        fuel = one["fuel"].dropna("time")
        left.plot(fuel["time"], fuel, label=flight.replace("_", " "), **look)
        nearest = 1e3 * one["clearance"].min("jet").dropna("time")
        right.plot(nearest["time"], nearest, linewidth=0.9, **look)
        if one["lost_time"].notnull():
            for axes, line in ((left, fuel), (right, nearest)):
                axes.plot(line["time"][-1], line[-1], "X", color=style.VERMILION, markersize=6)
    left.set_ylabel("fuel burnt [l]")
    left.set_ylim(bottom=0.0)
    left.tick_params(labelbottom=True)
    left.plot([], [], "X", color=style.VERMILION, label="lost")
    corrected.set_ylabel("exhaust axis to nearest link [mm]")
    corrected.set_title("corrected arms")
    published.set_title("published arms")
    for axes in (corrected, published):
        axes.axhline(0.0, color=style.GREY, linewidth=0.9)
        axes.set_xlabel("time [s]")
    style.letters((left, corrected, published))
    left.legend(loc="upper left", ncols=2)
    return figure


def _without_arms(flight: str) -> str:
    """Return the name that a flight shares with that of other lever arms."""
    return flight.removesuffix("_published")


FIGURES = {
    "along": Entry(draw, "fuel burnt and clearance of the jets along flights", "along", ("flights",)),
}
