"""Steady winds in which the robot can hover, and the remaining thrust: maps over direction and speed."""

from __future__ import annotations

import itertools

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Wedge
from numpy.typing import NDArray

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

Array = NDArray[np.float64]

TITLES = ("posture held", "joints free")
MEASURED = 24.0
"""Greatest speed in the wind tunnel [m/s], beyond which the aerodynamic model is extrapolated."""


def draw(*studies: xr.Dataset) -> Figure:
    """Draw two maps for each of two studies: the greatest margin of all thrusts, and the least total thrust."""
    figure = style.figure(3.9)
    grid = figure.subplots(1, 4)
    margins = [100 * study["margin"].sel(objective="max_margin") for study in studies]
    thrusts = [study["total_thrust"].sel(objective="min_thrust") / study["weight"] for study in studies]
    pairs: list[tuple[str, str, list[xr.DataArray]]] = [
        ("greatest thrust margin [% of the greatest thrust]", "viridis", margins),
        ("least total thrust [weights]", "cividis_r", thrusts),
    ]
    for kind, (label, colours, maps) in enumerate(pairs):
        values = np.concatenate([m.values.ravel() for m in maps])
        values = values[np.isfinite(values)]
        norm = Normalize(values.min(), values.max()) if values.size else Normalize(0.0, 1.0)
        panels = grid[2 * kind : 2 * kind + 2]
        for axes, data, title in zip(panels, maps, TITLES, strict=True):
            mesh = _half_disc(axes, data, norm, colours)
            axes.set_title(title, loc="center")
        bar = figure.colorbar(mesh, ax=list(panels), orientation="horizontal", shrink=0.85, pad=0.04, aspect=30)
        bar.set_label(label)
    for axes, mark in zip(grid, "abcd", strict=True):
        axes.text(0.0, 1.0, mark, transform=axes.transAxes, fontweight="bold", fontsize=10)
    figure.supxlabel(
        "wind by where it comes from (top: ahead, left: left, bottom: behind), speed outwards [m/s]; grey: no trim;\n"
        f"dashed: {MEASURED:.0f} m/s, the fastest air of the wind tunnel, beyond which the model is extrapolated",
        fontsize=7,
    )
    return figure


def _half_disc(axes: Axes, data: xr.DataArray, norm: Normalize, colours: str) -> QuadMesh:
    """Draw the winds from one side, with head wind at the top."""
    edges = _edges(np.radians(data["direction"].values), np.pi)
    speeds = _edges(data["speed"].values)
    # Fine sectors, so that their arcs are round.
    fine = np.concatenate([np.linspace(a, b, 9)[:-1] for a, b in itertools.pairwise(edges)] + [edges[-1:]])
    values = np.repeat(data.transpose("speed", "direction").values, 8, axis=1)
    x, y = -speeds[:, None] * np.sin(fine), speeds[:, None] * np.cos(fine)
    mesh = axes.pcolormesh(x, y, values, norm=norm, cmap=colours)
    rim = float(speeds[-1])
    axes.add_patch(Wedge((0.0, 0.0), rim, 90.0, 270.0, facecolor="#D0D0D0", edgecolor=style.BLACK, zorder=0.5))
    axes.add_patch(Arc((0.0, 0.0), 2 * MEASURED, 2 * MEASURED, theta1=90, theta2=270, linestyle="--", linewidth=0.8))
    axes.set_aspect("equal")
    axes.set_xlim(-1.03 * rim, 0.0)
    axes.set_ylim(-1.03 * rim, 1.03 * rim)
    axes.grid(visible=False)
    axes.xaxis.set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.spines["right"].set_visible(True)
    axes.yaxis.tick_right()
    axes.yaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    return mesh


def _edges(centres: Array, highest: float | None = None) -> Array:
    """Return the edges of cells around samples, with the first at zero."""
    middle = 0.5 * (centres[1:] + centres[:-1])
    last = centres[-1] - centres[-2] if centres.size > 1 else max(centres[-1], 1.0)
    top = centres[-1] + 0.5 * last if highest is None else highest
    return np.concatenate([[0.0], middle, [top]])


FIGURES = {
    "trim": Entry(
        draw, "winds that can be trimmed, and the thrust that is left", "trim", ("hover_posture", "free_joints")
    ),
}
