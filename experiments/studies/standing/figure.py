"""Desired torques of a standing robot: recorded, and from its measurements as flown and as physically right."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

LOOKS = {"recorded": (style.BLACK, "-"), "as flown": (style.ORANGE, "--"), "right": (style.BLUE, "-")}
"""Colour and dash of every source."""
LABELS = {"right": "physically right"}

PITCH = {"l_ankle_pitch": "left ankle pitch", "l_knee": "left knee", "torso_pitch": "torso pitch"}
ROLL = {"l_ankle_roll": "left ankle roll", "l_hip_roll": "left hip roll", "torso_roll": "torso roll"}


def draw(study: xr.Dataset) -> Figure:
    """Draw the assumed force along the wind, the moment of the left foot that balances it, and four torques."""
    along = "x" if abs(float(study["wind"][-1].sel(xyz="x"))) > abs(float(study["wind"][-1].sel(xyz="y"))) else "y"
    joints, moment = (PITCH, "my") if along == "x" else (ROLL, "mx")
    figure = style.figure(5.2)
    grid = figure.subplots(2, 3, sharex=True)
    foot = study["contact_force"].sel(foot="l_sole")
    panels = [
        (study["aero_force"].sel(xyz=along), f"assumed force along {along} [N]"),
        (foot.sel(six=f"f{along}"), f"left foot, force along {along} [N]"),
        (foot.sel(six=moment), "left foot, moment [N m]"),
        *((study["joint_torque"].sel(joint=name), f"{label}, desired [N m]") for name, label in joints.items()),
    ]
    for axes, (signal, label) in zip(grid.ravel(), panels, strict=True):
        for source, (colour, dash) in LOOKS.items():
            values = signal.sel(source=source)
            axes.plot(study["time"], values, dash, color=colour, label=LABELS.get(source, source), linewidth=0.9)
        axes.set_ylabel(label)
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    grid[0, 0].set_xlim(0.0, float(study["time"][-1]))
    style.letters(grid.ravel())
    style.legend_above(grid[0, 0], columns=3)
    return figure


FIGURES = {
    "standing": Entry(draw, "the standing robot's record through our controller", "standing", ("front",)),
}
