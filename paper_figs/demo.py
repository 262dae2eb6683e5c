"""The use of aerodynamic feedback: three controllers, with corrected and with published lever arms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_figs import panels, style
from paper_figs.runs import Run, Series

COLUMNS = ("corrected lever arms", "published lever arms")
CONTROLLERS = (
    ("baseline", style.VERMILION, "-"),
    ("aerodynamic-aware", style.BLUE, "--"),
    ("observer, no model", style.GREEN, ":"),
)
WIDTH = 4.0
"""Narrow, so that the text is legible on a telephone [inches]."""


def draw(*runs: Run) -> Figure:
    """Draw six runs: baseline, aware and observer with corrected arms, then the same with published arms."""
    figure = style.figure(4.4, WIDTH)
    grid = figure.subplots(3, 2, sharex=True, sharey="row", height_ratios=(1.2, 1.2, 0.7))
    for column, title in enumerate(COLUMNS):
        same_arms = runs[len(CONTROLLERS) * column :][: len(CONTROLLERS)]
        grid[0, column].set_title(title, weight="bold")
        _error(grid[0, column], same_arms, Run.rotation_error_deg, says_ending=True)
        _error(grid[1, column], same_arms, Run.com_error, says_ending=False)
        panels.wind(grid[-1, column], max(same_arms, key=lambda run: run.data.sizes["time"]))
        grid[-1, column].set_xlabel("time [s]")
    for axes, label in zip(grid[:, 0], ("rotation error [deg]", "CoM error [m]", "wind [m/s]"), strict=True):
        axes.set_ylabel(label)
    for axes in grid[:, 1]:
        axes.set_ylabel("")
    for row, columns in ((0, 1), (2, 3)):
        style.legend(grid[row, 0], ncols=columns, columnspacing=1.0, framealpha=0.0)
    for axes in grid[:2, 0]:
        axes.set_ylim(bottom=0.0)  # last, since it disables autoscaling, for the whole row
    grid[0, 0].set_xlim(0.0, max(float(run.data["time"][-1]) for run in runs))
    return figure


def _error(axes: Axes, runs: Sequence[Run], of: Callable[[Run], Series], *, says_ending: bool) -> None:
    for run, (controller, colour, dash) in zip(runs, CONTROLLERS, strict=True):
        error = of(run)
        axes.plot(error["time"], error, dash, color=colour, label=controller)
        if run.lost_time is not None:
            style.mark_fall(axes, run.lost_time, run.ending if says_ending else None)
