"""Optimal flights beside the paper's: with the same start and end, side wind and controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jax_aero.figures import panels, runs, style
from jax_aero.figures.entry import Entry

COLOURS = {"min_time": style.VERMILION, "min_fuel": style.BLUE}
PAPER = style.GREY
LABELS = (
    "way flown x [m]",
    "speed [m/s]",
    "height z [m]",
    "pitch reference [deg]",
    "CoM error [m]",
    "fuel burnt [l]",
)
DASHES = {"minimum fuel": "--"}
OFFSETS = {"paper's mission": (-70, -2), "minimum time": (6, -12), "minimum fuel": (6, -2)}


def draw(*studies: xr.Dataset) -> Figure:
    """Draw distance, height, speed, pitch, error and fuel of all flights, and the thrusts of the optimal ones."""
    rows = 3 + math.ceil(len(studies) / 2)
    figure = style.figure(2.0 * rows)
    grid = figure.subplots(rows, 2)
    panels_of_thrusts = grid[3:].ravel()
    flights = [(studies[0], "paper", PAPER, "paper's mission")]
    for study in studies:
        colour = COLOURS.get(study.attrs["name"], style.BLACK)
        flights.append((study, "flown", colour, runs.escape_text(study.attrs["title"]).lower()))
    for study, of, colour, label in flights:
        look = {"color": colour, "label": label, "linestyle": DASHES.get(label, "-")}
        curves = _curves(study, of)
        for axes, (x, y) in zip(grid.flat, curves, strict=False):
            axes.plot(x, y, **look)
        _, fuel = curves[-1]
        if not np.isnan(arrival := float(study.attrs[f"arrival_{of}"])):
            _arrival(grid[2, 1], arrival, float(fuel[-1]), colour, label)
    for axes, label in zip(grid.flat, LABELS, strict=False):
        axes.set_ylabel(label)
        axes.set_xlim(0.0, 40.0)
        axes.set_xlabel("time since the motion began [s]")
    grid[1, 0].set_xlabel("way flown x [m]")
    grid[1, 0].set_xlim(-2.0, 80.0)
    grid[0, 0].legend(loc="lower right")
    grid[2, 1].set_ylim(bottom=0.0)
    last = max(float(study["time_flown"][-1]) for study in studies)
    for axes, study in zip(panels_of_thrusts, studies, strict=False):
        _thrusts(axes, study)
        axes.set_xlim(-1.0, last)
        axes.set_xlabel("time since the motion began [s]")
        axes.set_ylabel(f"thrust, {str(study.attrs['title']).lower()} [N]")
    planned = Line2D([], [], linestyle=":", color=style.BLACK, label="planned")
    style.legend_above(grid[3, 0], 5, [*grid[3, 0].get_legend_handles_labels()[0], planned])
    for axes in panels_of_thrusts[len(studies) :]:
        axes.remove()
    style.letters(figure.axes)
    return figure


def _curves(study: xr.Dataset, of: str) -> Sequence[tuple[xr.DataArray, xr.DataArray]]:
    """Return x and y of one flight from the beginning of the motion, in the order of `LABELS`."""
    data = study.sel({f"time_{of}": slice(0.0, None)})
    time = data[f"time_{of}"]
    way, height = (data[f"com_position_{of}"].sel(xyz=axis) for axis in "xz")
    speed = (data[f"com_velocity_{of}"] ** 2).sum("xyz") ** 0.5
    pitch = data[f"base_rpy_{of}"].sel(rpy="pitch") * (180.0 / np.pi)
    fuel = data[f"fuel_{of}"]
    fuel = fuel[~(time.values > study.attrs[f"arrival_{of}"])]
    return (
        (time, way),
        (time, speed),
        (way, height),
        (time, pitch),
        (time, data[f"com_error_{of}"]),
        (fuel[time.name], fuel),
    )


def _arrival(axes: Axes, time: float, fuel: float, colour: str, label: str) -> None:
    """Mark the fuel burnt until the arrival."""
    axes.plot(time, fuel, "o", color=colour, markersize=4)
    axes.annotate(
        f"{fuel:.3f} l in {time:.1f} s",
        (time, fuel),
        xytext=OFFSETS.get(label, (6, -12)),
        textcoords="offset points",
        color=colour,
        fontsize=7,
    )


def _thrusts(axes: Axes, study: xr.Dataset) -> None:
    flown, plan = study["thrust_flown"], study["thrust_plan"]
    for jet, colour in zip(flown["jet"].values.tolist(), cycle(style.JET_COLOURS), strict=False):
        axes.plot(flown["time_flown"], flown.sel(jet=jet), color=colour, label=panels.readable_name(jet))
        axes.plot(plan["time_plan"], plan.sel(jet=jet), ":", color=colour)


FIGURES = {
    "trajectory": Entry(
        draw,
        "planned trajectories, flown beside the paper's mission",
        "trajectory",
        ("min_time", "min_fuel"),
    ),
}
