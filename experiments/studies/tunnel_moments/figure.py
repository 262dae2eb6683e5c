"""Models' moments about the centre of mass and those of the wind tunnel, with intervals and both lever arms."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

NEWTON_METRES = 61.25
"""Moment per moment volume of 1 m³ at 10 m/s [N m]."""
DASHES = ("-", ":")
"""Line of a model with each of the lever arms."""
SHOWN = {
    "axisymmetric, corrected": style.BLUE,
    "spheres and cylinders": style.GREEN,
    "network, shipped": style.VERMILION,
}
ARMS = ("corrected arms", "published arms")
SIDES = {"below": "o", "above": "^"}
CAMPAIGNS = {"exp_2022_03_21": "March", "exp_2022_11_03": "November"}
SIGMAS = 2.0
"""Half the length of an error bar in standard deviations."""
EXPOSED = 20.5
"""Sideslip beyond which the support is exposed to the wind [deg]."""


def draw(study: xr.Dataset) -> Figure:
    """Draw pitch against the angle of attack, roll against sideslip, and rms errors with their intervals."""
    figure = style.figure(5.4)
    grid = figure.subplots(2, 2)
    _angles(grid[0, 0], study)
    _sideslip(grid[0, 1], study, "x", "roll")
    _sideslip(grid[1, 0], study, "z", "yaw")
    _errors(grid[1, 1], study)
    style.letters(grid.flat)
    for dash, arms in zip(DASHES, ARMS, strict=True):
        grid[0, 1].plot([], [], dash, color=style.GREY, label=f"model, {arms}")
    handles, labels = grid[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=6)
    return figure


def _angles(axes: Axes, study: xr.Dataset) -> None:
    """Draw the pitching moment of flight30 without sideslip."""
    rows = (study["posture"] == "flight30") & (study["robot_only"] == 1)
    points = study.isel(point=rows.values).sortby("pitch")
    _draw_measured(axes, points, points["pitch"], "y")
    _models(axes, points, points["pitch"].values, "y")
    axes.set_xlabel(r"angle of attack $\alpha$ [deg]")
    axes.set_ylabel("pitching moment at 10 m/s [N m]")
    axes.set_title("flight30, robot alone")


def _sideslip(axes: Axes, study: xr.Dataset, axis: str, name: str) -> None:
    """Draw the moment of the hovering posture against sideslip; beyond 20° the support is exposed to the wind."""
    rows = (study["posture"] == "hovering") & ~study["marks"].str.contains("doubtful|outlier")
    points = study.isel(point=rows.values).sortby("yaw")
    axes.axvspan(EXPOSED, 92.0, color=style.LIGHT, alpha=0.5, linewidth=0)
    axes.axvspan(-92.0, -EXPOSED, color=style.LIGHT, alpha=0.5, linewidth=0)
    for (campaign, label), fill in zip(CAMPAIGNS.items(), ("none", style.BLACK), strict=True):
        own = points.isel(point=(points["campaign"] == campaign).values)
        _draw_measured(axes, own, own["yaw"], axis, label=label, fill=fill)
    _models(axes, points, points["yaw"].values, axis)
    axes.set_xlim(-92.0, 92.0)
    axes.set_xlabel(r"sideslip $\beta$ [deg]")
    axes.set_ylabel(f"{name}ing moment at 10 m/s [N m]")
    axes.set_title("hovering; grey: the support in the wind")


def _draw_measured(
    axes: Axes, points: xr.Dataset, x: xr.DataArray, axis: str, *, label: str = "tunnel", fill: str = style.BLACK
) -> None:
    for side, marker in SIDES.items():
        y = points["measured"].sel(side=side, axis=axis).values * NEWTON_METRES
        bar = SIGMAS * points["uncertainty"].sel(axis=axis).values * NEWTON_METRES
        shown = {"fmt": marker, "markersize": 2.5, "color": style.BLACK, "markerfacecolor": fill, "linewidth": 0.4}
        axes.errorbar(x.values, y, bar, label=f"{label}, centre {side}", **shown)  # type: ignore[arg-type]  # Matplotlib's options


def _models(axes: Axes, points: xr.Dataset, x: np.ndarray, axis: str) -> None:
    for name, colour in SHOWN.items():
        for arms, dash in zip(points["arms"].values, DASHES, strict=True):
            y = points["predicted"].sel(model=name, arms=arms, axis=axis).values * NEWTON_METRES
            places, first = np.unique(np.round(x), return_inverse=True)
            mean = np.bincount(first, y) / np.bincount(first)
            label = name if dash == "-" else None
            axes.plot(places, mean, dash, color=colour, linewidth=1.0, label=label)


def _errors(axes: Axes, study: xr.Dataset) -> None:
    """Draw the rms error over the points of hovering postures with the robot alone."""
    names = [str(name) for name in study["model"].values]
    for row, name in enumerate(names):
        for a, (arms, dash) in enumerate(zip(study["arms"].values, DASHES, strict=True)):
            for s, (side, marker) in enumerate(SIDES.items()):
                if a and row == 0:
                    continue
                at = {"model": name, "arms": arms, "side": side, "group": "hovering"}
                low, high = study["interval"].sel(at).values
                y = row + 0.18 * (2 * a + s - 1.5)
                axes.plot([low, high], [y, y], dash, color=style.BLACK, linewidth=1.0)
                axes.plot(float(study["rms"].sel(at)), y, marker, color=style.BLACK, markersize=3)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlabel("rms error at 10 m/s, 95 % interval [N m]")
    axes.set_title(f"hovering; dotted: {ARMS[1]}")


FIGURES = {
    "tunnel_moments": Entry(draw, "models' moments beside the wind tunnel", "tunnel_moments", ("mk1",)),
}
