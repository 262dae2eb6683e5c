"""Panels several figures share: one function draws one panel into the axes it is given."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from paper_figs import style
from paper_figs.runs import Run, Series

SIDES = {"l": "left", "r": "right"}
SILENT = ("jet", "turbine")  # words a legend of jets need not repeat


def com_setpoint(axes: Axes, run: Run) -> None:
    """Draw the smoothed reference of the centre of mass."""
    _components(axes, run.data["com_setpoint"])
    axes.set_ylabel("CoM reference [m]")


def wind(axes: Axes, run: Run) -> None:
    """Draw the wind velocity."""
    _components(axes, run.data["wind"])
    axes.set_ylabel("wind [m/s]")


def joint_errors(axes: Axes, run: Run) -> None:
    """Draw the sum of absolute joint errors of each group."""
    errors = run.joint_error_deg()
    for group, colour in zip(errors["group"].values.tolist(), style.GROUP_COLOURS, strict=False):
        dash = "--" if "right" in readable(group) else "-"
        axes.plot(errors["time"], errors.sel(group=group), dash, color=colour, label=readable(group))
    axes.set_ylabel("joint error Δs [deg]")
    axes.set_ylim(bottom=0.0)


def aero_force(axes: Axes, run: Run, *, control: bool) -> None:
    """Draw the sum of aerodynamic forces over the links; with `control`, also what the controller assumes."""
    _components(axes, run.flown["aero_force_sim"].sum("link"))
    if control:
        _components(axes, run.flown["aero_force_control"].sum("link"), dash="--", labelled=False)
    axes.set_ylabel("aerodynamic force [N]")


def aero_force_difference(axes: Axes, run: Run) -> None:
    """Draw the simulator's total aerodynamic force minus the controller's."""
    flown = run.flown
    _components(axes, flown["aero_force_sim"].sum("link") - flown["aero_force_control"].sum("link"))
    axes.set_ylabel("force difference [N]")


def aero_force_key() -> list[Line2D]:
    """Return legend entries: axes by colour, models by dash, in columns of two."""
    x, y, z = (Line2D([], [], color=colour, label=axis) for axis, colour in style.AXES_COLOURS.items())
    simulator = Line2D([], [], color=style.GREY, label="simulator")
    controller = Line2D([], [], color=style.GREY, label="controller", linestyle="--")
    return [x, simulator, y, controller, z]


def thrusts(axes: Axes, run: Run) -> None:
    """Draw the thrust of each jet."""
    thrust = run.flown["thrust"]
    names = thrust["jet"].values.tolist()
    for name, colour, dash in zip(names, style.JET_COLOURS, style.JET_DASHES, strict=False):
        axes.plot(thrust["time"], thrust.sel(jet=name), dash, color=colour, label=readable(name))
    axes.set_ylabel("thrust [N]")


def readable(name: str) -> str:
    """Return the name of a jet or of a group of joints in words: `l_arm_jet` is the "left arm"."""
    words = [SIDES.get(word, word) for word in name.split("_") if word not in SILENT]
    return " ".join(sorted(words, key=lambda word: word not in SIDES.values()))


def _components(axes: Axes, vectors: Series, *, dash: str = "-", labelled: bool = True) -> None:
    for axis, colour in style.AXES_COLOURS.items():
        component = vectors.sel(xyz=axis)
        axes.plot(component["time"], component, dash, color=colour, label=axis if labelled else "_nolegend_")
