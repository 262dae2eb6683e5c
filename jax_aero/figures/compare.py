"""Own flights beside each other: rotation error, position error, wind and every thrust, one colour per flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jax_aero.base import flights
from jax_aero.figures import panels, style
from jax_aero.figures.runs import NotDrawn

LOOKS = (
    (style.VERMILION, "-"),
    (style.BLUE, "--"),
    (style.GREEN, "-."),
    (style.ORANGE, ":"),
    (style.PURPLE, "-"),
    (style.SKY, "--"),
    (style.BLACK, "-."),
    (style.GREY, ":"),
)
WIDTH = 4.4
"""Narrow, so that the text is legible on a telephone [inches]."""
LONGEST = 48
"""Letters of a flight's name in the legend."""


def draw(*runs: xr.Dataset) -> Figure:
    """Draw up to eight flights; each jet that one of the robots has is a panel."""
    if len(runs) > len(LOOKS):
        raise NotDrawn(f"{len(runs)} flights; expected at most {len(LOOKS)}")
    jets = list(dict.fromkeys(jet for run in runs for jet in run["jet"].values.tolist()))
    heights = [1.25] * len(ERRORS) + [1.1] * -(-len(jets) // 2)
    figure = style.figure(0.4 + 0.14 * len(runs) + sum(heights), WIDTH)
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    for row, of in enumerate(ERRORS):
        axes = figure.add_subplot(grid[row, :], sharex=figure.axes[0] if row else None)
        _lines(axes, runs, of)
        axes.set_ylim(bottom=0.0)
    thrusts = None
    for place, jet in enumerate(jets):
        row, column = divmod(place, 2)
        axes = figure.add_subplot(grid[len(ERRORS) + row, column], sharex=figure.axes[0], sharey=thrusts)
        thrusts = axes
        _lines(axes, runs, partial(_thrust, jet))
        axes.set_title(panels.readable_name(jet))
        if column:
            axes.set_ylabel("")
    for axes in figure.axes:
        axes.label_outer()
    figure.axes[len(ERRORS) - 1].tick_params(labelbottom=True)
    for axes in [figure.axes[len(ERRORS) - 1], *figure.axes[-2:]]:
        axes.set_xlabel("time [s]")
    first = figure.axes[0]
    first.set_xlim(0.0, max(float(run["time"][-1]) for run in runs))
    figure.legend(*first.get_legend_handles_labels(), loc="outside upper left", fontsize=7)
    return figure


def _lines(axes: Axes, runs: Sequence[xr.Dataset], of: Callable[[xr.Dataset], xr.DataArray | None]) -> None:
    """Draw a quantity of every flight that has it; one that is lost ends with a cross, that descends with a dot."""
    for run, (colour, dash) in zip(runs, LOOKS, strict=False):
        values = of(flights.until_loss(run))
        if values is None:
            continue
        is_whole, name = run.attrs["outcome"] == "completed", run.attrs["name"]
        name = name if len(name) <= LONGEST else f"{name[:12]}…{name[13 - LONGEST :]}"
        label = name + ("" if is_whole else f", {flights.ending_at(run)}")
        panels.line(axes, values, dash, color=colour, label=label)
        if not is_whole:
            mark = "o" if flights.lost_time(run) is None else "X"
            panels.line(axes, values[-1:], mark, color=colour, markersize=5, clip_on=False)


def _thrust(jet: str, run: xr.Dataset) -> xr.DataArray | None:
    return run["thrust"].sel(jet=jet) if jet in run["jet"] else None


ERRORS = (flights.rotation_error, flights.com_error, flights.wind_speed)
"""What the panels above the thrusts show."""
