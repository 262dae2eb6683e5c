"""Panels used by several figures; each function draws one panel into the given axes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D

from paper_figs import style
from paper_figs.runs import Run, Series

SIDES = {"l": "left", "r": "right"}
SILENT = ("jet", "turbine")  # words left out in legends of jets


Panel = Callable[[Axes, Run], None]


def title(figure: FigureBase, run: Run) -> None:
    """Put the title of a run above its part of a figure."""
    style.title(figure, run.title, size=8.5)


def com_setpoint(axes: Axes, run: Run) -> None:
    """Draw the smoothed reference of the centre of mass."""
    components(axes, run.data["com_setpoint"], "CoM reference [m]")


def wind(axes: Axes, run: Run) -> None:
    """Draw the wind velocity."""
    components(axes, run.data["wind"], "wind [m/s]")


def joint_errors(axes: Axes, run: Run) -> None:
    """Draw the sum of absolute joint errors of each group."""
    errors = run.joint_error_sum_deg()
    for group, colour in zip(errors["group"].values.tolist(), cycle(style.GROUP_COLOURS), strict=False):
        dash = "--" if "right" in readable_name(group) else "-"
        axes.plot(errors["time"], errors.sel(group=group), dash, color=colour, label=readable_name(group))
    axes.set_ylabel("sum of joint errors |Δs| [deg]")
    axes.set_ylim(bottom=0.0)


def aero_force(axes: Axes, run: Run, *, control: bool) -> None:
    """Draw the sum of aerodynamic forces over the links; with `control`, also the one that the controller assumes."""
    label = "aerodynamic force [N]"
    components(axes, run.log_to_loss["aero_force_sim"].sum("link"), label)
    if control:
        components(axes, run.log_to_loss["aero_force_control"].sum("link"), label, dash="--", labelled=False)


def aero_force_difference(axes: Axes, run: Run) -> None:
    """Draw the simulator's total aerodynamic force minus the controller's."""
    flown = run.log_to_loss
    difference = flown["aero_force_sim"].sum("link") - flown["aero_force_control"].sum("link")
    components(axes, difference, "force difference [N]")


def aero_force_key() -> list[Line2D]:
    """Return legend entries, in columns of two: axes by colour, models by dash."""
    x, y, z = (Line2D([], [], color=colour, label=axis) for axis, colour in style.AXES_COLOURS.items())
    simulator = Line2D([], [], color=style.GREY, label="simulator")
    controller = Line2D([], [], color=style.GREY, label="controller", linestyle="--")
    return [x, simulator, y, controller, z]


def thrusts(axes: Axes, run: Run) -> None:
    """Draw the thrust of each jet."""
    thrust = run.log_to_loss["thrust"]
    looks = zip(cycle(style.JET_COLOURS), cycle(style.JET_DASHES), strict=False)
    for name, (colour, dash) in zip(thrust["jet"].values.tolist(), looks, strict=False):
        axes.plot(thrust["time"], thrust.sel(jet=name), dash, color=colour, label=readable_name(name))
    axes.set_ylabel("thrust [N]")


def row(figure: FigureBase, run: Run, letters: str, *, control: bool = False, last: Panel = thrusts) -> None:
    """Draw joint errors, total force and a last panel side by side; the panels have the given letters."""
    title(figure, run)
    errors, force, third = panels = figure.subplots(1, 3)
    joint_errors(errors, run)
    aero_force(force, run, control=control)
    last(third, run)
    style.letters(panels[-len(letters) :], letters)
    for axes in panels:
        axes.set_xlabel("time [s]")
        if run.lost_time is not None:
            style.mark_fall(axes, run.lost_time, run.ending if axes is errors else None)
    style.legend_above(errors, columns=3)
    style.legend_above(force, columns=3, handles=aero_force_key() if control else None)
    style.legend_above(third, columns=2 if last is thrusts else 3)


def readable_name(name: str) -> str:
    """Return the name of a jet or of a group of joints in words: `l_arm_jet` is the "left arm"."""
    words = [SIDES.get(word, word) for word in name.split("_") if word not in SILENT] or name.split("_")
    return " ".join(sorted(words, key=lambda word: word not in SIDES.values()))


def components(axes: Axes, vectors: Series, label: str, *, dash: str = "-", labelled: bool = True) -> None:
    """Draw the components of vectors over time, by colour."""
    for axis, colour in style.AXES_COLOURS.items():
        component = vectors.sel(xyz=axis)
        axes.plot(component["time"], component, dash, color=colour, label=axis if labelled else "_nolegend_")
    axes.set_ylabel(label)
