"""The use of aerodynamic feedback: three controllers, with corrected and with published lever arms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_figs import panels, style
from paper_figs.runs import Run, Series

COLUMNS = ("corrected lever arms", "published lever arms")
CONTROLLERS: Sequence[tuple[str, str, str]] = (
    ("baseline", style.VERMILION, "-"),
    ("aerodynamic-aware", style.BLUE, "--"),
    ("observer, no model", style.GREEN, ":"),
)
WIDTH = 4.0
"""Narrow, so that the text is legible on a telephone [inches]."""

ROWS: tuple[tuple[str, Callable[[Run], Series], slice], ...] = (
    ("rotation\nerror [deg]", Run.rotation_error_deg, slice(0, 1)),
    ("rotation\nerror [deg]", Run.rotation_error_deg, slice(1, None)),
    ("CoM\nerror [m]", Run.com_error, slice(0, 1)),
    ("CoM\nerror [m]", Run.com_error, slice(1, None)),
)
"""What each row shows of which controllers: those whose errors are small have axes of their own."""


def draw(*runs: Run) -> Figure:
    """Draw six runs: baseline, aware and observer with corrected arms, then the same with published arms."""
    figure = style.figure(6.0, WIDTH)
    grid = figure.subplots(len(ROWS) + 1, 2, sharex=True, sharey="row", height_ratios=(1.2, 1, 1.2, 1, 0.8))
    for column, title in enumerate(COLUMNS):
        same_arms = runs[len(CONTROLLERS) * column :][: len(CONTROLLERS)]
        grid[0, column].set_title(title, weight="bold")
        for axes, (_, of, shown) in zip(grid[:, column], ROWS, strict=False):
            _error(axes, same_arms[shown], CONTROLLERS[shown], of)
        panels.wind(grid[-1, column], max(same_arms, key=lambda run: run.data.sizes["time"]))
        grid[-1, column].set_xlabel("time [s]")
    for axes, label in zip(grid[:, 0], (*(label for label, *_ in ROWS), "wind\n[m/s]"), strict=True):
        axes.set_ylabel(label)
    for axes in grid[:, 1]:
        axes.set_ylabel("")
    for row, columns in ((0, 1), (1, 1), (-1, 3)):
        style.legend(grid[row, 0], ncols=columns, columnspacing=1.0, framealpha=0.0)
    for axes in grid[: len(ROWS), 0]:
        axes.set_ylim(bottom=0.0)  # last, since it disables autoscaling, for the whole row
    grid[0, 0].set_xlim(0.0, max(float(run.data["time"][-1]) for run in runs))
    return figure


def _error(
    axes: Axes, runs: Sequence[Run], controllers: Sequence[tuple[str, str, str]], of: Callable[[Run], Series]
) -> None:
    for run, (controller, colour, dash) in zip(runs, controllers, strict=True):
        error = of(run)
        axes.plot(error["time"], error, dash, color=colour, label=controller)
        if run.lost_time is not None:
            style.mark_fall(axes, run.lost_time, run.ending if of is Run.rotation_error_deg else None)
