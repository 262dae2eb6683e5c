"""What matters in a hover in wind, on the robots; what designs are worth in still air and in wind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import NullFormatter

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

COLOURS = "viridis_r"


def matters(study: xr.Dataset) -> Figure:
    """Draw both robots from ahead; links, joints and jets have the colour of what a change of them does to the cost."""
    figure = style.figure(4.2)
    panels = figure.subplots(1, 2, sharey=True)
    scale = ScalarMappable(LogNorm(0.1, 50.0), COLOURS)
    for axes, robot in zip(panels, np.unique(study["robot"].values), strict=True):
        mine = study.isel(shape=np.flatnonzero(study["robot"].values == robot))
        ends, kinds = mine["ends"].values, mine["kind"].values
        for shape in np.lexsort([ends[:, :, 0].mean(axis=1), kinds != "com"]):
            start, end = ends[shape, :, 1:]
            colour, radius = scale.to_rgba(mine["effect"].values[shape]), 0.5 * mine["width"].values[shape]
            if kinds[shape] == "joint":
                axes.plot(*start, "o", color=colour, markeredgecolor=style.BLACK, markersize=5, markeredgewidth=0.6)
            elif kinds[shape] == "axis":
                arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 3.0, "mutation_scale": 14}
                axes.annotate("", end, start, arrowprops=arrow, zorder=5)
            elif (length := float(np.hypot(*(end - start)))) < radius:
                axes.add_patch(Circle(0.5 * (start + end), radius, facecolor=colour, edgecolor=style.BLACK, lw=0.5))
            else:
                side = radius * np.array([start[1] - end[1], end[0] - start[0]]) / length
                corners = [start + side, end + side, end - side, start - side]
                axes.add_patch(Polygon(corners, facecolor=colour, edgecolor=style.BLACK, linewidth=0.5))
        axes.set(aspect="equal", title=robot, xlim=(-0.5, 0.5), xlabel="left [m]")
    panels[0].set(ylabel="height [m]", ylim=(-0.7, 0.7))
    label = "cost of a hover in 10 m/s: change [%]\nlinks, joints: by 1 cm; jets: by 1°"
    figure.colorbar(scale, ax=panels, label=label, shrink=0.8)
    style.letters(panels)
    return figure


def fronts(study: xr.Dataset) -> Figure:
    """Draw tracking and thrust of all designs in still air and in wind, and the chosen ones in harder flights."""
    figure = style.figure(5.0)
    panels = figure.subplot_mosaic([["still", "fast"], ["lean", "lean"]], height_ratios=(1.0, 1.1))
    front = {"still": style.ORANGE, "wind": style.BLUE}
    for flight, title in (("still", "climb in still air"), ("fast", "fast leg, turbulence of 15 m/s")):
        axes, (tracking, thrust) = panels[flight], study["first"].sel(loss=flight).values.T
        lost = study["first_lost"].sel(loss=flight).values
        axes.plot(tracking[~lost], thrust[~lost], ".", color=style.LIGHT, markersize=2, label="designs")
        points = tracking[lost], thrust[lost]
        axes.plot(*points, "x", color=style.VERMILION, markersize=3, label="lost after an arm engine")
        for of, colour in front.items():
            best = study["front"].sel(of=of).values
            axes.plot(tracking[best], thrust[best], "o", color=colour, markersize=4, label=f"front: {of}")
        axes.plot(tracking[0], thrust[0], "*", color=style.BLACK, markersize=9, label="iRonCub-Mk3")
        axes.set(xscale="log", xlim=(0.2, 8.0), xlabel="cost of tracking [1]", title=title)
        _ticks(axes, (0.2, 0.5, 1, 2, 4))
    panels["still"].set(ylabel="mean thrust [N]")
    panels["still"].legend(fontsize="x-small", loc="upper left")
    flights, names = study["flight"].values, {"Mk3": "iRonCub-Mk3", "three": "three numbers"}
    colours = dict(zip(study["robot"].values, (style.BLACK, style.ORANGE, style.BLUE, style.GREEN), strict=True))
    losses = [flight for flight in flights if "arm" in flight or "chest" in flight]
    place = np.arange(len(losses))
    for at, (robot, colour) in enumerate(colours.items()):
        lean = study["again"].sel(robot=robot, flight=losses, figure="lean")
        low, middle, high = lean.quantile([0.1, 0.5, 0.9], "repeat").values
        bars, label = [middle - low, high - middle], names.get(robot, f"best: {robot}")
        panels["lean"].errorbar(
            middle, place + 0.18 * (at - 1.5), xerr=bars, fmt="o", color=colour, markersize=3, label=label
        )
    panels["lean"].set_yticks(place, losses)
    panels["lean"].set(xlabel="greatest lean after the loss [deg], median, 10 to 90 %", xscale="log")
    _ticks(panels["lean"], (2, 3, 5, 10, 20, 40))
    panels["lean"].legend()
    style.letters(list(panels.values()))
    return figure


def _ticks(axes: Axes, values: Sequence[float]) -> None:
    """Mark a logarithmic axis by plain numbers."""
    axes.set_xticks(values, [f"{value:g}" for value in values])
    axes.xaxis.set_minor_formatter(NullFormatter())


FIGURES = {
    "design_matters": Entry(matters, "what matters in a hover in wind, on the robot", "design", ("sensitivities",)),
    "design": Entry(fronts, "designs of iRonCub-Mk3 in still air and in wind", "design", ("confirmed",)),
}
