"""The panel model and the wind tunnel: drag and lift of two postures not used in its fit, and errors of all."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from paper_figs import style

MODELS = {"surrogate": (style.BLUE, "panel model"), "corrected": (style.VERMILION, "axisymmetric, corrected")}
POSTURES = {"flight50": ("o", "-"), "flight60": ("s", "--")}


def draw(study: xr.Dataset) -> Figure:
    """Draw curves above, errors by posture below."""
    figure = style.figure(5.2)
    grid = figure.subplot_mosaic("ab;cc")
    for mark, component in (("a", "drag"), ("b", "lift")):
        _curves(grid[mark], study, component)
    _errors(grid["c"], study)
    tunnel = [
        Line2D(
            [],
            [],
            color=style.BLACK,
            marker=marker,
            ls=dash,
            fillstyle="none",
            markersize=4,
            label=f"tunnel, {posture}",
        )
        for posture, (marker, dash) in POSTURES.items()
    ]
    models = [Line2D([], [], color=colour, label=text) for colour, text in MODELS.values()]
    style.legend_above(grid["a"], columns=2, handles=tunnel)
    style.legend_above(grid["b"], columns=2, handles=models)
    for mark, axes in grid.items():
        style.letter(axes, str(mark))
    return figure


def _curves(axes: Axes, study: xr.Dataset, component: str) -> None:
    for posture, (marker, dash) in POSTURES.items():
        chosen = study.isel(record=np.flatnonzero(study["posture"].values == posture)).sel(component=component)
        axes.plot(
            chosen["pitch_deg"],
            chosen["measured"],
            marker,
            color=style.BLACK,
            markersize=4,
            fillstyle="none",
        )
        for model, (colour, _) in MODELS.items():
            axes.plot(chosen["pitch_deg"], chosen["predicted"].sel(model=model), dash, color=colour)
    axes.set_xlabel(r"angle of attack $\alpha$ [deg]")
    axes.set_ylabel(rf"{component} area [m$^2$]")


def _errors(axes: Axes, study: xr.Dataset) -> None:
    held_out = str(study.attrs["held_out"]).split()
    postures = list(dict.fromkeys(study["posture"].values.tolist()))
    postures.sort(key=lambda name: name in held_out)
    width = 0.38
    for shift, (model, (colour, text)) in zip((-0.5, 0.5), MODELS.items(), strict=True):
        off = study["predicted"].sel(model=model) - study["measured"]
        squares = (off**2).sum("component")
        heights = [float(np.sqrt(squares.values[study["posture"].values == name].mean())) for name in postures]
        axes.bar(np.arange(len(postures)) + shift * width, heights, width, color=colour, label=text)
    labels = [f"{name}\n(held out)" if name in held_out else name for name in postures]
    axes.set_xticks(range(len(postures)), labels)
    axes.set_ylabel(r"rms vector error [m$^2$]")
    style.legend_above(axes, columns=2)
