"""Panels used by several figures; each function draws one panel into the given axes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from typing import Any

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D

from jax_aero.base import flights
from jax_aero.base.quantities import shown_array
from jax_aero.figures import style

SIDES = {"l": "left", "r": "right"}
SILENT = ("jet", "turbine")  # words left out in legends of jets


Panel = Callable[[Axes, xr.Dataset], None]


def line(axes: Axes, values: xr.DataArray, *look: str, **options: Any) -> None:
    """Draw a quantity over time, with its label and unit beside the axis."""
    seen = shown_array(values)
    axes.plot(values["time"], seen.values, *look, **options)
    axes.set_ylabel(seen.text)


def components(axes: Axes, vectors: xr.DataArray, *, dash: str = "-", labelled: bool = True) -> None:
    """Draw the components of vectors over time, by colour."""
    for axis, colour in style.AXES_COLOURS.items():
        line(axes, vectors.sel(xyz=axis), dash, color=colour, label=axis if labelled else "_nolegend_")


def joint_errors(axes: Axes, run: xr.Dataset) -> None:
    """Draw the sum of absolute joint errors of each group."""
    errors = flights.joint_error_sums(flights.until_loss(run))
    for group, colour in zip(errors["group"].values.tolist(), cycle(style.GROUP_COLOURS), strict=False):
        dash = "--" if "right" in readable_name(group) else "-"
        line(axes, errors.sel(group=group), dash, color=colour, label=readable_name(group))
    axes.set_ylabel(axes.get_ylabel().replace(", ", ",\n"))
    axes.set_ylim(bottom=0.0)


def aero_force(axes: Axes, run: xr.Dataset, *, control: bool) -> None:
    """Draw the sum of aerodynamic forces over the links; with `control`, also the one that the controller assumes."""
    flown = flights.until_loss(run)
    if control:
        components(axes, flights.aero_force(flown, of_controller=True), dash="--", labelled=False)
    components(axes, flights.aero_force(flown))


def aero_force_difference(axes: Axes, run: xr.Dataset) -> None:
    """Draw the simulator's total aerodynamic force minus the controller's."""
    components(axes, flights.aero_force_difference(flights.until_loss(run)))


def aero_force_key() -> list[Line2D]:
    """Return legend entries, in columns of two: axes by colour, models by dash."""
    x, y, z = (Line2D([], [], color=colour, label=axis) for axis, colour in style.AXES_COLOURS.items())
    simulator = Line2D([], [], color=style.GREY, label="simulator")
    controller = Line2D([], [], color=style.GREY, label="controller", linestyle="--")
    return [x, simulator, y, controller, z]


def thrusts(axes: Axes, run: xr.Dataset) -> None:
    """Draw the thrust of each jet."""
    thrust = flights.until_loss(run)["thrust"]
    looks = zip(cycle(style.JET_COLOURS), cycle(style.JET_DASHES), strict=False)
    for name, (colour, dash) in zip(thrust["jet"].values.tolist(), looks, strict=False):
        line(axes, thrust.sel(jet=name), dash, color=colour, label=readable_name(name))


def row(figure: FigureBase, run: xr.Dataset, letters: str, *, control: bool = False, last: Panel = thrusts) -> None:
    """Draw joint errors, total force and a last panel side by side; the panels have the given letters."""
    style.title(figure, run.attrs["title"], size=8.5)
    errors, force, third = panels = figure.subplots(1, 3)
    joint_errors(errors, run)
    aero_force(force, run, control=control)
    last(third, run)
    style.letters(panels[-len(letters) :], letters)
    for axes in panels:
        axes.set_xlabel("time [s]")
        mark_loss(axes, run, labelled=axes is errors)
    style.legend_above(errors, columns=3)
    style.legend_above(force, columns=3, handles=aero_force_key() if control else None)
    style.legend_above(third, columns=2 if last is thrusts else 3)


def mark_loss(axes: Axes, run: xr.Dataset, *, labelled: bool = True) -> None:
    """Draw when a flight was lost, if it was, and how."""
    if (time := flights.lost_time(run)) is not None:
        style.mark_fall(axes, time, flights.ending_at(run) if labelled else None)


def readable_name(name: str) -> str:
    """Return the name of a jet or of a group of joints in words: `l_arm_jet` is the "left arm"."""
    words = [SIDES.get(word, word) for word in name.split("_") if word not in SILENT] or name.split("_")
    return " ".join(sorted(words, key=lambda word: word not in SIDES.values()))
