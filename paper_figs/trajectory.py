"""Optimal flights beside the paper's: the same two places, the same side wind, the same controller."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from paper_figs import panels, style

COLOURS = {"min_time": style.VERMILION, "min_fuel": style.BLUE}
PAPER = style.GREY
DASHES = {"minimum fuel": "--"}
OFFSETS = {"paper's mission": (-70, -2), "minimum time": (6, -12), "minimum fuel": (6, -2)}


def draw(*studies: xr.Dataset) -> Figure:
    """Draw way, height, speed, pitch, error and fuel of all flights, and the thrusts of the optimal ones."""
    figure, grid = plt.subplots(4, 2, figsize=(style.FULL_WIDTH, 8.0), layout="constrained")
    for axes, draw_panel, label in (
        (grid[0, 0], _distance, "way flown x [m]"),
        (grid[0, 1], _speed, "speed [m/s]"),
        (grid[1, 0], _height, "height z [m]"),
        (grid[1, 1], _pitch, "pitch reference [deg]"),
        (grid[2, 0], _error, "CoM error [m]"),
        (grid[2, 1], _fuel, "fuel burnt [l]"),
    ):
        draw_panel(axes, studies[0], "paper", PAPER, "paper's mission")
        for study in studies:
            colour = COLOURS.get(study.attrs["name"], style.BLACK)
            draw_panel(axes, study, "flown", colour, str(study.attrs["title"]).lower())
        axes.set_ylabel(label)
        axes.set_xlim(0.0, 40.0)
        axes.set_xlabel("time since the motion began [s]")
    grid[1, 0].set_xlabel("way flown x [m]")
    grid[1, 0].set_xlim(-2.0, 80.0)
    grid[0, 0].legend(loc="lower right")
    grid[2, 1].set_ylim(bottom=0.0)
    last = max(float(study["time_flown"][-1]) for study in studies)
    for axes, study in zip(grid[3], studies, strict=False):
        _thrusts(axes, study)
        axes.set_xlim(-1.0, last)
        axes.set_xlabel("time since the motion began [s]")
        axes.set_ylabel(f"thrust, {str(study.attrs['title']).lower()} [N]")
    planned = Line2D([], [], linestyle=":", color=style.BLACK, label="planned")
    style.legend_above(grid[3, 0], 5, [*grid[3, 0].get_legend_handles_labels()[0], planned])
    style.letters(grid.ravel())
    return figure


def _moving(study: xr.Dataset, of: str) -> tuple[xr.Dataset, str]:
    time = f"time_{of}"
    return study.sel({time: slice(0.0, None)}), time


def _distance(axes: Axes, study: xr.Dataset, of: str, colour: str, label: str) -> None:
    data, time = _moving(study, of)
    axes.plot(
        data[time], data[f"com_position_{of}"].sel(xyz="x"), color=colour, label=label, linestyle=DASHES.get(label, "-")
    )


def _height(axes: Axes, study: xr.Dataset, of: str, colour: str, label: str) -> None:
    data, _ = _moving(study, of)
    position = data[f"com_position_{of}"]
    axes.plot(position.sel(xyz="x"), position.sel(xyz="z"), color=colour, label=label, linestyle=DASHES.get(label, "-"))


def _speed(axes: Axes, study: xr.Dataset, of: str, colour: str, label: str) -> None:
    data, time = _moving(study, of)
    speed = np.sqrt((data[f"com_velocity_{of}"] ** 2).sum("xyz"))
    axes.plot(data[time], speed, color=colour, label=label, linestyle=DASHES.get(label, "-"))


def _pitch(axes: Axes, study: xr.Dataset, of: str, colour: str, label: str) -> None:
    data, time = _moving(study, of)
    axes.plot(
        data[time],
        np.degrees(data[f"base_rpy_{of}"].sel(rpy="pitch")),
        color=colour,
        label=label,
        linestyle=DASHES.get(label, "-"),
    )


def _error(axes: Axes, study: xr.Dataset, of: str, colour: str, label: str) -> None:
    data, time = _moving(study, of)
    axes.plot(data[time], data[f"com_error_{of}"], color=colour, label=label, linestyle=DASHES.get(label, "-"))


def _fuel(axes: Axes, study: xr.Dataset, of: str, colour: str, label: str) -> None:
    data, time = _moving(study, of)
    arrival = float(study.attrs[f"arrival_{of}"])
    fuel = data[f"fuel_{of}"].sel({time: slice(0.0, arrival)})
    axes.plot(fuel[time], fuel, color=colour, label=label, linestyle=DASHES.get(label, "-"))
    axes.plot(arrival, fuel[-1], "o", color=colour, markersize=4)
    axes.annotate(
        f"{float(fuel[-1]):.3f} l in {arrival:.1f} s",
        (arrival, float(fuel[-1])),
        xytext=OFFSETS.get(label, (6, -12)),
        textcoords="offset points",
        color=colour,
        fontsize=7,
    )


def _thrusts(axes: Axes, study: xr.Dataset) -> None:
    flown, plan = study["thrust_flown"], study["thrust_plan"]
    for jet, colour in zip(flown["jet"].values.tolist(), style.JET_COLOURS, strict=False):
        axes.plot(flown["time_flown"], flown.sel(jet=jet), color=colour, label=panels.readable(jet))
        axes.plot(plan["time_plan"], plan.sel(jet=jet), ":", color=colour)
