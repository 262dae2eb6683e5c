"""Fig. 6: the ground experiments, a to f in a frontal and g to l in a lateral measured wind; the true wind is zero.

a, g  wind    b, h  total aerodynamic force assumed by the controller    c, i  CoM error
d, j  joints of the left leg    e, k  their commanded torques    f, l  torques on the joints
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from paper_figs import panels, style
from paper_figs.runs import Run, Series

LEG = (
    ("hip_pitch", style.VERMILION, "-"),
    ("hip_roll", style.GREEN, "-"),
    ("hip_yaw", style.GREY, "-"),
    ("knee", style.BLACK, "--"),
    ("ankle_pitch", style.ORANGE, "-"),
    ("ankle_roll", style.BLUE, "-"),
)
"""Joints of a leg, with colours and dashes."""


def draw(*runs: Run) -> Figure:
    """Draw the figure from two runs: the first in panels a to f, the second in g to l."""
    figure = style.figure(8.6)
    parts = figure.subfigures(2, 1, squeeze=False)[:, 0]
    for part, run, letters in zip(parts, runs, ("abcdef", "ghijkl"), strict=True):
        _experiment(part, run, letters)
    return figure


def _experiment(figure: FigureBase, run: Run, letters: str) -> None:
    panels.title(figure, run)
    grid = figure.subplots(2, 3, sharex=True)
    flown = run.log_to_loss
    panels.components(grid[0, 0], flown["measured_wind"], "measured wind [m/s]")
    panels.components(grid[0, 1], flown["aero_force_control"].sum("link"), "aerodynamic force [N]")
    panels.components(grid[0, 2], 1e3 * (flown["com_position"] - flown["com_setpoint"]), "CoM error [mm]")
    _leg(grid[1, 0], flown["joint_position"] * (180.0 / np.pi), "left leg joints [deg]")
    _leg(grid[1, 1], flown["joint_torque"], "torques, desired [N m]")
    _leg(grid[1, 2], flown["joint_torque_measured"], "torques, at the joints [N m]")
    style.letters(grid.ravel(), letters)
    for axes in grid[0]:
        style.legend_above(axes, columns=3)
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    style.legend_above(grid[1, 0], columns=3)
    grid[0, 0].set_xlim(0.0, float(run.data["time"][-1]))
    if run.lost_time is not None:
        for axes in grid.ravel():
            style.mark_fall(axes, run.lost_time)


def _leg(axes: Axes, joints: Series, label: str) -> None:
    for name, colour, dash in LEG:
        signal = joints.sel(joint=f"l_{name}")
        axes.plot(signal["time"], signal, dash, color=colour, label=name.replace("_", " "), linewidth=0.9)
    axes.set_ylabel(label)
