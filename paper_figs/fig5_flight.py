"""Fig. 5, panels b to i: one mission flown twice.

b  smoothed CoM reference    c  wind
d, g  joint errors by group    e, h  total aerodynamic force    f, i  thrusts

Panel a of the paper is a snapshot of a viewer; it is not drawn here.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure, FigureBase

from paper_figs import panels, style
from paper_figs.runs import Run


def draw(first: Run, second: Run) -> Figure:
    """Draw the figure from two runs: the first fills d to f, the second g to i."""
    figure = plt.figure(figsize=(style.FULL_WIDTH, 7.4), layout="constrained")
    top, upper, lower = figure.subfigures(3, 1, height_ratios=(1.0, 1.15, 1.22), squeeze=False)[:, 0]

    b, c = top.subplots(1, 2)
    panels.com_setpoint(b, first)
    panels.wind(c, first)
    for axes, mark in ((b, "b"), (c, "c")):
        style.letter(axes, mark)
        axes.set_xlabel("time [s]")
        style.legend_above(axes, columns=3)

    _row(upper, first, "def", control=False)
    _row(lower, second, "ghi", control=True)
    end = max(float(run.data["time"][-1]) for run in (first, second))
    for axes in figure.axes:
        axes.set_xlim(0.0, end)
    return figure


def _row(figure: FigureBase, run: Run, letters: str, *, control: bool) -> None:
    figure.suptitle(run.title, fontsize=8.5, fontweight="bold", x=0.01, ha="left")
    errors, force, thrust = figure.subplots(1, 3)
    panels.joint_errors(errors, run)
    panels.aero_force(force, run, control=control)
    panels.thrusts(thrust, run)
    for axes, mark in zip((errors, force, thrust), letters, strict=True):
        style.letter(axes, mark)
        axes.set_xlabel("time [s]")
        if run.lost_time is not None:
            style.mark_fall(axes, run.lost_time, run.ending if axes is errors else None)
        handles = panels.aero_force_key() if control and axes is force else None
        style.legend_above(axes, columns=2 if axes is thrust else 3, handles=handles)
