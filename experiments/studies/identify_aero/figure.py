"""The robot's aerodynamic coefficients identified from a flight's log."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.entry import Entry

MODELS = (("file", "of the file", style.VERMILION), ("identified", "identified", style.BLUE))


def draw(study: xr.Dataset) -> Figure:
    """Draw the descent, drag areas at 90° before and after, and errors in the validation flight.

    Without true areas, differences from those of the file.
    """
    reference = "true" if "wrench_true" in study else "file"
    error = "error" if reference == "true" else "change"
    figure = style.figure(4.6)
    grid = figure.subplots(2, 2)
    _descent(grid[0, 0], study)
    _areas(grid[0, 1], study, reference)
    for axes, rows, label in (
        (grid[1, 0], slice(0, 3), f"{error} of the force [N]"),
        (grid[1, 1], slice(3, 6), f"{error} of the moment [N m]"),
    ):
        for model, text, colour in MODELS:
            wrong = (study[f"wrench_{model}"] - study[f"wrench_{reference}"]).isel(six=rows)
            axes.plot(study["time"], np.sqrt((wrong**2).sum("six")), color=colour, label=f"areas {text}")
        axes.set_ylabel(label)
        axes.set_xlabel(f"time [s], {str(study.attrs['validation']).replace('_', ' ')}")
        axes.set_ylim(bottom=0.0)
        axes.legend()
    style.letters(grid.ravel())
    return figure


def _descent(axes: Axes, study: xr.Dataset) -> None:
    axes.plot(np.arange(1, study.sizes["step"] + 1), study["loss"], color=style.BLACK)
    axes.set(yscale="log", xlabel="step", ylabel="misfit per velocity")
    if "loss_true" in study.attrs:
        axes.axhline(float(study.attrs["loss_true"]), color=style.GREY, linestyle="--", label="with the true areas")
        axes.legend()


def _areas(axes: Axes, study: xr.Dataset, reference: str) -> None:
    """Draw drag areas at an angle of attack of 90°, `C_D A = w₀ + w₂ + w₃`, relative to those of the reference."""
    drag = {
        name: study[f"areas_{name}"].isel(coefficient=[0, 2, 3]).sum("coefficient")
        for name in ("file", "identified", reference)
    }
    places = np.arange(study.sizes["family"])
    for model, text, colour in MODELS:
        axes.plot(places, drag[model] / drag[reference], "o", color=colour, markersize=4, label=f"areas {text}")
    axes.axhline(1.0, color=style.GREY, linestyle="--")
    labels = [str(family).split()[0].removeprefix("l_").replace("_", " ") for family in study["family"].to_numpy()]
    axes.set_xticks(places, labels, rotation=35, ha="right")
    axes.set_ylabel(f"drag area at 90° over {'true' if reference == 'true' else 'that of the file'}")
    axes.legend()


FIGURES = {
    "identify": Entry(draw, "aerodynamic coefficients identified from one flight's log", "identify_aero", ("aero",)),
}
