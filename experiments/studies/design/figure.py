"""What matters in a hover in wind, on the robots; what designs are worth in still air and in wind."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from paper_figs import style
from paper_figs.entry import Entry

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
    """Draw the scores of all designs, and tracking and lean of the chosen ones in the flights that judge them."""
    figure = style.figure(3.0)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.3))
    still, wind = study["first"].values.T
    known = np.isfinite(still) & np.isfinite(wind)
    left.plot(still[known], wind[known], ".", color=style.LIGHT, markersize=2, label="designs, one draw")
    for group, colour in (("still", style.ORANGE), ("wind", style.BLUE), ("three", style.GREEN)):
        few = study["few"].values[study["group"].values == group]
        left.plot(*few.T, ".", color=colour, markersize=4, label=f"best: {group}, again")
    left.plot(1.0, 1.0, "*", color=style.BLACK, markersize=8, label="iRonCub-Mk3")
    left.set(
        xscale="log", yscale="log", xlabel="score in still air", ylabel="score in wind", xlim=(0.6, 3), ylim=(0.3, 8)
    )
    left.legend()
    flights = study["flight"].values
    colours = dict(zip(study["robot"].values, (style.BLACK, style.ORANGE, style.BLUE, style.GREEN), strict=True))
    losses = [flight for flight in flights if "arm" in flight or "chest" in flight]
    for at, (robot, colour) in enumerate(colours.items()):
        lean = study["again"].sel(robot=robot, flight=losses, figure="lean")
        low, middle, high = lean.quantile([0.1, 0.5, 0.9], "repeat").values
        place = np.arange(len(losses)) + 0.18 * (at - 1.5)
        right.errorbar(
            middle, place, xerr=[middle - low, high - middle], fmt="o", color=colour, markersize=3, label=robot
        )
    right.set_yticks(np.arange(len(losses)), losses)
    right.set(xlabel="greatest lean after the loss [deg], median, 10 to 90 %", xscale="log")
    right.legend()
    style.letters((left, right))
    return figure


FIGURES = {
    "design_matters": Entry(matters, "what matters in a hover in wind, on the robot", "design", ("sensitivities",)),
    "design": Entry(fronts, "designs of iRonCub-Mk3 in still air and in wind", "design", ("confirmed",)),
}
