"""Supplementary Fig. 7: joint errors, total force and thrusts of the tests, and how far two models are apart.

a–c TEST1    d–f TEST2    g–i TEST3    j robustness: simulator's minus controller's total force
"""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from paper_figs import panels, style
from paper_figs.runs import Run


def draw(*runs: Run) -> Figure:
    """Draw the figure from four runs: the first fills a to c, the second d to f, the third g to i, the fourth j."""
    figure = plt.figure(figsize=(style.FULL_WIDTH, 9.6), layout="constrained")
    *tests, lower = figure.subfigures(4, 1, squeeze=False)[:, 0]
    for part, run, letters in zip(tests, runs[:3], ("abc", "def", "ghi"), strict=True):
        part.suptitle(run.title, fontsize=8.5, fontweight="bold", x=0.01, ha="left")
        columns = part.subplots(1, 3)
        panels.joint_errors(columns[0], run)
        panels.aero_force(columns[1], run, control=False)
        panels.thrusts(columns[2], run)
        for axes, mark in zip(columns, letters, strict=True):
            _finish(axes, run, mark)
            style.legend_above(axes, columns=2 if axes is columns[2] else 3)
    _robustness(lower, runs[3])
    end = max(float(run.data["time"][-1]) for run in runs)
    for axes in figure.axes:
        axes.set_xlim(0.0, end)
    return figure


def _robustness(figure: FigureBase, run: Run) -> None:
    figure.suptitle(run.title, fontsize=8.5, fontweight="bold", x=0.01, ha="left")
    errors, forces, difference = figure.subplots(1, 3)
    panels.joint_errors(errors, run)
    panels.aero_force(forces, run, control=True)
    panels.aero_force_difference(difference, run)
    _finish(errors, run, "")
    _finish(forces, run, "")
    _finish(difference, run, "j")
    style.legend_above(errors, columns=3)
    style.legend_above(forces, columns=3, handles=panels.aero_force_key())
    style.legend_above(difference, columns=3)


def _finish(axes: Axes, run: Run, mark: str) -> None:
    if mark:
        style.letter(axes, mark)
    axes.set_xlabel("time [s]")
    if run.lost_time is not None:
        style.mark_fall(axes, run.lost_time, run.ending if mark in "adg" else None)
